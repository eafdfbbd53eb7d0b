"""A solved stride as a controller's reference: what is asked of each horizon against the tiled
motion, and the walk in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.errors import OctoError
from octo.model.kinematics import body_poses, sphere_centers
from octo.mpc import Controller, StrideReference, run, tracking_problem
from octo.plant import MujocoPlant
from octo.problem.compiled import CompiledProblem

SPEED = 0.4  # m/s


@pytest.fixture(scope="module")
def stride():
    cycle = octo.Cycle(speed=SPEED, period=0.8)
    problem = octo.Problem(octo.load("biped"), costs=octo.costs.natural(), cycle=cycle)
    found = octo.solve(problem)
    assert found.converged and found.cycle.mirrored
    return found


@pytest.fixture(scope="module")
def curve():
    """A cycle that turns, not solved: it closes all the same."""
    cycle = octo.Cycle(speed=0.3, period=0.6, turn=0.3, mirror=False)
    problem = octo.Problem(octo.load("mammal"), costs=[octo.Effort()], cycle=cycle)
    return octo.solve(problem, passes=1, max_iterations=15)


def wanted(stride, times, x, dt):
    """Configurations (times, N+1, n) asked of horizons that begin at ``times``, the robot being at
    the first node of each, and torques; the robot stands at x (n,) first."""
    problem = tracking_problem(stride, steps=12, dt=dt)
    reference = StrideReference(stride)
    controller = Controller(problem, guide=reference)
    reference.reset()
    nodes, torques = [], []
    for t in times:
        reference(controller, float(t), x)
        target = controller.reference("ConfigurationTracking", "target").copy()
        rate = controller.reference("RateTracking", "rate")
        x = target[0] - dt * rate[0]
        np.testing.assert_allclose(np.diff(target, axis=0) / dt, rate[1:], atol=1e-9)
        nodes.append(np.concatenate([x[None], target]))
        torques.append(controller.reference("TorqueTracking", "torque").copy())
    return np.array(nodes), np.array(torques)


def test_what_is_asked_is_the_tiled_stride(stride):
    """At its nodes, of three strides, both halves of each."""
    tiled, dt = stride.tile(4), stride.dt
    starts = np.arange(0, 96, 7)
    nodes, torques = wanted(stride, dt * starts, stride.x[1], dt)
    for k, start in enumerate(starts):
        np.testing.assert_allclose(nodes[k], tiled.x[1 + start : 14 + start], atol=1e-9)
        np.testing.assert_allclose(torques[k], tiled.u[start : start + 12], atol=1e-8)


def test_a_curve_goes_on_along_its_arc(curve):
    tiled, dt = curve.tile(4), curve.dt
    starts = np.arange(0, 70, 9)
    nodes, torques = wanted(curve, dt * starts, curve.x[1], dt)
    for k, start in enumerate(starts):
        np.testing.assert_allclose(nodes[k], tiled.x[1 + start : 14 + start], atol=1e-9)
        np.testing.assert_allclose(torques[k], tiled.u[start : start + 12], atol=1e-8)


def test_strides_that_are_tiled_already_go_on(stride):
    long, starts = stride.tile(6), np.arange(0, 130, 10)
    nodes, _ = wanted(stride.tile(2), stride.dt * starts, stride.x[1], stride.dt)
    for k, start in enumerate(starts):
        np.testing.assert_allclose(nodes[k], long.x[1 + start : 14 + start], atol=1e-9)


def test_on_a_slope_it_moves_along_the_ground():
    cycle, rise = octo.Cycle(speed=0.3, period=0.6), np.tan(0.1)
    problem = octo.Problem(
        octo.load("mammal"), costs=[octo.Effort()], cycle=cycle, terrain=octo.Plane(slope=0.1)
    )
    climb = octo.solve(problem, passes=1, max_iterations=10)
    lower = climb.x[1].copy()
    lower[:2] -= 0.5, 0.2
    (up, _), (down, _) = (wanted(climb, [0.0, 0.7], x, climb.dt) for x in (climb.x[1], lower))
    np.testing.assert_allclose(up - down, np.r_[0.5, 0.2, 0.5 * rise, np.zeros(15)] + 0.0 * up)


def test_it_begins_where_the_robot_is_and_heads(stride):
    """The same motion about a vertical axis and elsewhere: all points of all bodies turn alike."""
    moved, angle, place = stride.x[1].copy(), 0.7, np.array([2.0, -1.0])
    c, s = np.cos(angle), np.sin(angle)
    moved[:2] = np.array([[c, -s], [s, c]]) @ moved[:2] + place
    moved[3] += angle
    times = stride.dt * np.arange(0, 80, 11)
    (straight, torques), (turned, others) = (
        wanted(stride, times, x, stride.dt) for x in (stride.x[1], moved)
    )
    robot = stride.character
    own, there = (sphere_centers(robot, x.reshape(-1, robot.nx)) for x in (straight, turned))
    around = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(there, own @ around.T + [*place, 0.0], atol=1e-9)
    np.testing.assert_allclose(torques, others, atol=1e-9)


def test_it_is_entered_at_the_phase_of_the_robot(stride):
    late = stride.tile(1).x[1 + 20]  # in the mirrored half
    nodes, _ = wanted(stride, [3.0], late, stride.dt)
    np.testing.assert_allclose(nodes[0], stride.tile(2).x[21:34], atol=1e-9)


def test_it_waits_for_a_robot_that_falls_behind_and_never_ends(stride):
    problem = tracking_problem(stride, steps=12)
    reference = StrideReference(stride)
    controller = Controller(problem, guide=reference)
    x, target = stride.x[1].copy(), controller.reference("ConfigurationTracking", "target")
    reference.reset()
    reference(controller, 0.0, x)
    for k in range(1, 300):  # it stands
        reference(controller, 0.05 * k, x)
    assert np.hypot(*(target[0, :2] - x[:2])) < 0.15 + 0.04 * 2.0 * SPEED
    late, began = 1e6, target[0, 0]
    reference.reset()
    reference(controller, late, x)
    for k in range(1, 2001):
        reference(controller, late + 0.01 * k, target[0] - 0.04 * SPEED * np.eye(len(x))[0])
    assert target[0, 0] - began == pytest.approx(20.0 * SPEED, abs=0.2)
    assert np.abs(target[0, 6:]).max() < 3.0


@pytest.fixture(scope="module")
def walked(stride):
    controller = Controller(tracking_problem(stride), guide=StrideReference(stride))
    plant = MujocoPlant(stride.character)
    x = stride.x[1].copy()
    x[stride.character.actuated] += 0.02 * np.random.default_rng(1).standard_normal(8)
    plant.reset_chart(x, (stride.x[1] - stride.x[0]) / stride.dt)
    return run(controller, plant, 8.0)


def test_a_biped_walks_with_it(walked, stride):
    assert not walked.falls and set(walked.statuses) == {"solved"}
    travelled = walked.x[-1, 0] - walked.x[200, 0]
    assert travelled / (walked.t[-1] - walked.t[200]) == pytest.approx(SPEED, abs=0.05)
    robot = stride.character
    rotation, origin = body_poses(robot, walked.x)
    height = origin[:, robot.base_body, 2]
    level = stride.com[:, 2].mean() - 0.1
    assert np.ptp(height) < 0.12 and height.min() > 0.8 * level
    assert rotation[:, robot.base_body, 2, 2].min() > np.cos(0.2)


def test_its_gait_is_the_stride_s(walked, stride):
    """Feet lift as high, left and right in turn, and do not slide."""
    left, right = walked.foot_height[:, 0], walked.foot_height[:, 2]
    assert np.corrcoef(left[200:], right[200:])[0, 1] < -0.2
    touchdowns = np.flatnonzero((left[1:] < 0.01) & (left[:-1] >= 0.01))
    late = touchdowns[touchdowns > 200]
    assert np.diff(walked.t[late]).mean() == pytest.approx(0.8, abs=0.08)
    assert walked.foot_lift > 0.03 and walked.slip_speeds.mean() < 0.05


def test_hard_limits_of_a_tracking_problem(stride):
    robot = stride.character
    limits = 0.8 * np.abs(stride.u).max()
    problem = tracking_problem(stride, constraints=[octo.TorqueLimits(limit=limits)])
    controller = Controller(problem, guide=StrideReference(stride))
    plant = MujocoPlant(robot)
    plant.reset_chart(stride.x[1], problem.start_velocity)
    log = run(controller, plant, 4.0)
    assert not log.falls and np.abs(log.u).max() <= limits


def test_the_terms_are_what_they_say(stride):
    """E of each against its own formula, at nodes off the reference."""
    problem = tracking_problem(stride, steps=5)
    rng = np.random.default_rng(0)
    nodes = problem.start + 0.05 * rng.standard_normal((7, problem.character.nx))
    compiled = CompiledProblem([problem])
    at = compiled.evaluate(compiled.unknowns(nodes[None]))
    nodes, joints = at.nodes[0], problem.character.actuated
    E = dict(zip([term.label for term in problem.costs], compiled.term_values(at)[0], strict=True))
    place, moving, push = problem.costs[:3]
    away = place.coordinates * (nodes[2:] - problem.start) ** 2
    rate = moving.coordinates * (np.diff(nodes[1:], axis=0) / problem.dt) ** 2
    fd = problem.dynamics.evaluate(nodes[None], problem.p[None])[0][0][:, joints]
    assert E["ConfigurationTracking"] == pytest.approx(away.sum(axis=1).mean())
    assert E["RateTracking"] == pytest.approx(rate.sum(axis=1).mean())
    part = (fd / (0.4 * problem.weight * problem.length)) ** 2
    assert E["TorqueTracking"] == pytest.approx(push.weight * part.sum(axis=1).mean())


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((), "stride is None, must be a Solution of a cycle"),
        ({"costs": []}, "costs is chosen by tracking_problem"),
        ({"friction": "a"}, "friction is 'a'"),
    ],
)
def test_refused(stride, given, said):
    with pytest.raises(OctoError) as caught:
        tracking_problem(None) if given == () else tracking_problem(stride, **given)
    assert str(caught.value).startswith(said)


def test_what_is_no_cycle_is_refused(walked):
    for make in (tracking_problem, StrideReference):
        with pytest.raises(OctoError, match="stride is no cycle"):
            make(walked.solution())


def test_from_a_shell(stride, tmp_path, capsys):
    stride.save(tmp_path / "stride.npz")
    given = ["--stride", str(tmp_path / "stride.npz"), "--seconds", "1"]
    assert main(["mpc", "biped", *given, "--out", str(tmp_path / "walk")]) == 0
    assert "ahead" in capsys.readouterr().out
    assert main(["mpc", "mammal", *given, "--out", str(tmp_path / "other")]) == 2
    assert "is of 'biped', must be of 'mammal'" in capsys.readouterr().err
