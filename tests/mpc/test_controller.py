"""A controller: what it commands, what it refuses, what may change between two calls."""

from __future__ import annotations

import dataclasses
import time

import mujoco
import numpy as np
import pytest

import octo
from octo.errors import DeviceError, ProblemError, ShapeError, UnknownNameError, ValueRangeError
from octo.model.feet import lowest_contacts
from octo.model.kinematics import sphere_centers
from octo.mpc import CommandStatus, Controller, run, walking_problem
from octo.mpc.measurement import _say_cpu
from octo.mpc.stance import STRAIGHT, _stretch, stance
from octo.plant import MujocoPlant
from octo.problem.compiled import CompiledProblem
from tests.mpc.conftest import inside


def test_it_stands(controller, plant, stand, robot):
    commands = stand(60)
    assert {command.status for command in commands} == {CommandStatus.SOLVED}
    assert plant.base_rotation[2, 2] > 0.99
    assert all(inside(command.u, robot.torque_limit) for command in commands)
    last = commands[-1]
    assert (
        last.u.shape == (robot.nu,)
        and last.x.shape == (robot.nx + 1,)
        and last.v.shape == (robot.nx,)
    )
    assert last.valid_until == pytest.approx(0.59 + 20 * 0.04)
    assert last.iterations == 1 and 0.0 < last.prepare < last.seconds


def test_torques_hold_the_weight(controller, plant, stand, robot):
    """Standing still, the planned torques are those of statics: their power on any small motion
    lifts the weight."""
    commands = stand(150)
    u = np.mean([command.u for command in commands[-20:]], axis=0)
    knees = [
        robot.actuated.tolist().index(j)
        for j, joint in enumerate(robot.joints)
        if joint.name.endswith("knee")
    ]
    force, _ = plant.contacts()
    assert force[:, 2].sum() == pytest.approx(9.81 * robot.mass, rel=0.1)
    measured = plant.torque
    assert np.abs(u[knees]).max() > 0.1
    np.testing.assert_allclose(u, measured, atol=0.15 * np.abs(measured).max())


def test_the_gains_are_derivatives_on_the_tangent_space(controller, plant, stand, robot):
    """K against differences of U·FD along MuJoCo's own integration of a small error; the gain of
    x_1 is the solver's."""
    command = stand(100)[-1]
    K, gain, nodes = command.K, controller._gain.copy(), controller._gain_nodes.copy()
    assert K.shape == (robot.nu, 2 * robot.nx)
    q, v = controller.convention.from_octo(nodes[1], (nodes[1] - nodes[0]) / controller.dt)

    def torque(q, v):
        x, before = controller.convention.to_octo(q, v, controller.dt, nodes[1])
        after = nodes[2] + gain @ np.concatenate([x - nodes[1], before - nodes[0]])
        fd = controller.problem.dynamics.evaluate(
            np.stack([before, x, after])[None], controller.compiled.p
        )[0]
        return fd[0, 0, robot.actuated]

    h = 1e-5
    for column in range(2 * robot.nx):
        answers = []
        for side in (h, -h):
            place, speed, error = q.copy(), v.copy(), np.zeros(robot.nx)
            error[column % robot.nx] = side
            if column < robot.nx:
                mujoco.mj_integratePos(plant.model, place, error, 1.0)
            else:
                speed += error
            answers.append(torque(place, speed))
        np.testing.assert_allclose(
            K[:, column], (answers[0] - answers[1]) / (2 * h), atol=0.02 * np.abs(K).max()
        )


@pytest.mark.timed
def test_command_is_read_in_microseconds_and_follows_the_plan(controller, plant, stand, robot):
    stand(10)
    q, v = plant.q, plant.v
    began = time.perf_counter()
    for _ in range(500):
        u = controller.command(0.1, q, v)
    assert (time.perf_counter() - began) / 500 < 5e-4
    assert inside(u, robot.torque_limit)
    x, rate, ahead = controller.plan.at(0.1)
    expected = ahead + controller.kp * (x[6:] - q[7:]) + controller.kd * (rate[6:] - v[6:])
    np.testing.assert_allclose(
        u, np.clip(expected, -robot.torque_limit, robot.torque_limit), atol=1e-12
    )


