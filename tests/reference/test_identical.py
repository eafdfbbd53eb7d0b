"""The reference is the same problem: values and derivatives of three ways to evaluate it agree."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from extending.torque_rate import PowerChange

import octo
from octo import costs, native
from octo.errors import ShapeError
from octo.problem.basis import Hermite
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem
from octo.reference import Nlp, nlp
from octo.reference.layout import octo_layout, stage_layout
from octo.reference.library import Library
from octo.reference.program import (
    free_places,
    live_places,
    multipliers_of,
    parameter_vector,
    point_of,
    rows_of,
    step_function,
)

TOLERANCE = 1e-10
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


RATES = [costs.TorqueRate(weight=0.1), PowerChange(loss=costs.Huber(0.2)), costs.Effort()]


def _turned(step, p):
    return p["gain"] * ca.vertcat(
        step.com[0] * step.u[0], step.pose("left_shank")[1][2], step.com_velocity[2] ** 2
    )


def _between(control, following, p):
    return p["gain"] * (following - control) + 0.3 * following[2] * control[:1]


BOUNDED = ("bounded", "bounded, hermite", "bounded, cycle")


def _constraints() -> list[octo.Constraint]:
    """Rows over torques, two nodes, all nodes through a contact, and one that bends in a torque."""
    power = octo.CustomConstraint(lambda step, p: step.u[1] * step.x_next[8] ** 2, 0.1, 0.1, at=[2])
    cones = octo.FrictionCones(0.6, contacts=("front_left",))
    return [octo.TorqueLimits(), octo.JointSpeedLimits(limit=12.0, at=[0, 1, -1]), cones, power]


def _cases(
    cart_pole: Callable[..., Problem], robot: Callable[..., Problem], cycle: Callable[..., Problem]
) -> dict[str, Callable[[], Problem]]:
    end = {"x_end": np.array([0.1, 0.2]), "v_end": np.array([0.3, 0.0])}
    neighbours = [costs.NeighbourCost(_between, {"gain": 0.5}, weight=2.0), costs.Effort()]
    contacts = [*costs.robot(), costs.Slip(), costs.CustomCost(_turned, {"gain": 0.7})]
    even, odd = octo.Cycle(speed=0.5, period=0.6), octo.Cycle(speed=0.5, period=0.7)
    turning = octo.Cycle(speed=0.3, period=0.5, mirror=False, turn=0.4)

    def bounded(problem: Problem) -> Problem:
        return problem.replace(constraints=_constraints())

    return {
        "mammal": lambda: robot("mammal", 6, costs.paper()),
        "chain": lambda: robot("chain", 20, costs.paper(), Hermite(10)),
        "biped": lambda: robot("biped", 6, contacts, Hermite(3)),
        "contacts": lambda: robot("biped", 10, contacts),
        "cart-pole": cart_pole,
        "end": lambda: cart_pole(**end),
        "end, hermite": lambda: cart_pole(basis="hermite", **end),
        "neighbours": lambda: cart_pole(basis="hermite", costs=neighbours),
        "neighbours, end": lambda: cart_pole(basis="hermite", costs=neighbours, **end),
        "cycle": lambda: cycle("mammal", 6, even),
        "cycle, odd": lambda: cycle("biped", 7, odd),
        "cycle, turning": lambda: cycle("mammal", 5, turning),
        "bounded": lambda: bounded(robot("mammal", 6, costs.paper())),
        "bounded, hermite": lambda: bounded(robot("mammal", 6, costs.paper(), Hermite(3))),
        "bounded, cycle": lambda: bounded(cycle("mammal", 6, even, RATES)),
        "two steps": lambda: robot("biped", 7, RATES),
        "two steps, end": lambda: robot("biped", 6, RATES).replace(displacement=np.full(14, 0.02)),
        "two steps, hermite": lambda: robot("biped", 12, RATES, Hermite(4)),
        "two steps, cycle": lambda: cycle("biped", 7, odd, RATES),
    }


@pytest.fixture(scope="module")
def made(
    request: pytest.FixtureRequest,
    cart_pole: Callable[..., Problem],
    robot: Callable[..., Problem],
    cycle: Callable[..., Problem],
) -> Nlp:
    """Of a case: its tests follow one another and share what CasADi derives."""
    return nlp(_cases(cart_pole, robot, cycle)[request.param]())


CASES = (
    "mammal",
    "chain",
    "biped",
    "contacts",
    "cart-pole",
    "end",
    "end, hermite",
    "neighbours",
    "neighbours, end",
    "cycle",
    "cycle, odd",
    "cycle, turning",
    "two steps",
    "two steps, end",
    "two steps, hermite",
    "two steps, cycle",
)


def _point(made: Nlp) -> np.ndarray:
    return made.start + 0.03 * np.random.default_rng(1).standard_normal(len(made.start))


def _close(found: object, wanted: np.ndarray) -> None:
    found, wanted = np.asarray(found), np.asarray(wanted)
    apart = np.abs(found.reshape(wanted.shape) - wanted).max(initial=0.0)
    assert apart <= TOLERANCE * max(1.0, np.abs(wanted).max(initial=0.0))


def _dense(made: Nlp, A: np.ndarray) -> np.ndarray:
    """∂C/∂x of octo's blocks A (1, K, 3, ma, nc)."""
    c = made.compiled
    whole = np.zeros((c.K, c.ma, c.K, c.nc))
    for k in range(c.K):
        for lag in range(min(k, 2) + 1):
            whole[k, :, k - lag] = A[0, k, lag]
    flat = whole.reshape(c.K * c.ma, c.K * c.nc)
    return flat[np.ix_(live_places(c), free_places(c))]


