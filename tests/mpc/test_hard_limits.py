"""Hard bounds at one iteration a call: torques, speeds and joints are worked out from the plans and
from MuJoCo, not read from the controller."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.errors import OctoError
from octo.mpc import Controller, Log, VelocityCommand, animate, run
from octo.plant import MujocoPlant
from octo.problem.compiled import CompiledProblem
from octo.result.measure import measured
from octo.solver import receding_bounds
from octo.solver.receding import RecedingHorizon
from octo.solver.receding_bounds import bounds_of
from octo.solver.receding_interpreted import InterpretedHorizon

TORQUE, MARGIN, SPEED = 6.0, 0.05, 8.0  # N m, rad, rad/s
WEIGHT = 1e-3  # N μ
LIMITS = [
    octo.TorqueLimits(limit=TORQUE),
    octo.JointLimits(margin=MARGIN),
    octo.JointSpeedLimits(limit=SPEED),
]


def walked(problem, robot, seconds=4.0, speed=0.5):
    """Plans of a walk at ``speed`` m/s, what was sent, and where the robot was."""
    plant = MujocoPlant(robot)
    plant.reset_chart(problem.start)
    controller = Controller(problem, guide=VelocityCommand((speed, 0.0)))
    controller.reset(plant.q, plant.v)
    plans, sent, places = [], [], []
    for k in range(round(100 * seconds)):
        controller.step(0.01 * k, plant.q, plant.v)
        plans.append(controller.plan)
        for j in range(5):
            sent.append(controller.command(0.01 * k + 0.002 * j, plant.q, plant.v))
            plant.step(sent[-1])
        places.append(plant.x)
    return plans, np.array(sent), np.array(places), controller


def beyond(plans, problem, robot):
    """(plans, 3) how far torques, joints and speeds of each plan are beyond the bounds: N m, rad,
    rad/s."""
    N, joints = problem.steps, robot.actuated
    found = []
    for plan in plans:
        x = plan.x[: N + 2]
        fd = problem.dynamics.evaluate(x[None], problem.p[None])[0][0]
        place = x[2:, joints]
        low = robot.lower[joints] + MARGIN - place
        speed = np.abs(np.diff(x[1:, joints], axis=0)) / problem.dt
        high = place - (robot.upper[joints] - MARGIN)
        torque = np.abs(fd[:, joints]) - TORQUE
        found.append([torque.max(), max(low.max(), high.max()), (speed - SPEED).max()])
    return np.array(found)


@pytest.fixture(scope="module")
def limited(problem, robot):
    bounded = problem.replace(constraints=LIMITS)
    return walked(bounded, robot), bounded


def test_plans_keep_their_bounds_and_the_robot_walks(limited, problem, robot):
    """Where a foot meets the ground the plan's soft contact bends too much for one iteration: some
    plans are beyond for a call or two."""
    (plans, _, places, _), bounded = limited
    assert places[-1, 2] > 0.8 * problem.start[2] and places[-1, 0] > 1.2
    off = beyond(plans[20:], bounded, robot) > np.array([0.02 * TORQUE, 0.01, 0.02 * SPEED])
    assert off.mean(axis=0).max() < 0.12
    free = walked(problem, robot, 2.0)[0]
    assert (beyond(free[20:], problem, robot)[:, 0] > 0.02 * TORQUE).mean() > 0.6


def test_no_torque_is_sent_beyond_the_bound_ever(limited):
    (_, sent, _, controller), _ = limited
    assert np.abs(sent).max() <= TORQUE
    assert np.abs(controller.plan.u).max() <= TORQUE


def test_the_record_says_how_often_torques_were_clipped(problem, robot, tmp_path):
    plant = MujocoPlant(robot)
    plant.reset_chart(problem.start)
    tight = problem.replace(constraints=[octo.TorqueLimits(limit=0.55 * TORQUE)])
    log = run(Controller(tight, guide=VelocityCommand((0.3, 0.0))), plant, 1.5)
    report = log.report()
    clipped = log.clipped > 0.0
    assert report["clipped"]["share"] == pytest.approx((log.clipped > 1e-6).mean())
    assert report["clipped"]["most"] == pytest.approx(log.clipped.max())
    # what was clipped is the first of the plan's torques, of which the excess is the most
    np.testing.assert_array_less(log.clipped[clipped], log.excess[clipped] - 1.0 + 1e-9)
    assert report["beyond"]["most"] >= report["clipped"]["most"] - 1e-9
    log.save(tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz") as file:
        older = {name: file[name] for name in file.files if name not in ("clipped", "beyond")}
    np.savez(tmp_path / "older.npz", **older)
    assert np.isnan(Log.load(tmp_path / "older.npz").clipped).all()


def test_many_iterations_end_where_the_solver_does(problem, robot, monkeypatch):
    """From one measurement a controller of many iterations plans what octo.solve finds, where the
    barrier that it keeps weighs little."""
    monkeypatch.setattr(receding_bounds, "WEIGHT", WEIGHT)
    limits = [octo.TorqueLimits(limit=0.18 * TORQUE), octo.JointSpeedLimits(limit=0.3)]
    bounded = problem.replace(steps=10, constraints=limits)
    controller = Controller(bounded, iterations=60)
    controller.reset()
    command = controller.step(
        0.01, *controller.convention.from_octo(bounded.start, np.zeros(robot.nx))
    )
    solved = octo.solve(bounded, passes=1, start=controller.plan.x[:12].copy())
    assert solved.converged and command.beyond == 0.0
    assert solved.energy <= command.energy + 1e-9
    assert command.energy == pytest.approx(solved.energy, rel=0.05)
    # complementarity: multiplier times gap is the barrier's weight, of upper and lower bounds
    rows, bounds = controller.horizon.rows, controller._iteration.bounds
    gaps = np.stack([rows - controller.compiled.lower[0], controller.compiled.upper[0] - rows])
    np.testing.assert_allclose(bounds._z * gaps, WEIGHT / bounded.steps, rtol=0.05)
    assert gaps.min() < 0.2


def test_both_horizons_weigh_and_learn_alike(problem, robot):
    bounded = problem.replace(steps=6, constraints=LIMITS)
    compiled = CompiledProblem([bounded])
    plain = compiled.interpreted()
    plain.__dict__["problems"] = compiled.problems
    rng = np.random.default_rng(0)
    nodes = bounded.start + 0.05 * rng.standard_normal((8, robot.nx))
    steps = []
    for own, kind in ((compiled, RecedingHorizon), (plain, InterpretedHorizon)):
        horizon, bounds = kind(own, 1e-4), bounds_of(own)
        horizon.nodes[:] = nodes
        for _ in range(3):
            bounds.weigh(horizon)
            usable = horizon.prepare()
            horizon.nodes[:2] += 0.01  # the measurement
            bounds.weigh_first(horizon)
            assert horizon.feedback(usable=usable)
            horizon.nodes[2:] += 0.1 * horizon.step
            horizon.evaluate()
            bounds.learn(horizon, 0.1)
        steps.append(horizon.nodes.copy())
    np.testing.assert_allclose(steps[0], steps[1], atol=1e-7)


def test_planned_forces_stay_inside_a_cone(problem, robot):
    """All of them, as reports have them; the problem's ground holds twice the cone."""
    cone = octo.FrictionCones(mu=0.3, contacts="feet")
    use = []
    for constraints in ([cone], []):
        own = problem.replace(constraints=constraints)
        compiled = CompiledProblem([own])
        plans, _, _, controller = walked(own, robot, 1.5)
        compiled.p[:] = controller.compiled.p
        for plan in plans[50::5]:
            x = plan.x[: own.steps + 2]
            at = compiled.evaluate(compiled.unknowns(x[None]))
            at.nodes[0] = x
            made = measured(compiled, at, 0)
            force, normal = made["contact_force"], made["contact_normal"]
            load = (force * normal).sum(axis=-1)
            side = np.linalg.norm(force - load[..., None] * normal, axis=-1)
            carrying = load > 0.01 * own.weight
            use.append((side[carrying] / load[carrying]).max())
    held, free = np.split(np.array(use), 2)
    assert held.max() <= 0.3 < np.median(free)


