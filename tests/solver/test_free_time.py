"""Durations as unknowns: textbook answers, IPOPT with its own formulation, and Taylor slopes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

import octo
from octo.errors import OctoError
from octo.problem.phased import compiled_of, parts_of
from octo.problem.phases import Phases
from octo.solve import evaluated
from octo.solver.blocks import KKTBlocks
from octo.solver.clocks import as_long_as
from octo.solver.free_time import FreeTime, timed
from octo.solver.status import Status
from octo.starts import first_nodes
from tests.solver.test_barrier import cart_pole_fd, double_integrator, swing_up

Array = NDArray[np.float64]


def from_rest_to_rest(steps: int, way: float, force: float, **more: Any) -> octo.Problem:
    given: dict[str, Any] = {"duration": (0.2, 20.0), "costs": [octo.Duration()], **more}
    return octo.Problem(
        double_integrator(),
        steps=steps,
        x0=np.zeros(1),
        x_end=np.array([way]),
        v_end=np.zeros(1),
        constraints=[octo.TorqueLimits(limit=force)],
        **given,
    )


@pytest.mark.parametrize(("way", "force"), [(1.0, 1.0), (5.0, 0.3)])
def test_a_mass_is_fastest_with_bang_and_bang(way: float, force: float) -> None:
    """T = 2 √(way/force): with an even number of steps the sampled one too, to the step."""
    motion = octo.solve(from_rest_to_rest(40, way, force))
    assert motion.status is Status.CONVERGED and motion.iterations <= 80
    shortest = 2.0 * np.sqrt(way / force)
    np.testing.assert_allclose(motion.dt * 40, shortest, rtol=1e-5)
    np.testing.assert_allclose(motion.energy, shortest, rtol=1e-5)
    np.testing.assert_allclose(motion.u[:20, 0], force, rtol=1e-3)
    np.testing.assert_allclose(motion.u[20:, 0], -force, rtol=1e-3)
    assert np.abs(motion.u).max() <= force * (1 + 1e-6)
    moved = np.diff(motion.x[:, 0], n=2) / motion.dt**2  # the motion is that of its own dt
    np.testing.assert_allclose(moved, motion.u[:, 0], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("ends", [(0.5, 1.5), (3.0, 6.0)])
def test_a_duration_stays_in_its_range(ends: tuple[float, float]) -> None:
    """The effort of a way falls with T, time itself costs: the best duration, or the nearest end.

    Least effort from rest to rest is u = 6 way/T² (1 − 2t/T), mean u² = 12 way²/T⁴.
    """
    way, weight = 1.0, 0.5
    motion = octo.solve(
        from_rest_to_rest(
            200,
            way,
            100.0,
            duration=ends,
            costs=[octo.Duration(weight=weight), octo.Effort(weight=1.0, reference=1.0)],
        )
    )
    assert motion.status is Status.CONVERGED
    best = (48.0 * way**2 / weight) ** 0.2  # 2.49 s
    np.testing.assert_allclose(200 * motion.dt, np.clip(best, *ends), rtol=1e-4)
    assert ends[0] * (1 - 1e-6) <= 200 * motion.dt <= ends[1] * (1 + 1e-6)
    assert [bound.held for bound in motion.bounds] == [True, True]
    assert "the duration is " in str(motion) and f"is {200 * motion.dt:.4g} s, must" in str(motion)


def test_phases_find_durations_of_their_own() -> None:
    """A strong push, then a weak brake, against IPOPT over forces and two dt: x_{k+1} = x_k + dt
    v_{k+1}."""
    push, brake, way = 2.0, 0.5, 1.0

    def phase(least: float, most: float, **more: Any) -> octo.Problem:
        motor = octo.CustomConstraint(lambda step, p: step.u, least, most, name="Motor")
        return octo.Problem(
            double_integrator(),
            steps=20,
            duration=(0.1, 10.0),
            costs=[octo.Duration()],
            constraints=[motor],
            **more,
        )

    end = {"x_end": np.array([way]), "v_end": np.zeros(1)}
    motion = octo.solve(octo.phases([phase(0.0, push, x0=np.zeros(1)), phase(-brake, 0.0, **end)]))
    assert motion.converged
    first, second = (own.dt * own.steps for own in motion.phases)
    np.testing.assert_allclose(motion.energy, first + second, rtol=1e-9)
    fastest = np.sqrt(2.0 * way * (push + brake) / (push * brake))  # of fine steps
    np.testing.assert_allclose(first + second, fastest, rtol=0.03)
    nlp = ca.Opti()
    u, dt, x, v = nlp.variable(40), nlp.variable(2), 0.0, 0.0
    for k in range(40):
        v += dt[k // 20] * u[k]
        x += dt[k // 20] * v
    nlp.subject_to(nlp.bounded(0.0, u[:20], push))
    nlp.subject_to(nlp.bounded(-brake, u[20:], 0.0))
    for condition in (x == way, v == 0.0, nlp.bounded(0.005, dt, 0.5)):
        nlp.subject_to(condition)
    nlp.minimize(20.0 * (dt[0] + dt[1]))
    nlp.set_initial(dt, 0.05)
    nlp.set_initial(u, np.repeat([push, -brake], 20))
    nlp.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    best = 20.0 * nlp.solve().value(dt)
    np.testing.assert_allclose(first + second, best.sum(), rtol=1e-5)


def test_a_solution_of_phases_with_free_durations_is_the_end_of_the_way() -> None:
    """Begun anew from it, E is the same: what each phase counts with is not what was found."""
    effort = [octo.Duration(weight=0.5), octo.Effort(weight=1.0, reference=1.0)]
    parts = [
        from_rest_to_rest(20, 1.0, 100.0, costs=effort).replace(dt=dt, **dict.fromkeys(free))
        for dt, free in ((0.05, ("x_end", "v_end")), (0.1, ("x0",)))
    ]
    phases = octo.phases(parts)
    motion = octo.solve(phases)
    again = octo.solve(phases, start=motion)
    assert motion.converged and again.converged and again.iterations <= 5
    np.testing.assert_allclose(again.energy, motion.energy, rtol=1e-6)
    np.testing.assert_allclose(again.times, motion.times, rtol=1e-3)


def fastest_by_ipopt(limit: float, steps: int, start: Array, guess: float) -> float:
    """T (s) of the swing-up, written anew with T as a variable."""
    nlp = ca.Opti()
    x, T = nlp.variable(2, steps + 2), nlp.variable()
    for i in range(steps):
        u, rest = ca.vertsplit(cart_pole_fd(x[:, i + 2], x[:, i + 1], x[:, i], T / steps))
        nlp.subject_to(rest == 0)
        nlp.subject_to(nlp.bounded(-limit, u, limit))
    for k, place in ((0, 0.0), (1, 0.0), (steps, np.pi), (steps + 1, np.pi)):
        nlp.subject_to(x[:, k] == ca.DM([0.0, place]))
    nlp.subject_to(nlp.bounded(0.5, T, 6.0))
    nlp.minimize(T)
    nlp.set_initial(x, start.T)
    nlp.set_initial(T, guess)
    nlp.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    return float(nlp.solve().value(T))


@pytest.mark.parametrize(("limit", "guess"), [(15.0, 1.5), (15.0, 3.0), (8.0, 3.0)])
def test_a_pole_is_swung_up_as_fast_as_by_ipopt(limit: float, guess: float) -> None:
    problem = swing_up(limit).replace(dt=guess / 60, duration=(0.5, 6.0), costs=[octo.Duration()])
    motion = octo.solve(problem)
    assert motion.converged
    best = fastest_by_ipopt(limit, 60, np.zeros((62, 2)), guess)
    np.testing.assert_allclose(60 * motion.dt, best, rtol=1e-3)  # to 1e-6 as measured
    assert np.abs(motion.u).max() <= limit * (1 + 1e-6)


# -- what the solver is given ----------------------------------------------------------------------


def standing(**more: Any) -> octo.Problem:
    costs = [
        octo.CenterOfMassVelocity((0.4, 0.0, 0.0), curvature="exact"),
        octo.Effort(),
        octo.Duration(weight=0.3),
    ]
    given = {"costs": costs, "constraints": [octo.TorqueLimits()], "steps": 20, **more}
    return octo.Problem(octo.gallery.biped(), **{"duration": (0.2, 2.0), **given})


def moving_end() -> octo.Problem:
    x = standing().start
    return standing(x_end=x + 0.01, v_end=0.3 + 0.0 * x)


def moving() -> octo.Problem:
    """Between two states that move: x_{−1} and x_{N−1} depend on dt."""
    x = standing().start
    return standing(x0=x, v0=0.2 + 0.0 * x, x_end=x + 0.01, v_end=0.3 + 0.0 * x)


PROBLEMS: dict[str, Callable[[], Any]] = {
    "nodes": standing,
    "hermite": lambda: standing(basis="hermite"),
    "cycle": lambda: standing(cycle=octo.Cycle(speed=0.4, period=0.6)),
    "arc": lambda: standing(cycle=octo.Cycle(speed=0.4, period=0.6, turn=0.4, mirror=False)),
    "two ends": moving,
    "two steps": lambda: standing(costs=[octo.TorqueRate(), octo.Effort()]),
    "two phases": lambda: octo.phases([standing(), standing(dt=0.02, steps=12)]),
    "a phase before": lambda: octo.phases([standing(), standing(duration=None, dt=0.02)]),
    "a phase after": lambda: octo.phases([standing(duration=None, dt=0.05), moving_end()]),
}


@pytest.mark.parametrize("kind", PROBLEMS)
def test_derivatives_along_the_duration(kind: str) -> None:
    """E, C, rows and the gradient of the Lagrangian along a direction that changes dt too."""
    rng = np.random.default_rng(0)
    problem = PROBLEMS[kind]()
    nlp = timed(compiled_of([problem]))
    assert isinstance(nlp, FreeTime)
    last = parts_of(nlp.inner)[-1]

    def direction() -> Array:
        made = rng.standard_normal((1, nlp.K, nlp.nc))
        made[..., -1], made[:, last.fixed + nlp.K - last.K] = 0.0, 0.0
        for unit, part in last.idle:
            made[:, unit, part * nlp.n : (part + 1) * nlp.n] = 0.0
        return made

    v = nlp.unknowns(first_nodes(problem, 0, None)[None]) + 0.01 * direction()
    d, firsts = direction(), []
    for k in nlp.free:
        v[:, nlp.units[k], -1], d[:, nlp.units[k], -1] = 0.1, 1.0 - 0.4 * k
        firsts.append(nlp.units[k].start)
    at = nlp.evaluate(v)
    D, y = rng.uniform(0.5, 1.0, at.rows.shape), rng.standard_normal(at.rows.shape)
    lam = rng.standard_normal((1, nlp.K, nlp.ma))
    nlp.set_row_weights(D, y, y)
    model = nlp.linearize(at, lam)
    blocks = KKTBlocks(model.H, model.A, model.b, model.C)

    def slope(function: Callable[[Array], Array], h: float) -> Array:
        far, near = (
            (function(v + k * h * d) - function(v - k * h * d)) / (2 * k * h) for k in (2, 1)
        )
        return (4.0 * near - far) / 3.0

    def same(found: Array, wanted: Array, tolerance: float) -> None:
        size = max(float(np.abs(wanted).max()), 1e-12)
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=tolerance * size)

    products = nlp.row_products(model, d)
    own = (model.b - nlp.row_forces(model, y)) * d
    same(own.sum(), slope(lambda w: nlp.evaluate(w).terms.sum(), 1e-6), 1e-6)
    same(blocks.constraints_times(d), slope(lambda w: nlp.evaluate(w).C, 1e-6), 1e-6)
    same(products, slope(lambda w: nlp.evaluate(w).rows, 1e-6), 1e-6)
    b, A = nlp.gradient(at)
    same(b, model.b, 1e-12)
    same(A, model.A, 1e-12)

    def forces(w: Array) -> Array:
        here = nlp.linearize(nlp.evaluate(w), lam)
        pull = KKTBlocks(here.H, here.A, here.b, here.C).constraints_transposed_times(lam)
        return here.b + pull

    wanted = slope(forces, 1e-6)  # laws have kinks
    found = blocks.hessian_times(d) - nlp.row_forces(model, D * products)
    # of copies of τ only the sum is said
    sums = (np.add.reduceat(each[0, :, -1], firsts) for each in (found, wanted))
    same(*sums, 1e-5)
    same(found[..., :-1].sum(axis=1), wanted[..., :-1].sum(axis=1), 1e-4)


def test_members_have_durations_of_their_own() -> None:
    problems = [from_rest_to_rest(30, way, 1.0) for way in (0.5, 2.0, 1.0)]
    together = octo.solve(problems)
    for problem, motion in zip(problems, together, strict=True):
        alone = octo.solve(problem)
        assert motion.converged and motion.iterations == alone.iterations
        np.testing.assert_allclose(motion.dt, alone.dt, rtol=1e-12)


def test_a_batch_is_free_or_fixed() -> None:
    free = from_rest_to_rest(30, 1.0, 1.0)
    fixed = from_rest_to_rest(30, 1.0, 1.0, duration=None, dt=0.1)
    with pytest.raises(OctoError, match="duration is free in one problem of a batch and fixed in"):
        octo.solve([free, fixed])


def test_a_solution_goes_on_from_its_own_duration(tmp_path: Path) -> None:
    problem = from_rest_to_rest(40, 1.0, 1.0)
    motion = octo.solve(problem)
    motion.save(tmp_path / "fast.npz")
    again = octo.solve(problem, start=str(tmp_path / "fast.npz"))
    np.testing.assert_allclose(again.dt, motion.dt, rtol=1e-6)
    finer = octo.solve(from_rest_to_rest(80, 1.0, 1.0), start=motion)
    np.testing.assert_allclose(80 * finer.dt, 2.0, rtol=1e-5)


@pytest.mark.parametrize("begun", [0.004, 20.0])
def test_a_search_begins_within_the_range(begun: float) -> None:
    """Wherever its dt comes from: given, kept by ``replace``, or of the solution it starts from."""
    problem = from_rest_to_rest(40, 1.0, 1.0, duration=(0.5, 10.0))
    ends = (0.5 * begun, begun) if begun < 1.0 else (begun, 2.0 * begun)
    beyond = problem.replace(duration=ends, dt=begun / 40)
    for given, start in (
        (problem.replace(dt=begun / 40), None),
        (beyond.replace(duration=problem.duration), None),
        (problem, evaluated(beyond, np.zeros((41, 1)), Status.CONVERGED)),
    ):
        motion = octo.solve(given, start=start)
        assert motion.status is Status.CONVERGED
        np.testing.assert_allclose(40 * motion.dt, 2.0, rtol=1e-5)


def test_phases_begin_inside_their_ranges() -> None:
    """What is outside begins a little inside: at the very end a search may run into the wall behind
    it. What is within stays, as a duration that was found at an end of its range does."""
    given: dict[str, Any] = {"steps": 20, "costs": [octo.Duration()], "duration": (0.2, 10.0)}
    first = octo.Problem(double_integrator(), x0=np.zeros(1), dt=0.05, **given)
    whole = octo.phases([first, octo.Problem(double_integrator(), dt=0.02, **given)])
    for seconds, wanted in (((15.0, 0.1), (9.6, 0.2 * 50**0.01)), ((2.0, 0.2), (2.0, 0.2))):
        begun = as_long_as(whole, np.repeat(np.array(seconds) / 20, 20))
        assert isinstance(begun, Phases)
        found = [20 * one.dt for one in begun.problems]
        np.testing.assert_allclose(found, wanted, rtol=2e-3)
        assert min(found) >= 0.2 and max(found) <= 10.0


@pytest.mark.slow
def test_a_stride_finds_its_period() -> None:
    """E is not above that of the same stride with periods that are fixed."""
    robot = octo.gallery.mammal()

    def stride(period: float, **more: Any) -> octo.Solution:
        cycle = octo.Cycle(speed=0.5, period=period)
        costs = octo.costs.natural(0.5)
        return octo.solve(octo.Problem(robot, steps=16, costs=costs, cycle=cycle, **more))

    free = stride(0.5, duration=(0.4, 0.7))
    assert free.converged and free.cycle is not None
    assert 0.4 * (1 - 1e-6) <= free.cycle.period <= 0.7 * (1 + 1e-6)
    np.testing.assert_allclose(free.cycle.period, 2 * 16 * free.dt, rtol=1e-12)
    fixed = [stride(period) for period in (0.4, 0.5, 0.6)]
    assert all(free.energy <= other.energy for other in fixed if other.converged)
    way = free.x[-1, 0] - free.x[1, 0]  # half a stride, at the speed that was asked for
    np.testing.assert_allclose(way / (16 * free.dt), 0.5, rtol=1e-6)


def refused(**changes: Any) -> str:
    with pytest.raises(OctoError) as error:
        octo.solve(from_rest_to_rest(40, 1.0, 1.0).replace(**changes))
    return str(error.value)


def test_what_is_no_duration_is_refused() -> None:
    assert "must be (shortest, longest)" in refused(duration=2.0)
    assert "the shortest must be less" in refused(duration=(3.0, 2.0))
    assert "duration" in refused(duration=(0.0, 2.0))
    assert "by a millionth" in refused(duration=(3.0, np.nextafter(3.0, 4.0)))
    assert "Duration has no hard form" in refused(constraints=[octo.Duration()])
    with pytest.raises(OctoError, match=r"in 20 steps, must be between 2.4e-08 and 16.67 s"):
        standing().replace(duration=(1.0, 20.0))  # of a robot; on the way it may be a fifth more
    costs = [octo.Duration(), octo.Effort(at=octo.At(1.0))]
    assert "Effort.at is in seconds and duration is free" in refused(costs=costs)


def test_what_needs_a_fixed_duration_says_so() -> None:
    problem = standing()
    for who, call in (
        ("IPOPT", lambda: octo.reference.ipopt(problem)),
        ("fatrop", lambda: octo.reference.fatrop(problem)),
        ("the controller", lambda: octo.mpc.Controller(problem)),
        ("step='trust_region'", lambda: octo.solve(problem, options=octo.SqpOptions.paper())),
    ):
        with pytest.raises(OctoError, match=f"duration is free and {who}"):
            call()


def test_a_motion_that_has_too_little_time_is_explained() -> None:
    problem = from_rest_to_rest(20, 1.0, 1.0, duration=(0.5, 1.0))
    motion = octo.solve(problem, max_iterations=60)
    assert not motion.converged
    conflict = octo.explain(problem, motion).conflict
    assert conflict is not None
    assert set(conflict.names) == {"TorqueLimits", "DurationRange", "the fixed end"}
    assert 1.0 < conflict.seconds <= 2.0  # of the motion that breaks least, not of the search's dt
    assert all(row.time <= conflict.seconds * (1 + 1e-9) for row in conflict.rows)


def test_a_motion_that_holds_comes_with_its_time() -> None:
    problem = from_rest_to_rest(20, 1.0, 1.0, duration=(0.5, 3.0), dt=0.5 / 20)
    conflict = octo.explain(problem, octo.solve(problem, max_iterations=1)).conflict
    assert conflict is not None and conflict.motion is not None
    force = np.diff(conflict.motion[:, 0], n=2) / (conflict.seconds / 20) ** 2
    assert np.abs(force).max() <= 1.0 + 1e-3
