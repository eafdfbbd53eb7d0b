"""Rows between bounds: textbook problems against IPOPT, and one Newton step against dense
algebra."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

import octo
from octo.problem.compiled import CompiledProblem
from octo.solver import barrier, kkt
from octo.solver.barrier import Barrier
from octo.solver.elastic import Elastic
from octo.solver.limits import Limits
from octo.solver.options import SqpOptions
from octo.solver.status import Status

Array = NDArray[np.float64]
DT = 0.05
CONVERGED = (Status.CONVERGED,)


def double_integrator(dt: float = DT) -> octo.CustomDynamics:
    def fd(x_next: ca.SX, x: ca.SX, x_prev: ca.SX, view: dict[str, ca.SX]) -> ca.SX:
        return (x_next - 2 * x + x_prev) / view["dt"] ** 2

    return octo.CustomDynamics(fd, 1, [0], {"dt": dt})


def cart_pole_fd(x_next: Any, x: Any, x_prev: Any, dt: Any) -> Any:
    """Cart of 1 kg, pole of 0.3 kg at 0.5 m; the cart is pushed."""
    a, angle, rate = (x_next - 2 * x + x_prev) / dt**2, x_next[1], (x_next[1] - x[1]) / dt
    swing = 0.15 * (ca.cos(angle) * a[1] - ca.sin(angle) * rate**2)
    pole = 0.15 * ca.cos(angle) * a[0] + 0.075 * a[1] + 0.3 * 9.81 * 0.5 * ca.sin(angle)
    return ca.vertcat(1.3 * a[0] + swing, pole)


def swing_up(limit: float, steps: int = 60) -> octo.Problem:
    dynamics = octo.CustomDynamics(
        lambda x_next, x, x_prev, view: cart_pole_fd(x_next, x, x_prev, view["dt"]),
        2,
        [0],
        {"dt": DT},
    )
    return octo.Problem(
        dynamics,
        steps=steps,
        dt=DT,
        costs=[octo.Effort(weight=0.1, reference=1.0)],
        constraints=[octo.TorqueLimits(limit=limit)],
        x0=np.zeros(2),
        x_end=np.array([0.0, np.pi]),
        v_end=np.zeros(2),
    )


def by_ipopt(limit: float, steps: int, start: Array) -> float:
    """E of the same problem, written anew."""
    free = [ca.MX.sym(f"x{i}", 2) for i in range(1, steps - 1)]
    end = ca.MX(ca.DM([0.0, np.pi]))
    nodes = [ca.MX(2, 1), ca.MX(2, 1), *free, end, end]
    fd = [cart_pole_fd(nodes[i + 2], nodes[i + 1], nodes[i], DT) for i in range(steps)]
    u, rest = ca.vertcat(*(f[0] for f in fd)), ca.vertcat(*(f[1] for f in fd))
    nlp = {"x": ca.vertcat(*free), "f": 0.1 * ca.sumsqr(u) / steps, "g": ca.vertcat(rest, u)}
    quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}
    solver = ca.nlpsol("swing_up", "ipopt", nlp, quiet)
    most = np.concatenate([np.zeros(steps), np.full(steps, limit)])
    found = solver(x0=start[2:-2].ravel(), lbg=-most, ubg=most)
    assert solver.stats()["success"]
    return float(found["f"])


def test_a_bounded_force_moves_a_mass_with_the_least_effort() -> None:
    """Bang, off and bang where the way is just long enough; against the quadratic program."""
    steps, way = 40, 0.8
    problem = octo.Problem(
        double_integrator(),
        steps=steps,
        dt=DT,
        costs=[octo.Effort(weight=1.0, reference=1.0)],
        constraints=[octo.TorqueLimits(limit=1.0)],
        x0=np.zeros(1),
        x_end=np.array([way]),
        v_end=np.zeros(1),
    )
    motion = octo.solve(problem)
    assert motion.status in CONVERGED and motion.iterations <= 40
    # x_N and x_{N−1} as sums of u
    places = np.arange(steps)
    rows = DT**2 * np.stack([steps - places, np.maximum(steps - 1 - places, 0)])
    u = ca.SX.sym("u", steps)
    quadratic = {"x": u, "f": ca.sumsqr(u) / steps, "g": ca.DM(rows) @ u}
    solver = ca.qpsol("least", "qrqp", quadratic, {"print_iter": False, "print_header": False})
    best = solver(lbx=-1.0, ubx=1.0, lbg=way, ubg=way)
    np.testing.assert_allclose(motion.energy, float(best["f"]), rtol=1e-5)
    np.testing.assert_allclose(motion.u[:, 0], np.ravel(best["x"]), atol=2e-3)
    assert np.abs(motion.u).max() <= 1.0


@pytest.mark.parametrize("limit", [20.0, 10.0])
def test_a_pole_is_swung_up_as_by_ipopt(limit: float) -> None:
    """20 N is more than it takes, 10 N is not."""
    problem = swing_up(limit)
    start = 1e-3 * np.random.default_rng(0).standard_normal((62, 2))
    motion = octo.solve(problem, start=start)
    assert motion.status in CONVERGED and motion.iterations <= 80
    best = by_ipopt(limit, 60, start)  # now and then another optimum, 6e-4 above
    assert (1.0 - 1e-3) * best <= motion.energy <= (1.0 + 1e-6) * best
    assert np.abs(motion.u).max() <= limit
    bounds = {own.name: own.violation for own in motion.bounds}
    assert bounds == {"TorqueLimits": 0.0}


def test_a_newton_step_is_that_of_the_whole_system() -> None:
    """Δ, slacks and multipliers of the condensed system against [H, Aᵀ, Rᵀ; A; R, −1; …] solved
    densely."""
    problem = swing_up(5.0, steps=6)
    compiled, rng = CompiledProblem([problem]), np.random.default_rng(1)
    unknowns = compiled.unknowns(0.3 * rng.standard_normal((1, 8, 2)))
    at = compiled.evaluate(unknowns)
    barrier = Barrier(Limits(*compiled.row_bounds), at, 1e-5)
    own, limits = barrier.slacks, barrier.limits
    own = type(own)(
        own.s,
        *(part * rng.uniform(0.5, 2.0, part.shape) for part in (own.lower, own.upper)),
        own.equal,
        own.mu,
    )
    barrier._hold(own)
    barrier.weigh(compiled, at)
    model, lam = compiled.linearize(at, np.zeros((1, compiled.K, compiled.ma))), None
    factor = kkt.factorize(model.H, model.A, 0.0)
    delta, lam = factor.solve(-model.b, -model.C)
    length, _ = barrier.shortened(compiled, at, model, delta, np.zeros(1))
    assert 0.0 < float(np.ravel(length)[0]) <= 1.0
    change = compiled.row_products(model, delta) + limits.residual(at.rows, own.s)
    # the terms of E and the curvature alone: the same with weights that add next to nothing
    tiny = np.full_like(at.rows, 1e-300)
    compiled.set_row_weights(tiny, np.zeros_like(tiny), own.upper - own.lower)
    plain = compiled.linearize(at, np.zeros((1, compiled.K, compiled.ma)))
    below, above = limits.gaps(own.s)
    step = barrier._step
    upper, lower = own.upper + step.upper, own.lower + step.lower
    blocks = kkt_blocks(plain)
    pull = compiled.row_forces(plain, upper - lower)
    stationary = plain.b + blocks.hessian_times(delta) + pull
    stationary = stationary + blocks.constraints_transposed_times(lam)
    np.testing.assert_allclose(stationary, 0.0, atol=1e-8 * np.abs(plain.b).max())
    np.testing.assert_allclose(blocks.constraints_times(delta), -plain.C, atol=1e-10)
    used = limits.low
    for gap, old, new, way in (
        (below, own.lower, lower, change),
        (above, own.upper, upper, -change),
    ):
        product = gap * new + old * way  # z s + z Δs + s Δz
        np.testing.assert_allclose(product[used], own.mu[0], rtol=1e-8)


def kkt_blocks(model: Any) -> Any:
    from octo.solver.blocks import KKTBlocks

    return KKTBlocks(model.H, model.A, model.b, model.C)


def test_equalities_and_bounds_at_the_end_of_a_batch() -> None:
    """An end asked for by an equality is the end that is fixed; each member has its own bound."""
    fixed = octo.solve(swing_up(12.0))
    free = swing_up(12.0).replace(x_end=None, v_end=None)
    reach = octo.CustomConstraint(
        function=lambda step, p: ca.vertcat(step.x_next, step.x) - p["end"],
        lower=0.0,
        upper=0.0,
        values={"end": np.array([0.0, np.pi, 0.0, np.pi])},
        at="last",
        name="Reach",
    )
    asked = octo.solve(free.replace(constraints=[*free.constraints, reach]))
    assert asked.status in CONVERGED
    np.testing.assert_allclose(asked.energy, fixed.energy, rtol=1e-5)
    np.testing.assert_allclose(asked.x[-1], [0.0, np.pi], atol=1e-6)


def test_members_of_a_batch_have_bounds_of_their_own() -> None:
    limits = (20.0, 11.0)
    together = octo.solve([swing_up(limit) for limit in limits])
    for limit, motion in zip(limits, together, strict=True):
        alone = octo.solve(swing_up(limit))
        assert motion.status in CONVERGED
        np.testing.assert_allclose(motion.energy, alone.energy, rtol=1e-6)
        assert np.abs(motion.u).max() <= limit


def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = swing_up(10.0)
    compiled = octo.solve(problem)
    monkeypatch.setattr("octo.native.compiler", lambda: None)
    plain = octo.solve(problem.replace(model=swing_up(10.0).model))
    assert plain.status in CONVERGED
    np.testing.assert_allclose(plain.energy, compiled.energy, rtol=1e-6)


def test_a_trust_region_takes_no_bounds() -> None:
    with pytest.raises(octo.errors.ProblemError, match="TorqueLimits"):
        octo.solve(swing_up(10.0), options=SqpOptions.paper())


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_a_start_far_outside_its_bounds_is_led_inside(seed: int) -> None:
    """Forces of hundreds of newtons at first: an elastic phase begins, and its iterations count."""
    start = np.random.default_rng(seed).standard_normal((62, 2))
    motion = octo.solve(swing_up(10.0), start=start)
    assert motion.status in CONVERGED
    np.testing.assert_allclose(motion.energy, 3.02676, rtol=1e-5)
    assert len(motion.history["energy"]) < motion.iterations <= 120


def test_an_elastic_phase_begins_only_where_many_rows_are_far_outside() -> None:
    """From rest the leap at the end asks for large forces of two rows; and the limit of iterations
    is of all of them."""
    wild = np.random.default_rng(1).standard_normal((62, 2))
    near = octo.solve(swing_up(10.0), start=1e-3 * wild)
    assert len(near.history["energy"]) == near.iterations
    few = octo.solve(swing_up(10.0), start=wild, max_iterations=7)
    assert few.status is Status.ITERATION_LIMIT and few.iterations == 7


@pytest.mark.parametrize("inside", [True, False])
def test_an_elastic_phase_leads_out_of_a_jam(inside: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Short steps one after the other; whose matrices are heavy is no matter here. Where the phase
    does not end between the bounds, the solve goes on as if it had not been, and counts it."""
    wild = 1e-3 * np.random.default_rng(1).standard_normal((62, 2))
    plain = octo.solve(swing_up(8.0), start=wild)
    assert len(plain.history["energy"]) == plain.iterations
    monkeypatch.setattr(barrier, "JAM", 3)
    monkeypatch.setattr(barrier, "HEAVY", -1.0)
    monkeypatch.setattr(Elastic, "kept", lambda self, rows: np.full(len(rows), inside))
    motion = octo.solve(swing_up(8.0), start=wild)
    assert motion.status in CONVERGED and len(motion.history["energy"]) < motion.iterations
    np.testing.assert_allclose(motion.energy, plain.energy, rtol=1e-3)
    assert np.array_equal(motion.x, plain.x) is not inside
    few = octo.solve(swing_up(8.0), start=wild, max_iterations=9)
    assert few.status is Status.ITERATION_LIMIT and few.iterations == 9


def test_a_phase_has_kept_bounds_that_rows_miss_by_the_width_of_the_price() -> None:
    lower, upper = np.full((3, 2, 2), -np.inf), np.full((3, 2, 2), 1.0)
    lower[..., 1] = upper[..., 1] = 0.5
    rows = np.full((3, 2, 2), 0.5)
    rows[0, 1, 0], rows[1, 0, 0], rows[2, 1, 1] = -9.0, 1.02, 0.505
    np.testing.assert_array_equal(Elastic(lower, upper, 0.01).kept(rows), [True, False, True])


def test_ctrl_c_in_an_elastic_phase_stops_the_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("octo.solver.elastic.Elastic.weigh", stop)
    start = np.random.default_rng(0).standard_normal((62, 2))
    motion = octo.solve(swing_up(10.0), start=start)
    assert motion.status is Status.INTERRUPTED and np.isfinite(motion.x).all()