def test_a_cone_limits_the_friction_that_is_set(problem):
    cone = octo.FrictionCones(mu=0.3, contacts="feet")
    controller = Controller(problem.replace(constraints=[cone]))
    controller.set_parameters({"contact.mu": 0.25})
    with pytest.raises(OctoError, match="contact.mu is 0.5, must be at most 0.3"):
        controller.set_parameters({"contact.mu": 0.5})
    with pytest.raises(OctoError, match="FrictionCones.mu is -1"):
        Controller(problem.replace(constraints=[octo.FrictionCones(mu=-1.0)]))


def test_multipliers_move_along_with_the_plan(problem):
    """By two and a half steps from where the plan was, however often it is shifted before there is
    another."""
    compiled = CompiledProblem([problem.replace(steps=6, constraints=LIMITS[:1])])
    horizon, bounds = RecedingHorizon(compiled, 1e-4), bounds_of(compiled)
    weights = compiled.q[0][:, compiled.functions.row_weights[2]]  # the multipliers
    horizon.nodes[:] = problem.start
    horizon.rows[:] = np.linspace(0.5, 1.2, 6)[:, None]  # where a step led, nearer step by step
    bounds.weigh(horizon)
    horizon.rows[:] = np.linspace(0.5, 1.2, 6)[:, None]
    bounds.learn(horizon, 1.0)
    bounds.keep()
    bounds.weigh(horizon)
    before = weights[:, 0].copy()
    assert np.ptp(before) > 0.01
    for _ in range(2):
        bounds.shift(2, 0.5)
        bounds.weigh(horizon)
        moved = np.interp(np.arange(6) + 2.5, np.arange(6), before)
        np.testing.assert_allclose(weights[:, 0], moved, rtol=1e-12)


def test_an_equality_holds(problem, robot):
    """One row of ours: two joints of opposite legs stay alike; slowly, for so it walks badly."""
    one, other = robot.actuated[1], robot.actuated[4]
    alike = octo.CustomConstraint(
        lambda step, p: step.x_next[int(one)] - step.x_next[int(other)], lower=0.0, upper=0.0
    )
    plans, _, places, _ = walked(problem.replace(constraints=[alike]), robot, 2.0, 0.2)
    off = [np.abs(plan.x[4:20, one] - plan.x[4:20, other]).max() for plan in plans[100:]]
    assert places[-1, 2] > 0.8 * problem.start[2] and np.median(off) < 0.03


@pytest.mark.slow
def test_a_long_motion_keeps_them_too():
    robot = octo.gallery.chain()
    costs = [octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()]
    free = octo.Problem(robot, steps=24, dt=0.025, costs=costs)
    most = 0.6 * np.abs(animate(free, 0.6, advance=6).u).max()
    bounded = free.replace(constraints=[octo.TorqueLimits(limit=most)])
    motion = animate(bounded, 0.6, advance=6)
    fd = free.dynamics.evaluate(motion.x[None], free.p[None])[0][0][:, robot.actuated]
    assert motion.converged and np.abs(fd).max() <= 1.01 * most
