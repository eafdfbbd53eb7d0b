"""What the controller asks for: the plan between its nodes, and forces of the feet that give a
wrench."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import octo
from octo.cli import simulate
from octo.dynamics.simulate import Motion
from octo.errors import OctoError
from octo.model.kinematics import sphere_centers
from octo.plant import MujocoPlant, from_chart
from octo.problem.problem import Problem
from octo.replay.control import Controller, Gains
from octo.replay.plan import Plan, ground_of
from octo.replay.run import perturbed, replay
from octo.result.solution import Solution

STEPS, DT = 40, 0.025
AMPLITUDES = 0.05 * np.sin(np.arange(18.0))


def moving(problem: Problem) -> Solution:
    """A motion that is smooth and no more: what the plan's times and conventions are checked on."""
    t = DT * np.arange(-1, STEPS + 1)[:, None]
    x = problem.start + (1.0 - np.cos(2.0 * t)) * AMPLITUDES
    u = np.cos(t[1:-1] + np.arange(12))
    return simulate.measured_motion(
        problem, Motion(x, u, DT, np.ones(STEPS, dtype=bool), np.zeros(1)), 0.1, 0.2
    )


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem(octo.gallery.mammal(), steps=STEPS, dt=DT, costs=[octo.Effort()])


@pytest.fixture(scope="module")
def standing(problem: Problem) -> Solution:
    x = np.repeat(problem.start[None], STEPS + 2, axis=0)
    return simulate.measured_motion(
        problem,
        Motion(x, np.zeros((STEPS, 12)), DT, np.ones(STEPS, dtype=bool), np.zeros(1)),
        0.1,
        0.2,
    )


def test_the_plan_passes_through_the_nodes_with_its_own_velocity(problem: Problem) -> None:
    solution = moving(problem)
    plan = Plan.of(solution, 0.001)
    assert plan.steps == 1000
    np.testing.assert_allclose(plan.q[::25], solution.to_mujoco()[0], atol=1e-9)
    robot = problem.character
    assert robot is not None
    for k in (100, 500, 900):
        t = 0.001 * k
        x = problem.start + (1.0 - np.cos(2.0 * t)) * AMPLITUDES
        rate = 2.0 * np.sin(2.0 * t) * AMPLITUDES
        q, v = from_chart(robot, x, rate)
        np.testing.assert_allclose(plan.q[k], q, atol=1e-5)
        np.testing.assert_allclose(plan.v[k], v, atol=2e-3)


def test_torques_and_forces_belong_to_the_node_around_which_their_step_accelerates(
    problem: Problem,
) -> None:
    solution = moving(problem)
    plan = Plan.of(solution, 0.005)
    np.testing.assert_allclose(plan.u[::5][:STEPS], solution.u, atol=1e-12)
    np.testing.assert_allclose(plan.u[2], 0.6 * solution.u[0] + 0.4 * solution.u[1], atol=1e-12)
    np.testing.assert_allclose(plan.force[::5][:STEPS], solution.contact_force, atol=1e-12)
    np.testing.assert_array_equal(
        plan.stance[::5][:STEPS], solution.normal_force > 0.02 * solution.weight
    )


@pytest.fixture(scope="module")
def controller(standing: Solution) -> Controller:
    robot = standing.character
    assert robot is not None
    plant = MujocoPlant(robot, friction=0.8)
    plant.reset_chart(standing.x[1])
    return Controller(
        Plan.of(standing, 0.005), Gains.of(standing, friction=0.8), plant, standing.length
    )


def arms_of(controller: Controller) -> np.ndarray:
    """Lowest points of the four feet from the base's origin, by octo's own kinematics."""
    robot, x = controller.plan.character, controller.plant.x
    return sphere_centers(robot, x)[:4] - [0.0, 0.0, 0.02] - x[:3]


