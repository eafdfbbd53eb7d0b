"""Rows that must hold: each against a formula in NumPy, bounds, hard forms, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from walker import START, walker, wiggle_near_ground

import octo
from octo import native
from octo.errors import OctoError
from octo.gpu.problem import DeviceProblem
from octo.model.kinematics import body_poses
from octo.problem.bounds import bounded_rows
from octo.problem.compiled import CompiledProblem
from octo.solve import evaluated
from octo.solver.status import Status
from tests import emulator
from tests.emulator import EmulatedDevice

STEPS, DT, INF = 8, 0.05, np.inf
ROBOT = walker()
TARGET = START + 0.1


def described(*constraints: Any, model: Any = ROBOT, x0: Any = START, **more: Any) -> octo.Problem:
    given = {"costs": [octo.Effort()], **more}
    return octo.Problem(model, steps=STEPS, dt=DT, x0=x0, constraints=constraints, **given)


def swing(**more: Any) -> dict[str, Any]:
    """User-written dynamics of two coordinates, one of them driven."""
    fd = octo.CustomDynamics(lambda a, b, c, p: (a - 2 * b + c) / p["dt"] ** 2, 2, [0], {})
    return {"model": fd, "x0": np.zeros(2), **more}


# -- rows and bounds -------------------------------------------------------------------------------


def _base(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rotation, position = body_poses(ROBOT, x)
    return rotation[:, 0], position[:, 0]


def _cones(motion: octo.Solution) -> np.ndarray:
    """Of the three contacts that touch the terrain, relative to mg."""
    normal, force = motion.contact_normal, motion.contact_force / motion.weight
    along = np.sum(normal * force, axis=2)
    across = np.linalg.norm(force - along[..., None] * normal, axis=2)
    return across**2 / np.hypot(across, 0.01) / (0.5 * (along + np.hypot(along, 0.02)))


JOINTS = [6, 7, 8]  # hip, knee, mast
UP = np.array([0.0, 0.0, 1.0])
# the rows of a motion (N, rows), and their bounds
ROWS: dict[str, tuple[Any, Callable[[octo.Solution], np.ndarray], Any, Any]] = {
    "torques": (octo.TorqueLimits(), lambda m: m.u[:, :2] / [8.0, 6.0], -1.0, 1.0),
    "torques of one limit": (octo.TorqueLimits(4.0, 0.5), lambda m: m.u / 2.0, -1.0, 1.0),
    "some torques": (
        octo.TorqueLimits([3.0, INF, 0.0]),
        lambda m: m.u[:, [0, 2]] / [3, 1],
        [-1, 0],
        [1, 0],
    ),
    "joints": (octo.JointLimits(), lambda m: m.x[2:, JOINTS], [-1, -1.5, -0.1], [1, 0.2, 0.1]),
    "joints, inside": (
        octo.JointLimits(margin=0.1),
        lambda m: m.x[2:, JOINTS],
        [-0.9, -1.4, -0.05],
        [0.9, 0.1, 0.05],
    ),
    "speeds": (
        octo.JointSpeedLimits([2.0, 5.0, INF]),
        lambda m: np.diff(m.x[1:, [6, 7]], axis=0) / DT / [2.0, 5.0],
        -1.0,
        1.0,
    ),
    "steps": (octo.StepLimit(), lambda m: np.diff(m.x[1:], axis=0) / 0.5, -1.0, 1.0),
    "height": (octo.BaseHeightRange(0.3, 0.5), lambda m: _base(m.x[2:])[1][:, 2:], 0.3, 0.5),
    "tilt": (
        octo.TiltLimit(0.3, pose=np.zeros(9)),
        lambda m: _base(m.x[2:])[0][:, 2, 2:],
        np.cos(0.3),
        INF,
    ),
    "friction": (octo.FrictionCones(0.5), _cones, -INF, 0.5),
    "friction of feet": (
        octo.FrictionCones(0.5, contacts="feet"),
        lambda m: _cones(m)[:, :2],
        -INF,
        0.5,
    ),
    "own": (
        octo.CustomConstraint(lambda s, p: s.x_next[6:8] * p["k"], [0, -INF], 2, {"k": (2.0, 3.0)}),
        lambda m: m.x[2:, 6:8] * [2.0, 3.0],
        [0, -INF],
        2.0,
    ),
    "a pose": (
        octo.PoseTarget(target=TARGET, coordinates=[4.0] * 6 + [0.0] * 3, at="all"),
        lambda m: (m.x[2:] - TARGET) * ([1.0] * 6 + [0.0] * 3),
        [0.0] * 6 + [-INF] * 3,
        [0.0] * 6 + [INF] * 3,
    ),
    "a point": (
        octo.PointPosition(target=(0.1, 0.2, 0.3), axes=(9.0, 1.0, 0.0), weight=7.0),
        lambda m: (_base(m.x[2:])[1] - [0.1, 0.2, 0.3]) * [1.0, 1.0, 0.0],
        [0.0, 0.0, -INF],
        [0.0, 0.0, INF],
    ),
    "torques, meant hard": (octo.TorqueLimit(0.8), lambda m: m.u[:, :2] / [6.4, 4.8], -1.0, 1.0),
}


@pytest.mark.parametrize("basis", ["nodes", octo.Hermite(4)], ids=["nodes", "hermite"])
@pytest.mark.parametrize("name", ROWS)
def test_rows_and_bounds(name: str, basis: Any) -> None:
    constraint, formula, lower, upper = ROWS[name]
    problem = described(constraint, basis=basis)
    compiled = CompiledProblem([problem])
    at = compiled.evaluate(wiggle_near_ground(compiled))
    plain = problem.replace(constraints=[], basis="nodes")
    motion = evaluated(plain, at.nodes[0, 1:], Status.SIMULATED)
    expected = formula(motion)
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(at.rows[0], expected, rtol=0, atol=1e-9 * scale)
    for found, bound in ((compiled.lower, lower), (compiled.upper, upper)):
        np.testing.assert_allclose(found[0], np.broadcast_to(bound, expected.shape), atol=1e-14)
    assert len(bounded_rows(problem, compiled.functions)) == expected.shape[1]
    assert at.terms.shape[2] == 2 and not at.terms[:, :, 1].any()


def test_bounds_stand_in_the_order_of_the_rows_and_go_with_members() -> None:
    """A bounded term of E without bounds first, then two constraints, the last one at the end."""

    class Bounded(octo.CustomCost):
        kind = "bounded"

    def one(largest: float) -> octo.Problem:
        own = Bounded(lambda step, p: step.u[0], name="own")
        last = octo.BaseHeightRange(upper=0.6, at="last")
        return described(octo.StepLimit(largest), last, costs=[octo.Effort(), own])

    compiled = CompiledProblem([one(0.2), one(0.3)])
    assert compiled.lower.shape == (2, STEPS, 11)
    assert np.isinf(compiled.lower[:, :, 0]).all() and np.isinf(compiled.upper[:, :, 0]).all()
    np.testing.assert_array_equal(compiled.upper[:, :, 1:10], 1.0)
    assert np.isinf(compiled.upper[:, :-1, 10]).all() and (compiled.upper[:, -1, 10] == 0.6).all()
    at = compiled.evaluate(wiggle_near_ground(compiled))
    changes = np.diff(at.nodes[:, 1:], axis=1) / np.array([0.2, 0.3])[:, None, None]
    np.testing.assert_allclose(at.rows[:, :, 1:10], changes, atol=1e-12)
    part = compiled.take(np.array([1]))
    np.testing.assert_array_equal(part.lower, compiled.lower[1:])


@pytest.mark.parametrize(
    "at, steps",
    [([0, 3, -1], [0, 3, 7]), (octo.At([0.1, 0.26]), [1, 4]), (np.arange(8) > 5, [6, 7])],
)
def test_when_it_must_hold(at: Any, steps: list[int]) -> None:
    compiled = CompiledProblem([described(octo.StepLimit(at=at), octo.PointPosition(at=at))])
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(compiled.upper[0, :, 0])), steps)
    np.testing.assert_array_equal(np.flatnonzero(compiled.upper[0, :, 9] == 0.0), steps)
    np.testing.assert_array_equal(np.flatnonzero(compiled.used_rows[0, :, 0]), steps)


def test_bounds_change_without_a_new_compilation() -> None:
    bounds = np.array([-0.3, 0.4])
    problem = described(octo.CustomConstraint(lambda s, p: s.x_next[6:8], lower=bounds, upper=2.0))
    compiled = CompiledProblem([problem])
    problem.constraints[0].lower[:] = [-0.2, 0.1]
    compiled.refresh()
    np.testing.assert_array_equal(compiled.lower[0], np.tile([-0.2, 0.1], (STEPS, 1)))
    np.testing.assert_array_equal(bounds, [-0.3, 0.4])  # the caller's own


def test_without_constraints_nothing_changes() -> None:
    plain = octo.Problem(ROBOT, steps=STEPS, dt=DT, x0=START, costs=[octo.Effort()])
    one, other = CompiledProblem([plain]), CompiledProblem([described()])
    assert one.program.c_text() == other.program.c_text() and "NBOUNDED 0" in one.program.c_text()
    assert other.lower.shape == (1, STEPS, 0)


# -- fixed states ----------------------------------------------------------------------------------


def test_what_a_fixed_state_settles_is_taken_out_where_it_holds() -> None:
    """Rows of the last node and of the last two have one value there, torques not."""
    hip = octo.CustomConstraint(lambda s, p: s.x_next[6], lower=-2.0, upper=2.0, name="hip")
    constraints = (octo.PoseTarget(target=TARGET), octo.StepLimit(), octo.TorqueLimits(), hip)
    compiled = CompiledProblem([described(*constraints, x_end=TARGET)])
    settled = np.isinf(compiled.upper[0])
    assert settled[:, :9].all()  # the target
    assert settled[-1, 9:18].all() and not settled[:-1, 9:18].any()  # a step of no length
    assert not settled[:, 18:20].any()
    np.testing.assert_array_equal(settled[:, 20], [False] * (STEPS - 2) + [True, True])


# -- what is refused -------------------------------------------------------------------------------


REFUSED: dict[str, tuple[list[Any], dict[str, Any], str]] = {
    "a step that is none": ([octo.StepLimit(at=[9])], {}, "StepLimit.at has the step 9"),
    "no list": (["x"], {}, "constraints holds 'x', must hold octo.Constraint or octo.Cost"),
    "two of a name": ([octo.StepLimit(), octo.StepLimit(0.1)], {}, "two terms named 'StepLimit'"),
    "a loss": ([octo.Posture(loss=octo.Huber(1.0))], {}, "Posture has a loss"),
    "over contacts": ([octo.Slip()], {}, "Slip is over contacts and has no hard form"),
    "two steps": ([octo.TorqueRate()], {}, "TorqueRate is over two steps in a row"),
    "neighbours": (
        [octo.NeighbourCost(lambda a, b, p: a - b)],
        {},
        "NeighbourCost .* no hard form",
    ),
    "a list's": (octo.costs.natural()[:1], {}, "has no hard form: give the term itself"),
    "no torque limit": (
        [octo.TorqueLimits()],
        swing(),
        r"TorqueLimits has no limit: user-written dynamics have none, give limit=…, a number",
    ),
    "no speed limit": ([octo.JointSpeedLimits()], {}, "JointSpeedLimits has no limit: 'walker'"),
    "all infinite": ([octo.StepLimit(INF)], {}, "StepLimit has no limit: all are infinite"),
    "no bound": ([octo.BaseHeightRange()], {}, "BaseHeightRange has no bound"),
    "no joint limits": ([octo.JointLimits()], swing(), "which have no joint limits"),
    "no contacts": ([octo.FrictionCones()], swing(), "which user-written dynamics do not have"),
    "none chosen": ([octo.FrictionCones(contacts=())], {}, "FrictionCones has no contacts"),
    "a negative limit": ([octo.TorqueLimits(-1.0)], {}, r"TorqueLimits.limit has -1, must be"),
    "limits of others": ([octo.TorqueLimits([1.0])], {}, r"shape \(1,\), expected \(\) or \(3,\)"),
    "a wide tilt": ([octo.TiltLimit(4.0)], {}, "TiltLimit.largest is 4 rad"),
    "the wrong way round": (
        [octo.BaseHeightRange(0.4, 0.2)],
        {},
        "the base has the lower bound 0.4 and the upper bound 0.2 m at step 0",
    ),
    "no number": ([octo.BaseHeightRange(np.nan)], {}, "BaseHeightRange.lower is not a number"),
    "a wrong shape": (
        [octo.CustomConstraint(lambda s, p: s.x, lower=[1, 2, 3])],
        {},
        r"CustomConstraint.lower has shape \(3,\), expected \(9,\) or \(8, 9\)",
    ),
    "no function": ([octo.CustomConstraint(upper=1.0)], {}, "CustomConstraint.function is missing"),
    "another end": (
        [octo.PoseTarget(target=TARGET)],
        {"x_end": TARGET + 0.2 * np.eye(9)[6]},
        "joint 'hip' − target is 0.2 rad at step 7, where the state is fixed, must be 0",
    ),
    "an end beyond a limit": (
        [octo.JointLimit(0.0)],
        {"x_end": np.append(START[:6], [1.2, 0.0, 0.0])},
        "joint 'hip' is 1.2 rad at step 6, where the state is fixed, must be between -1",
    ),
    "a tilted end": (
        [octo.TiltLimit(0.2, pose=np.zeros(9))],
        {"x_end": np.array([0, 0, 0.5, 0, 0.4, 0, 0, 0, 0])},
        "the base is 0.4 rad at step 6, where the state is fixed, must be at most 0.2",
    ),
    "a start": (
        [octo.CustomConstraint(lambda s, p: s.x, lower=1.0)],
        swing(),
        "CustomConstraint: row 0 is 0 at step 0, where the state is fixed, must be at least 1",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name: str) -> None:
    constraints, more, message = REFUSED[name]
    with pytest.raises(OctoError, match=message):
        CompiledProblem([described(*constraints, **more)])


def test_problems_of_one_batch_have_the_same_constraints() -> None:
    one, other = described(octo.StepLimit()), described(octo.StepLimit([0.5] * 8 + [INF]))
    with pytest.raises(
        OctoError, match="StepLimit.largest .* of problem 1 is not that of problem 0"
    ):
        CompiledProblem([one, other])
    with pytest.raises(OctoError, match="terms differ"):
        CompiledProblem([one, described()])


CURVED = {
    "a product": octo.CustomConstraint(lambda s, p: ca.sin(s.x_next[6]) * s.x[7], 0.0, 1.0),
    "friction": octo.FrictionCones(0.5),
    "friction and bodies": octo.CustomConstraint(
        lambda s, p: s.contact("foot").force[0] * s.com[2] + s.pose("shank")[1][0] ** 2, upper=1.0
    ),
}


@pytest.mark.parametrize("ground", ["plane", "wave"])
@pytest.mark.parametrize("name", CURVED)
def test_curvature_of_a_constraint_is_exact(name: str, ground: str) -> None:
    """With D next to nothing, H has the second derivative of Σ d r: differences of its slope."""
    wave = octo.Terrain(lambda x, p: x[2] - 0.02 * ca.sin(9 * x[0])) if ground == "wave" else None
    compiled = CompiledProblem([described(CURVED[name], terrain=wave)])
    unknowns, random = wiggle_near_ground(compiled), np.random.default_rng(3)
    shape = (1, STEPS, len(compiled.functions.bounded))
    weights, shifts = np.full(shape, 1e-12), random.uniform(0.5, 1.5, shape)
    direction = random.standard_normal(unknowns.shape)

    def own(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """H and b of the shifts alone."""
        made = []
        for d in (shifts, 0.0 * shifts):
            compiled.set_row_weights(weights, d)
            model = compiled.linearize(
                compiled.evaluate(at), np.zeros((1, compiled.K, compiled.ma))
            )
            made.append((model.H[0], model.b[0]))
        return made[0][0] - made[1][0], made[0][1] - made[1][1]

    H = own(unknowns)[0]
    product = np.zeros_like(unknowns[0])
    for k in range(compiled.K):
        for o in range(min(k + 1, 3)):
            product[k] += H[k, o] @ direction[0, k - o]
            if o:
                product[k - o] += H[k, o].T @ direction[0, k]
    h = 1e-6
    ahead, behind = (own(unknowns + side * direction)[1] for side in (h, -h))
    expected = (ahead - behind) / (2 * h)
    np.testing.assert_allclose(product, expected, atol=3e-6 * np.abs(expected).max())


@pytest.mark.skipif(native.compiler() is None or emulator.compiler() is None, reason="compiler")
@pytest.mark.parametrize("backend", ["interpreted", "CUDA"])
def test_backends_agree(backend: str) -> None:
    feet = octo.FrictionCones(0.5, contacts=("foot", "front"))
    compiled = CompiledProblem([described(octo.TorqueLimits(), feet, octo.TiltLimit(0.3))] * 2)
    device = EmulatedDevice(32, 1)
    other = compiled.interpreted() if backend == "interpreted" else DeviceProblem(compiled, device)
    unknowns, random = wiggle_near_ground(compiled), np.random.default_rng(5)
    at, own = compiled.evaluate(unknowns), other.evaluate(unknowns)
    np.testing.assert_allclose(np.asarray(own.rows), at.rows, atol=1e-9 * np.abs(at.rows).max())
    weights, shifts = random.uniform(0.1, 1.0, at.rows.shape), random.standard_normal(at.rows.shape)
    lam = random.standard_normal((2, compiled.K, compiled.ma))
    models = []
    for problem, point in ((compiled, at), (other, own)):
        problem.set_row_weights(weights, shifts)
        models.append(problem.linearize(point, lam))
    for field in ("H", "A", "b", "C"):
        expected, found = (np.asarray(getattr(model, field)) for model in models)
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


# -- reports ---------------------------------------------------------------------------------------


def test_a_solution_says_the_worst_row_of_each_constraint(tmp_path) -> None:
    nodes = np.tile(START, (STEPS + 1, 1))
    nodes[3:, 6] = [0.5, 0.9, 1.2, 1.0, 0.4, 0.3]  # rad, the hip
    nodes[4:, 4] = 0.2  # rad, the pitch
    held = octo.BaseHeightRange(0.2, 0.6)
    end = octo.PoseTarget(target=nodes[-1] + 1e-3 * np.eye(9)[7], name="end")
    tilt, place = octo.TiltLimit(0.1, pose=np.zeros(9)), octo.JointLimit(0.0)
    problem = described(octo.StepLimit(0.3), place, tilt, held, end)
    motion = evaluated(problem, nodes, Status.SIMULATED)
    assert list(motion.terms) == ["Effort"]
    steps, joints, angle, height, reached = motion.bounds
    assert (steps.row, steps.step, steps.side, steps.unit) == ("joint 'hip'", 6, "at least", "rad")
    np.testing.assert_allclose((steps.value, steps.bound, steps.excess), (-0.6, -0.3, 1.0))
    assert joints.time == pytest.approx(5 * DT) and joints.violation == pytest.approx(0.2)
    assert angle.side == "at most" and angle.bound == pytest.approx(0.1)
    cosine = np.cos(0.2) * np.cos(START[5])
    assert angle.value == pytest.approx(np.arccos(cosine)) and not angle.held
    assert height.held and height.excess < 0.0 and height.violation == 0.0
    assert height.value == pytest.approx(START[2]) and height.bound == 0.6
    assert reached.side == "exactly" and reached.step == STEPS - 1
    text = str(motion)
    assert (
        "JointLimit broken by 0.2 rad: joint 'hip' is 1.2 rad at 0.25 s, must be at most 1" in text
    )
    assert "BaseHeightRange held: the base is 0.44 m at" in text
    assert [one["held"] for one in motion.report()["bounds"]] == [False, False, False, True, False]
    motion.save(tmp_path / "motion.npz")
    assert octo.Solution.load(tmp_path / "motion.npz").bounds == motion.bounds


def test_torques_are_said_in_newton_metres_and_friction_as_a_share() -> None:
    problem = described(octo.TorqueLimits(), octo.FrictionCones(0.1, contacts=("foot",)))
    compiled = CompiledProblem([problem])
    nodes = compiled.evaluate(wiggle_near_ground(compiled)).nodes[0, 1:]
    motion = evaluated(problem, nodes, Status.SIMULATED)
    torque, cone = motion.bounds
    share = np.abs(motion.u[:, :2]) / [8.0, 6.0]
    step, joint = np.unravel_index(np.argmax(share), share.shape)
    assert (torque.step, torque.unit, torque.row) == (
        step,
        "N m",
        f"joint '{['hip', 'knee'][joint]}'",
    )
    assert abs(torque.value) == pytest.approx(abs(motion.u[step, joint]))
    assert abs(torque.bound) == pytest.approx([8.0, 6.0][joint])
    assert (cone.unit, cone.bound, cone.row) == ("", 0.1, "|f_t|/f_n of contact 'foot'")
    assert cone.value == pytest.approx(_cones(motion)[:, 0].max())


def test_user_written_coordinates_have_the_names_of_the_solution() -> None:
    given = swing(costs=[octo.Effort(reference=1.0)])
    problem = described(octo.TorqueLimits(3.0), octo.StepLimit([INF, 0.1]), **given)
    nodes = np.linspace(0.0, 0.4, STEPS + 1)[:, None] * [1.0, 2.0]
    torque, step = evaluated(problem, nodes, Status.SIMULATED).bounds
    assert (torque.row, torque.unit, torque.bound) == ("u0", "", 3.0)
    assert (step.row, step.value) == ("x1", pytest.approx(0.1))


def test_a_constraint_that_a_fixed_state_settles_has_no_line() -> None:
    problem = described(octo.PoseTarget(target=START), x_end=START)
    assert evaluated(problem, np.tile(START, (STEPS + 1, 1)), Status.SIMULATED).bounds == ()