def test_references_change_without_compiling(controller, plant, stand, problem):
    library = controller.compiled.library
    controller.update("BaseHeight", height=float(problem.start[2]) - 0.03)
    stand(150)
    assert controller.compiled.library is library
    assert plant.height < problem.start[2] - 0.015
    controller.update("BaseHeight", height=None, weight=controller.problem.costs[2].weight)
    stand(100, 150)
    assert plant.height > problem.start[2] - 0.012


def test_terrain_height_changes_what_is_planned(controller, plant, stand):
    stand(5)
    before = controller.plan.x.copy()
    controller.set_parameters({"terrain.height": -0.02})
    command = controller.step(1.0, plant.q, plant.v)
    controller.set_parameters({"terrain.height": 0.0})
    assert command.status.fresh
    assert np.abs(controller.plan.x - before).max() > 1e-3


def test_unknown_names_are_refused(controller):
    with pytest.raises(UnknownNameError, match="term"):
        controller.update("Hight", height=0.3)
    with pytest.raises(UnknownNameError, match="field of BaseHeight"):
        controller.update("BaseHeight", hight=0.3)
    with pytest.raises(UnknownNameError, match="reference of BaseHeight"):
        controller.reference("BaseHeight", "hight")
    with pytest.raises(ValueRangeError, match="dt"):
        controller.set_parameters({"dt": 0.1})
    with pytest.raises(ShapeError, match="q"):
        controller.reset(np.zeros(3))


def test_what_a_controller_is_not_made_of(robot, problem):
    with pytest.raises(UnknownNameError, match="curvature"):
        Controller(problem, curvature="none")
    with pytest.raises(UnknownNameError, match="convention"):
        Controller(problem, convention="ros")
    with pytest.raises(ValueRangeError, match="budget"):
        Controller(problem, budget=-1.0)
    with pytest.raises(DeviceError):
        Controller(problem, device="cuda")
    with pytest.raises(
        ProblemError, match="basis is 'hermite': a controller needs the basis 'nodes'"
    ):
        Controller(problem.replace(basis="hermite"))
    with pytest.raises(ProblemError, match="x_end is given"):
        Controller(problem.replace(x_end=problem.start))
    with pytest.raises(ProblemError, match="steps is 2: a controller needs at least 3"):
        Controller(problem.replace(steps=2))


def test_warm_start_from_a_solution(controller, problem):
    solution = octo.solve(problem.replace(parameters={}), passes=1, device="cpu", max_iterations=3)
    controller.warm_start(solution, t=2.0)
    np.testing.assert_allclose(controller.plan.at(2.04)[0], solution.x[2], atol=1e-12)
    with pytest.raises(ValueRangeError, match="dt"):
        controller.warm_start(
            octo.solve(problem.replace(dt=0.02), passes=1, device="cpu", max_iterations=1)
        )


def test_pinocchio_form_gives_the_same_command(problem, robot):
    plant = MujocoPlant(robot)
    x = problem.start.copy()
    x[3:6] = (0.4, 0.1, -0.05)
    rate = 0.1 * np.random.default_rng(0).standard_normal(robot.nx)
    plant.reset_chart(x, rate)
    ours, theirs = (Controller(problem, convention=name) for name in ("mujoco", "pinocchio"))
    q, v = ours.convention.from_octo(x, rate)
    p, w = theirs.convention.from_octo(x, rate)
    one, two = ours.step(0.0, q, v), theirs.step(0.0, p, w)
    np.testing.assert_allclose(one.u, two.u, atol=1e-9)
    np.testing.assert_allclose(one.K[:, 6 : robot.nx], two.K[:, 6 : robot.nx], atol=1e-6)