def _symmetric(made: Nlp, H: np.ndarray) -> np.ndarray:
    """∂²/∂x² of octo's blocks H (1, K, 3, nc, nc)."""
    c = made.compiled
    whole = np.zeros((c.K, c.nc, c.K, c.nc))
    for k in range(c.K):
        for lag in range(min(k, 2) + 1):
            whole[k, :, k - lag], whole[k - lag, :, k] = H[0, k, lag], H[0, k, lag].T
    return whole.reshape(c.K * c.nc, c.K * c.nc)[np.ix_(free_places(c), free_places(c))]


@pytest.mark.parametrize("made", CASES, indirect=True)
def test_expressions_equal_the_compiled_problem(made: Nlp) -> None:
    c, x, p = made.compiled, _point(made), made.parameters
    at = c.evaluate(made.unknowns(x))
    model = c.linearize(at, None)
    _close(made.objective(x, p), at.energy)
    _close(made.constraints(x, p), rows_of(c, at.C[0]))
    _close(made.gradient(x, p), point_of(c, model.b))
    _close(ca.densify(made.jacobian(x, p)), _dense(made, model.A))


@pytest.mark.parametrize("made", BOUNDED, indirect=True)
def test_expressions_have_the_bounded_rows(made: Nlp) -> None:
    """Behind C, and only those with a bound: a limit of speeds acts at three steps of six, one row
    at one."""
    own = CompiledProblem(made.compiled.problems)  # whose weights are set below
    c, x, p = own.interpreted(), _point(made), made.parameters
    at, given = c.evaluate(made.unknowns(x)), np.isfinite(c.lower) | np.isfinite(c.upper)
    first, rows = made.g.numel() - given.sum(), 6 * 12 + 3 * 12 + 6 + 1
    assert given.sum() == rows
    _close(made.constraints(x, p)[first:], at.rows[given])
    for found, bound in ((made.g_lower, c.lower), (made.g_upper, c.upper)):
        assert (found[first:] == bound[given]).all() and not found[:first].any()
    c.set_row_weights(np.ones_like(at.rows), np.zeros_like(at.rows))
    model, along = c.linearize(at, None), np.random.default_rng(4).standard_normal(len(x))
    _close(
        made.jacobian(x, p)[first:, :] @ along, c.row_products(model, made.unknowns(along))[given]
    )


# each kind of unit, window and row once
OF_EACH_KIND = ("mammal", "chain", "neighbours, end", "cycle, odd", "bounded", "two steps, hermite")


@needs_compiler
@pytest.mark.parametrize(
    "made",
    [
        pytest.param(name, marks=[] if name in OF_EACH_KIND else pytest.mark.slow)
        for name in (*CASES, *BOUNDED)
    ],
    indirect=True,
)
def test_library_equals_the_expressions(made: Nlp) -> None:
    compiled = CompiledProblem(made.compiled.problems, exact=True)
    library = Library(compiled, octo_layout(compiled))
    x, p = _point(made), made.parameters
    lam = np.random.default_rng(2).standard_normal(made.g.numel())
    _close(library.function("nlp_f")(x, p), np.asarray(made.objective(x, p)))
    _close(library.function("nlp_g")(x, p), np.asarray(made.constraints(x, p)))
    _close(library.function("nlp_grad_f")(x, p)[1], np.asarray(made.gradient(x, p)))
    _close(
        ca.densify(library.function("nlp_jac_g")(x, p)[1]),
        np.asarray(ca.densify(made.jacobian(x, p))),
    )
    # IPOPT's restoration asks for the curvature of the constraints alone
    for sigma in (0.7, -0.3, 0.0):
        wanted = np.asarray(ca.densify(ca.triu(made.hessian(x, p, sigma, lam))))
        _close(ca.densify(library.function("nlp_hess_l")(x, p, sigma, lam)), wanted)