def test_the_feet_give_the_wrench(controller: Controller) -> None:
    feet, arms = np.arange(4), arms_of(controller)
    points, _ = controller.plant.feet(feet)
    np.testing.assert_allclose(points - controller.plant.base_place, arms, atol=1e-9)
    planned = controller.plan.force[0, feet]
    for wrench in (
        [3.0, 0, 0, 0, 0, 0],
        [0, -3.0, 0, 0, 0, 0],
        [0, 0, 5.0, 0, 0, 0],
        [0, 0, 0, 0.4, 0, 0],
        [0, 0, 0, 0, -0.6, 0.3],
    ):
        change = controller.forces(0, feet, arms, np.array(wrench)) - planned
        total = np.concatenate([change.sum(axis=0), np.cross(arms, change).sum(axis=0)])
        np.testing.assert_allclose(total, wrench, atol=0.06 * np.abs(wrench).max())


def test_no_foot_pulls_or_slips_for_it(controller: Controller) -> None:
    feet, arms = np.arange(4), arms_of(controller)
    for wrench in ([500.0, 0, 0, 0, 0, 0], [0, 0, -500.0, 0, 0, 0], [0, 0, 0, 100.0, 50.0, 0]):
        force = controller.forces(0, feet, arms, np.array(wrench))
        assert np.min(force[:, 2]) > -1e-9
        # three quarters of 0.8
        assert np.all(np.abs(force[:, :2]).sum(axis=1) <= 0.6 * force[:, 2] + 1e-9)


def test_torques_hold_the_forces_of_the_feet(controller: Controller) -> None:
    """Principle of virtual work: torques u and forces f do no work over any motion of the joints,
    but for a foot's radius."""
    wrench, feet = np.array([2.0, 1.0, 3.0, 0.2, -0.3, 0.1]), np.arange(4)
    u = controller.spread(0, wrench)
    change = (
        controller.forces(0, feet, arms_of(controller), wrench) - controller.plan.force[0, feet]
    )
    robot, x, h = controller.plan.character, controller.plant.x, 1e-6
    for k, j in enumerate(robot.actuated):
        step = np.eye(robot.nx)[j] * h
        moved = (sphere_centers(robot, x + step)[:4] - sphere_centers(robot, x - step)[:4]) / (
            2.0 * h
        )
        work = np.sum(moved * change) + u[k]
        assert abs(work) < 0.02 * np.abs(change).max()