def test_exact_curvature_is_an_option(problem, plant):
    controller = Controller(problem, curvature="exact")
    statuses = [controller.step(0.01 * k, plant.q, plant.v).status for k in range(20)]
    assert all(status.fresh for status in statuses)


def test_stance_bends_straight_legs(robot):
    straight = {"abduction": 0.0, "pitch": 0.11, "knee": -0.22}
    pose = np.zeros(robot.nx)
    for j in robot.actuated:
        pose[j] = straight[robot.joints[j].name.rsplit("_", 1)[-1]]
    stretched = dataclasses.replace(robot, default_pose=pose)
    bent = stance(stretched)
    feet = lowest_contacts(stretched, bent)
    assert max(_stretch(stretched, pose, k) for k in feet) > STRAIGHT
    assert max(_stretch(stretched, bent, k) for k in feet) < STRAIGHT
    assert np.ptp(sphere_centers(stretched, bent)[feet, 2]) < 0.02  # the feet stay in one plane


@pytest.mark.parametrize("gravity", [9.81, 1.62])
def test_walking_problem_plans_with_soft_feet_that_carry_the_weight_at_rest(robot, gravity):
    problem = walking_problem(robot, steps=20, parameters={"gravity_z": -gravity})
    assert problem.gravity == gravity
    force, *_, depth = CompiledProblem([problem]).kinematics(
        problem.start, problem.start, problem.p
    )
    force, depth = np.asarray(force), np.asarray(depth).ravel()
    assert force[2].sum() == pytest.approx(gravity * robot.mass, rel=0.02)
    assert np.abs(depth[force[2] > 0.5 * gravity]).max() < 0.004  # hard feet would stand as high


def test_the_shifted_plan_is_the_plan(controller, plant, stand):
    stand(3)
    plan = controller.plan
    nodes = np.empty_like(controller.horizon.nodes)
    plan.shift(plan.time + plan.dt, nodes)
    np.testing.assert_allclose(nodes[:-1], plan.x[1 : plan.steps + 2], atol=1e-12)


def test_auto_is_the_cpu_whatever_the_machine_has(problem, monkeypatch, caplog):
    monkeypatch.setattr("octo.gpu.cuda.reason", lambda: None)  # a machine with a GPU
    _say_cpu.cache_clear()
    with caplog.at_level("INFO", logger="octo"):
        for _ in range(2):
            Controller(problem, device="auto")
    assert caplog.messages == ["using the CPU: this version has no control loop on a GPU"]


def test_a_reset_restarts_the_command(controller, plant):
    guide = controller.guide
    guide.velocity[:] = 0.3, 0.0
    try:
        for k in range(40):
            controller.step(0.01 * k, plant.q + 1e-9 * k, plant.v)
        wanted = controller.reference("CenterOfMassVelocity", "velocity")
        assert wanted[0, 0] > 0.25
        controller.reset(plant.q, plant.v, 0.4)  # put back: the time goes on
        np.testing.assert_allclose(wanted[:, :2], 0.0, atol=1e-12)
        controller.step(0.41, plant.q, plant.v)
        assert 0.0 < wanted[0, 0] < 0.05  # from rest, at 1 m/s²
    finally:
        guide.velocity[:] = 0.0


def test_it_stands_on_the_moon(robot):
    """Feet and their slip are known by the weight that they carry there."""
    problem = walking_problem(robot, steps=20, parameters={"gravity_z": -1.62})
    plant = MujocoPlant(robot, gravity=(0.0, 0.0, -1.62))
    plant.reset_chart(problem.start)
    log = run(Controller(problem), plant, 1.0)
    assert log.force[-1, :, 2].sum() == pytest.approx(1.62 * robot.mass, rel=0.1)
    assert (
        log.falls == [] and log.feet.tolist() == np.flatnonzero(log.force[-1, :, 2] > 0.5).tolist()
    )
    assert len(log.feet) == 4 and log.solution().weight == pytest.approx(1.62 * robot.mass)
    with pytest.raises(ProblemError, match="gravity is 0"):
        walking_problem(robot, parameters={"gravity_z": 0.0})