@needs_compiler
@pytest.mark.parametrize("made", ["mammal", "contacts", "cart-pole", "bounded"], indirect=True)
def test_stages_see_their_own_state_alone(made: Nlp) -> None:
    """Where states do not follow one another each stage is a problem of one step; the Jacobian has
    the rows that tie them beside its own."""
    compiled = CompiledProblem(made.compiled.problems, exact=True)
    n, m, steps, step = compiled.n, compiled.m, compiled.steps, step_function(compiled)
    library = Library(compiled, stage_layout(compiled))
    rng, p = np.random.default_rng(3), parameter_vector(compiled)
    stages = compiled.problems[0].start + 0.03 * rng.standard_normal((steps, 3, n))
    x = ca.MX.sym("x", stages.size)
    parts = [x[3 * n * i : 3 * n * (i + 1)] for i in range(steps)]
    f, g = ca.MX(0), []
    for i, now in enumerate(parts):
        nodes = now[2 * n :], now[:n], now[n : 2 * n]
        numbers = (compiled.p[0], compiled.q[0, i, : step.size1_in(4)], compiled.row_scale[0])
        energy, rows, _, bounded = step(*nodes, *numbers)
        f += energy
        if i + 1 < steps:
            g.append(parts[i + 1][: 2 * n] - ca.vertcat(nodes[0], nodes[1]))
        has = np.isfinite(compiled.lower[0, i]) | np.isfinite(compiled.upper[0, i])
        g += [rows, bounded[np.flatnonzero(has).tolist()]]
    g, lam = ca.vertcat(*g), rng.standard_normal(library.layout.rows)
    lagrangian = 0.7 * f + ca.dot(lam, g)
    hessian, slope = ca.hessian(lagrangian, x)
    wanted = ca.Function("f", [x], [f, g, ca.gradient(f, x), ca.jacobian(g, x), slope, hessian])
    wanted = [np.asarray(ca.densify(one)) for one in wanted(stages.ravel())]
    value, rows = library.function("nlp")(stages.ravel(), p)
    found = [value, rows, library.function("nlp_grad_f")(stages.ravel(), p)]
    found.append(library.function("nlp_jac_g")(stages.ravel(), p)[1])
    found += library.function("nlp_hess_l")(stages.ravel(), p, 0.7, lam)
    assert m > 0
    for one, other in zip(found, wanted, strict=True):
        _close(ca.densify(one), other)


CYCLES = {
    "mirrored": ("biped", 6, octo.Cycle(speed=0.5, period=0.6)),
    "mirrored, odd": ("mammal", 7, octo.Cycle(speed=0.5, period=0.7)),
    "turning": ("biped", 6, octo.Cycle(speed=0.3, period=0.6, mirror=False, turn=0.4)),
    "turning, odd": ("biped", 5, octo.Cycle(speed=0.3, period=0.5, mirror=False, turn=-0.6)),
}


@pytest.mark.parametrize("name", CYCLES)
def test_curvature_of_cycles(name: str, cycle: Callable[..., Problem]) -> None:
    """octo's exact curvature is that of the Lagrangian where E has terms of torques and linear ones
    alone."""
    made = nlp(cycle(*CYCLES[name], [costs.Effort()]))
    c, x = made.compiled, _point(made)
    rows = np.random.default_rng(2).standard_normal(made.g.numel())
    lam = multipliers_of(c, rows)
    assert made.g.numel() == c.steps * c.m and len(x) == c.steps * c.n
    assert (rows_of(c, lam) == rows).all()
    H = _symmetric(made, c.linearize(c.evaluate(made.unknowns(x)), lam[None]).H)
    assert (
        np.linalg.matrix_rank(_dense(made, c.linearize(c.evaluate(made.unknowns(x)), None).A))
        == made.g.numel()
    )
    _close(ca.densify(made.hessian(x, made.parameters, 1.0, rows)), H)


def test_start_and_bounds(cart_pole: Callable[..., Problem]) -> None:
    problem = cart_pole()
    made = nlp(problem)
    assert made.start == pytest.approx(np.tile(problem.start, problem.steps))
    assert not made.g_lower.any() and not made.g_upper.any() and np.isinf(made.x_lower).all()
    with pytest.raises(ShapeError, match="start"):
        nlp(problem, np.zeros((3, 2)))


def test_a_cycle_starts_carried_along(cycle: Callable[..., Problem]) -> None:
    made = nlp(cycle("biped", 6, octo.Cycle(speed=0.5, period=0.6)))
    forward = made.compiled.evaluate(made.unknowns(made.start)).nodes[0, :, 0]
    assert np.diff(forward) == pytest.approx(np.full(7, 0.5 * 0.05))
