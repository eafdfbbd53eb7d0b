"""Numbers that change without a recompilation, scales of the terms, batches of problems, and what
is refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import octo
from octo import native
from octo.errors import OctoError, ProblemError, ShapeError
from octo.model import gallery
from octo.model.kinematics import body_poses
from octo.problem.basis import Hermite
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem
from octo.solver.blocks import KKTBlocks

START, STEPS, DT = np.array([0.1, -0.2, 0.3]), 24, 0.05


def point(basis="nodes", costs=(), **more) -> Problem:
    """Three coordinates with a mass each and a spring between two of them; the first is pushed."""

    def dynamics(x_next, x, x_prev, p):
        return (x_next - 2 * x + x_prev) / p["dt"] ** 2 + p["spring"] * ca.sin(
            x_next[[1, 2, 0]] - x_next
        )

    model = octo.CustomDynamics(dynamics, nx=3, actuated=[0], parameters={"spring": 2.0})
    return Problem(model, steps=STEPS, dt=DT, x0=START, basis=basis, costs=list(costs), **more)


def moving(problem: CompiledProblem) -> np.ndarray:
    rows = np.sin(np.linspace(0.0, 3.0, STEPS + 2))[:, None] * [0.5, 1.0, -0.3]
    return problem.unknowns((START + rows)[None].repeat(problem.batch, axis=0))


@pytest.fixture
def no_compilation(monkeypatch):
    """Building a text that is not in the cache yet fails the test."""

    def refuse(*_, **__):
        raise AssertionError("the compiler was started")

    return lambda: monkeypatch.setattr(native.subprocess, "run", refuse)


@pytest.mark.parametrize("basis", ["nodes", Hermite(4)])
def test_changed_in_place_and_refreshed(no_compilation, basis):
    """Terms whose arrays change in place: the same as terms made with the new numbers; nothing is
    compiled."""

    def rise(c, c_next, p):
        return p["gain"] * (c_next - c)

    term = octo.NeighbourCost(rise, {"gain": np.array([0.5])}, weight=np.ones(STEPS))
    shared = point(basis, [octo.Effort(), term])
    problem = CompiledProblem([shared])
    at = moving(problem)
    before = problem.term_values(problem.evaluate(at))[0]
    no_compilation()
    term.values["gain"][:] = 1.0
    term.weight[:] = 3.0
    problem.refresh()
    evaluation = problem.evaluate(at)
    np.testing.assert_allclose(
        problem.term_values(evaluation)[0], before * [1.0, 4.0 * 3.0], rtol=1e-12
    )
    replaced = CompiledProblem(
        [shared.replace(costs=[octo.Effort(), octo.NeighbourCost(rise, {"gain": 1.0}, weight=3.0)])]
    )
    same = replaced.evaluate(at)
    for name in ("H", "A", "b", "C"):
        new, refreshed = (
            getattr(p.linearize(e, None), name)
            for p, e in ((replaced, same), (problem, evaluation))
        )
        np.testing.assert_allclose(
            new, refreshed, rtol=0.0, atol=1e-12 * max(1.0, np.abs(refreshed).max())
        )


def test_replaced_numbers_compile_nothing(compiled, every_cost, no_compilation):
    first = compiled("nodes").problems[0]
    CompiledProblem([first]).evaluate(np.zeros((1, 24, 9)))
    no_compilation()
    costs = every_cost()
    costs[0] = octo.CenterOfMassVelocity((1.0, 0.0, 0.0), weight=2.0)
    changes = {
        "costs": costs,
        "dt": 0.03,
        "parameters": {"contact.w_perp": 1e5, "gravity_z": -1.6},
        "x0": first.start + 0.01,
    }
    problem = CompiledProblem([first.replace(**changes)])
    assert np.isfinite(problem.evaluate(np.zeros((1, 24, 9))).energy).all()
    longer = every_cost(30)
    CompiledProblem([first.replace(steps=30, costs=longer)]).evaluate(np.zeros((1, 30, 9)))


@pytest.mark.parametrize("basis", ["nodes", Hermite(4)])
def test_weights_by_step_and_at_the_last_step(basis):
    """E averages over the steps; steps="last" is the last step alone, whatever their number."""
    x_end = octo.CustomCost(lambda step, p: step.x_next, name="end", steps="last", weight=2.0)
    each = octo.CustomCost(lambda step, p: step.x_next, name="each", weight=np.arange(24.0))
    pairs = octo.NeighbourCost(lambda c, c_next, p: c_next[:3], name="pairs", steps="last")
    problem = CompiledProblem([point(basis, [x_end, each, pairs])])
    at = problem.evaluate(moving(problem))
    squares = (at.nodes[:, 2:] ** 2).sum(axis=2)
    expected = np.stack(
        [2.0 * squares[:, -1], (np.arange(24.0) * squares).mean(axis=1), squares[:, -1]], axis=1
    )
    np.testing.assert_allclose(problem.term_values(at), expected, rtol=1e-12)


@pytest.mark.parametrize("compiled_code", [True, False])
def test_a_step_without_weight_is_not_looked_at(compiled_code):
    """A residual that is not finite at a step whose weight is zero disturbs nothing, the curvature
    of the torques included."""
    weight = np.ones(STEPS)
    weight[3] = 0.0
    away = octo.CustomCost(
        lambda step, p: step.u / p["distance"],
        {"distance": weight[:, None]},
        weight=weight,
        name="away",
    )
    plain = octo.CustomCost(
        lambda step, p: step.u / p["distance"],
        {"distance": np.ones((STEPS, 1))},
        weight=weight,
        name="away",
    )
    found = []
    for term in (away, plain):
        problem = CompiledProblem([point(costs=[term])])
        if not compiled_code:
            problem = problem.interpreted()
        at = problem.evaluate(moving(problem))
        model = problem.linearize(at, np.ones((1, problem.K, problem.ma)))
        found.append((at.energy, model.H, model.A, model.b, model.C))
    for one, other in zip(*found, strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_array_equal(one, other)


def test_neighbours_in_both_bases_see_the_same_straight_motion():
    """In the Hermite basis the velocities are over a segment of q steps, in nodes over one."""
    straight = octo.NeighbourCost(lambda c, c_next, p: c_next[:3] - c[:3] - c[3:], name="straight")
    rise = octo.NeighbourCost(lambda c, c_next, p: c_next[:3] - c[:3], name="rise")
    v0 = np.linspace(0.1, 0.5, 3)
    nodes = (START + DT * v0 * np.arange(-1, STEPS + 1)[:, None])[None]
    for basis, q in (("nodes", 1), (Hermite(4), 4)):
        problem = CompiledProblem([point(basis, [straight, rise], v0=v0)])
        values = problem.term_values(problem.evaluate(problem.unknowns(nodes)))[0]
        np.testing.assert_allclose(values, [0.0, (q * DT) ** 2 * (v0 @ v0)], atol=1e-15)


@pytest.mark.parametrize("pinned", [False, True])
def test_hessian_of_a_linear_neighbour_term(pinned):
    """E of a linear residual is the quadratic that E, b and H say, to rounding."""
    weights = np.random.default_rng(0).standard_normal((6, 6))
    rising = np.linspace(1.0, 2.0, STEPS)
    mixed = octo.NeighbourCost(
        lambda c, c_next, p: ca.DM(weights) @ c_next - c + p["a"], {"a": 0.3}, weight=rising
    )
    for basis in ("nodes", Hermite(4)):
        problem = CompiledProblem([point(basis, [mixed], x_end=START + 0.1 if pinned else None)])
        unknowns = moving(problem)
        at = problem.evaluate(unknowns)
        d = np.random.default_rng(1).standard_normal(unknowns.shape)
        d[:, problem.fixed] = 0.0
        model = problem.linearize(at, None)
        product = KKTBlocks(model.H, model.A, model.b, model.C).hessian_times(d)
        expected = at.energy[0] + (model.b * d).sum() + 0.5 * (d * product).sum()
        assert problem.evaluate(unknowns + d).energy[0] == pytest.approx(expected, rel=1e-12)


def test_neighbour_term_at_a_pinned_end():
    """The last control is pinned and still seen by the term."""
    rise = octo.NeighbourCost(lambda c, c_next, p: c_next[:3] - c[:3], name="rise")
    for basis, q in (("nodes", 1), (Hermite(4), 4)):
        problem = CompiledProblem(
            [point(basis, [rise], x_end=START + 0.1, v_end=0.02 * np.ones(3))]
        )
        at = problem.evaluate(moving(problem))
        knots = at.nodes[0, 1::q]
        np.testing.assert_allclose(
            at.energy[0], (np.diff(knots, axis=0) ** 2).sum() / (len(knots) - 1), rtol=1e-12
        )
        np.testing.assert_allclose(at.nodes[0, -1], START + 0.1, atol=1e-15)


def test_a_fixed_last_state_has_its_velocity(compiled):
    first = compiled("nodes").problems[0]
    v_end = np.linspace(-1.0, 1.0, 9)
    problem = CompiledProblem([first.replace(x_end=first.start, v_end=v_end)])
    np.testing.assert_array_equal(problem.fixed, [22, 23])
    nodes = problem.evaluate(
        problem.unknowns(np.repeat(first.start[None, None], 26, axis=1))
    ).nodes[0]
    np.testing.assert_allclose((nodes[-1] - nodes[-2]) / first.dt, v_end, atol=1e-12)
    hermite = CompiledProblem([first.replace(x_end=first.start, v_end=v_end, basis=Hermite(4))])
    np.testing.assert_array_equal(hermite.fixed, [5, 6])
    nodes = hermite.evaluate(
        hermite.unknowns(np.repeat(first.start[None, None], 26, axis=1))
    ).nodes[0]
    # the cubic's slope at its end: τ v_end over one segment of four steps
    s = 1.0 - np.array([0.0, 1e-3])
    last = [nodes[-5 + k] for k in range(5)]
    fit = np.polynomial.Polynomial.fit(np.arange(5) / 4.0, np.array(last)[:, 8], 3)
    np.testing.assert_allclose((fit(s[0]) - fit(s[1])) / 1e-3, 4 * first.dt * v_end[8], rtol=1e-2)


def test_a_displaced_last_state_follows_the_start(compiled):
    """Where the ground is stiffer the start is higher, and the end with it."""
    first = compiled("nodes").problems[0]
    moved = np.linspace(0.0, 0.1, 9)
    for start in (first.start, first.start + 0.02):
        problem = CompiledProblem([first.replace(x0=start, displacement=moved)])
        nodes = problem.evaluate(problem.unknowns(np.repeat(start[None, None], 26, axis=1))).nodes[
            0
        ]
        np.testing.assert_allclose(nodes[-2:], np.stack([start + moved] * 2), atol=1e-12)


def test_energy_is_about_one_at_the_start_of_a_walk():
    """Every term is divided by a scale of its own: a robot that stands and should walk has E near
    1, at any speed."""
    for speed in (0.2, 0.5, 2.0):
        robot = gallery.biped()
        problem = Problem(
            robot,
            steps=10,
            dt=0.025,
            costs=octo.costs.paper((speed, 0.0, 0.0)),
            x0=robot.default_pose,
        )
        compiled = CompiledProblem([problem])
        at = compiled.evaluate(compiled.unknowns(np.repeat(problem.start[None, None], 12, axis=1)))
        values = dict(zip(("velocity", "effort"), compiled.term_values(at)[0], strict=True))
        assert values["velocity"] == pytest.approx(1.0, rel=1e-9)
        assert at.energy[0] < 1.5


def test_scales_are_floored_where_the_target_is_zero(compiled):
    setting = compiled("nodes").problems[0].setting
    assert octo.CenterOfMassVelocity().scale(setting) == pytest.approx(0.01)
    assert octo.CenterOfMassPosition(tuple(setting.com)).scale(setting) == pytest.approx(0.01)
    assert octo.CenterOfMassPosition(tuple(setting.com + [0.0, 0.0, 0.5])).scale(
        setting
    ) == pytest.approx(0.25)
    assert octo.CenterOfMassVelocity(np.array([[1.0, 0, 0], [0, 0, 0]])).scale(
        setting
    ) == pytest.approx(0.5)
    assert octo.PoseTarget(setting.x0 + 1.0).scale(setting) == pytest.approx(9.0)
    assert octo.PointPosition(None, target=(9.0, 0.44, 0.44), axes=(0, 1, 1)).scale(setting) < 1.0


def test_rows_of_the_constraints_are_in_weights(compiled):
    problem = compiled("nodes").problems[0]
    np.testing.assert_allclose(problem.row_scale[:3], 1.0 / problem.weight)
    np.testing.assert_allclose(problem.row_scale[3:], 1.0 / (problem.weight * problem.length))
    assert problem.weight == pytest.approx(3.0 * 9.81) and 0.3 < problem.length < 0.5


def different(problem: Problem) -> dict[str, Problem]:
    other = gallery.spider()
    return {
        "steps": problem.replace(steps=12),
        "terms": problem.replace(costs=[octo.Effort()]),
        "basis": problem.replace(basis=Hermite(5)),
        "model": Problem(other, steps=10, dt=0.025, costs=problem.costs, x0=other.default_pose),
    }


@pytest.mark.parametrize("what", ["steps", "terms", "basis", "model"])
def test_a_batch_of_different_problems_is_refused(what):
    robot = gallery.mammal()
    problem = Problem(robot, steps=10, dt=0.025, costs=octo.costs.paper(), x0=robot.default_pose)
    with pytest.raises(ProblemError, match=f"{what} differ between problems of one batch"):
        CompiledProblem([problem, different(problem)[what]])


def test_an_end_for_some_problems_only_is_refused():
    robot = gallery.mammal()
    problem = Problem(robot, steps=10, dt=0.025, costs=octo.costs.paper(), x0=robot.default_pose)
    with pytest.raises(ProblemError, match="x_end must be given for every problem"):
        CompiledProblem([problem, problem.replace(x_end=robot.default_pose)])


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_what_a_neighbour_term_raises_is_one_sentence(basis):
    basis = Hermite(4) if basis == "hermite" else basis
    for function in (lambda c, n, p: p["missing"] * c, lambda c, n, p: c[50], None):
        with pytest.raises(OctoError, match="NeighbourCost") as error:
            CompiledProblem([point(basis, [octo.NeighbourCost(function, {"gain": 1.0})])])
        assert "\n" not in str(error.value)
    with pytest.raises(
        ShapeError, match=r"NeighbourCost.weight has shape \(3,\), expected \(\) or \(24,\)"
    ):
        CompiledProblem([point(basis, [octo.NeighbourCost(lambda c, n, p: c, weight=np.ones(3))])])


def term_value(problem: CompiledProblem, at, label: str) -> float:
    return float(
        problem.term_values(at)[0, [t.label for t in problem.problems[0].costs].index(label)]
    )


def test_limits_of_joints_are_hinges(compiled, wiggle):
    """JointLimit begins ``margin`` inside, at most a quarter of the range; JointSpeedLimit counts
    parts of a limit."""
    problem = compiled("nodes")
    robot, at = problem.problems[0].character, problem.evaluate(wiggle(problem))
    q = at.nodes[0][:, robot.actuated]
    inside = np.minimum(0.3, 0.25 * (robot.upper - robot.lower)[robot.actuated])
    above = np.maximum(0.0, q[2:] - (robot.upper[robot.actuated] - inside))
    below = np.maximum(0.0, robot.lower[robot.actuated] + inside - q[2:])
    np.testing.assert_allclose(
        term_value(problem, at, "JointLimit"), ((above + below) ** 2).sum(axis=1).mean(), rtol=1e-10
    )
    # its robot says no limit, the term says 1 rad/s
    fast = np.maximum(0.0, np.abs(np.diff(q[1:], axis=0)) / DT - 0.1)
    np.testing.assert_allclose(
        term_value(problem, at, "JointSpeedLimit"), (fast**2).sum(axis=1).mean(), rtol=1e-10
    )
    first = problem.problems[0]
    without = octo.costs.JointSpeedLimit().references(first.setting)
    np.testing.assert_array_equal(without["inverse_limit"], 0.0)
    with pytest.raises(
        ProblemError,
        match="JointLimit is asked of user-written dynamics, which have no joint limits",
    ):
        CompiledProblem([point(costs=[octo.costs.JointLimit()])])


def test_upright_sees_tilt_and_not_heading(compiled, wiggle):
    """Its square is 2(1 − cos) of the angle between the body's up and the one at the start,
    whatever the yaw."""
    problem = compiled("nodes")
    robot, at = problem.problems[0].character, problem.evaluate(wiggle(problem))
    shank = robot.body_index("shank")
    up = body_poses(robot, at.nodes[0, 2:])[0][:, shank, 2]  # (N, 3)
    cosine = up @ body_poses(robot, problem.start[0])[0][shank, 2]
    found = term_value(problem, at, "Upright")
    np.testing.assert_allclose(found, 2.0 * (1.0 - cosine).mean(), rtol=1e-10)
    turned = at.nodes.copy()
    turned[:, :, 3] += 1.2
    assert term_value(
        problem, problem.evaluate(problem.unknowns(turned)), "Upright"
    ) == pytest.approx(found, rel=1e-10)


def test_slip_is_priced_by_load_and_speed_by_height(compiled, wiggle):
    """SlipPower: mean of Σ f_n/mg·|v_t|²; SwingClearance: mean of Σ |v_t|²·max(0, 1 − h/height)²
    over the feet."""
    problem = compiled("nodes")
    described, at = problem.problems[0], problem.evaluate(wiggle(problem))
    names, power, swing = [], 0.0, 0.0
    for i in range(STEPS):
        columns = problem.kinematics(at.nodes[0, i + 2], at.nodes[0, i + 1], problem.p[0])
        force, _, velocity, normal = (np.asarray(column).T for column in columns[:4])
        depth = np.asarray(columns[4]).ravel()
        along = velocity - normal * (normal * velocity).sum(axis=1, keepdims=True)
        speed = (along**2).sum(axis=1)
        power += (
            np.maximum((normal * force).sum(axis=1), 0.0) / described.weight * speed
        ).sum() / STEPS
        names = [described.character.contacts[k].name for k in described.character.terrain_contacts]
        feet = [names.index(name) for name in ("foot", "front")]  # in the ground at the start
        swing += (np.maximum(0.0, 1.0 + depth / 0.08) ** 2 * speed)[feet].sum() / STEPS
    assert power > 1e-3 and swing > 1e-3
    np.testing.assert_allclose(term_value(problem, at, "SlipPower"), power, rtol=1e-5)
    np.testing.assert_allclose(term_value(problem, at, "SwingClearance"), swing, rtol=1e-10)


def test_contact_rich_terms_have_the_length_of_their_problem() -> None:
    problem = Problem(gallery.chain(), steps=4, dt=DT, costs=octo.costs.contact_rich())
    given = octo.costs.contact_rich(length=problem.length)
    assert [one.label for one in problem.costs] == [one.label for one in given]
    assert [one.weight for one in problem.costs] == [one.weight for one in given]
    # four times as long: twice as slow, so that a swing of the joints costs the same
    longer = octo.costs.contact_rich(length=4.0 * problem.length)
    slower = {"JointVelocity": 4.0, "JointAcceleration": 16.0, "SlipPower": 0.25, "Effort": 1.0}
    for one, other in zip(given, longer, strict=True):
        if one.label in slower:
            assert other.weight == pytest.approx(slower[one.label] * one.weight)
    with pytest.raises(octo.errors.ValueRangeError, match="gravity"):
        octo.costs.contact_rich(length=0.3, gravity=0.0)