def test_base_wrench_pulls_to_the_plan(controller: Controller, standing: Solution) -> None:
    x = standing.x[1].copy()
    x[:3] += (0.01, -0.02, 0.0)
    x[5] += 0.1  # roll
    q, v = from_chart(controller.plan.character, x)
    force, moment = np.split(controller.wrench(0, q, v), 2)
    np.testing.assert_allclose(
        force, controller.gains.base * np.array([-0.01, 0.02, 0.0]), atol=1e-9
    )
    np.testing.assert_allclose(
        moment, [-0.1 * controller.gains.tilt, 0.0, 0.0], atol=0.01 * controller.gains.tilt * 0.1
    )
    rate = np.zeros(len(x))
    rate[:6] = (0.1, 0.0, 0.0, 0.2, 0.0, 0.0)
    force, moment = np.split(
        controller.wrench(0, *from_chart(controller.plan.character, standing.x[1], rate)), 2
    )
    np.testing.assert_allclose(force, [-0.1 * controller.gains.base_damping, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(moment, [0.0, 0.0, -0.2 * controller.gains.tilt_damping], atol=1e-3)


def test_gains_are_those_of_the_robot_at_hand(standing: Solution) -> None:
    gains = Gains.of(standing)
    heavier = Gains.of(replace(standing, weight=2.0 * standing.weight))
    assert heavier.kp == pytest.approx(2.0 * gains.kp)
    assert Gains.of(standing, kp=7.0, kd=0.2).kp == 7.0
    assert Gains.of(standing, kp=7.0, kd=0.2).kd == 0.2
    assert gains.without_base().base == 0.0


def test_perturbed_starts_are_the_same_for_the_same_seed_and_of_the_size_they_should_be(
    standing: Solution,
) -> None:
    first, second = (perturbed(standing, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first[0], second[0])
    rng = np.random.default_rng(0)
    many = [perturbed(standing, rng) for _ in range(2000)]
    away, rate = np.array([x for x, _ in many]) - standing.x[1], np.array([v for _, v in many])
    np.testing.assert_allclose(away[:, 4:6].std(axis=0), 0.04, rtol=0.06)
    np.testing.assert_allclose(away[:, 6:].std(axis=0), 0.02, rtol=0.06)
    np.testing.assert_allclose(rate[:, :6].std(axis=0), 0.05, rtol=0.06)
    assert np.abs(away[:, [0, 1, 3]]).max() == 0.0 and np.abs(rate[:, 6:]).max() == 0.0
    assert away[:, 2].min() >= 0.0 and 0.0099 < away[:, 2].max() <= 0.01


def test_feedback_brings_a_pushed_base_back(standing: Solution) -> None:
    """From the same perturbed starts the base ends nearer to its plan with the wrench than
    without."""
    drifts = [
        np.mean([s.drift for s in replay(standing, starts=3, seed=2, feedback=f).starts])
        for f in ("base", "none")
    ]
    assert drifts[0] < 0.9 * drifts[1]


def test_the_ground_is_the_plans(standing: Solution) -> None:
    plane = octo.Plane(slope=0.1, direction=0.5, height=0.2)
    sloped = replace(
        standing,
        parameters={
            **standing.parameters,
            **{f"terrain.{k}": v for k, v in plane.parameters.items()},
        },
    )
    found = ground_of(sloped)
    assert (found.slope, found.direction, found.height) == pytest.approx((0.1, 0.5, 0.2))


def test_a_plan_that_starts_moving_is_replayed_moving(standing: Solution) -> None:
    """Limp joints, no feedback: what carries the base in the first step is its velocity, less what
    its feet rub off."""
    moving = replace(standing, x=standing.x.copy())
    moving.x[:, 0] += 0.5 * DT * np.arange(-1, STEPS + 1)
    limp = {"feedback": "none", "kp": 0.01, "kd": 0.001}
    for plan, way in ((standing, 0.0), (moving, 0.5 * DT)):
        nodes = replay(plan, **limp).motion.x  # type: ignore[arg-type]
        assert way - 0.5 * 0.8 * 9.81 * DT**2 <= nodes[2, 0] - nodes[1, 0] <= way + 1e-3
    still, shifted = (perturbed(plan, np.random.default_rng(1))[1] for plan in (standing, moving))
    np.testing.assert_allclose(shifted - still, 0.5 * np.eye(18)[0], atol=1e-12)


def test_a_plan_of_any_dt_is_replayed_in_whole_time_steps(standing: Solution) -> None:
    """As one whose duration was found: the default is the whole part that is nearest to 1 ms."""
    assert replay(standing).settings["timestep"] == 0.001
    odd = replay(replace(standing, dt=0.0249937))
    assert odd.settings["timestep"] == 0.0249937 / 25
    assert odd.motion.steps == standing.steps
    with pytest.raises(OctoError, match="timestep is 0.001 s, must be a whole part"):
        replay(replace(standing, dt=0.0249937), timestep=0.001)


def test_a_joint_without_torque_has_no_torque_use(standing: Solution) -> None:
    robot = standing.character
    assert robot is not None
    free = [
        replace(
            body,
            joints=tuple(replace(j, torque_limit=0.0) if j.actuated else j for j in body.joints),
        )
        for body in robot.bodies
    ]
    limp = replay(
        replace(standing, character=replace(robot, bodies=tuple(free))),
        feedback="none",
        timestep=0.005,
    )
    assert limp.starts[0].torque_use == 0.0
