"""A learned transition: its slopes, the gradients of both losses, what is unrolled, its file, and
its term in a problem, which every backend evaluates alike."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from walker import START, walker

import octo
from octo import learn
from octo.learn.frame import USUAL
from octo.learn.losses import LOSSES, with_decay
from octo.model.charted import charted
from octo.problem.compiled import CompiledProblem

STATES = ("body", "world")
STENCIL = ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0))  # of differences of fourth order


def problem(basis: str = "hermite", steps: int = 40, **fields: object) -> octo.Problem:
    costs = [octo.CenterOfMassVelocity((0.2, 0.0, 0.0)), octo.Effort()]
    usual = {"basis": basis, "costs": costs, "x0": START}
    return octo.Problem(walker(), steps=steps, dt=0.05, **{**usual, **fields})


def network(of: octo.Problem, state: str = "body", seed: int = 0) -> learn.Transition:
    """One whose weights are of order one, so that nothing is small by chance."""
    made = learn.Transition(hidden=(7, 5), state=state).started(of)
    w = 0.3 * np.random.default_rng(seed).standard_normal(made.network.count)
    made.network.layers(w)[0][0][:] *= USUAL  # of inputs as large as controls
    return made.with_weights(w)


def regularised(of: octo.Problem, weight: object = 1.0, seed: int = 0) -> octo.Problem:
    term = learn.Markovian(transition=network(of, seed=seed), weight=weight)
    return of.replace(costs=[*of.costs, term])


def difference(f: Callable[[float], np.ndarray], h: float = 1e-3) -> np.ndarray:
    """The slope of f at 0."""
    return sum(share * f(k * h) for k, share in STENCIL) / (12.0 * h)


@pytest.mark.parametrize("chart", ["zyx", "zxy"])
@pytest.mark.parametrize("state", STATES)
def test_slopes_of_the_residual(state: str, chart: str) -> None:
    own = problem().replace(model=charted(walker(), chart))
    transition, n = network(own, state), own.dynamics.nx
    both = np.random.default_rng(1).standard_normal((2, 3, 4 * n))

    def residual(x: np.ndarray) -> np.ndarray:
        return transition.residual(x[..., : 2 * n], x[..., 2 * n :])

    value, slopes = transition.residual_slopes(both[..., : 2 * n], both[..., 2 * n :])
    np.testing.assert_allclose(value, residual(both), rtol=0, atol=1e-13)
    for j, unit in enumerate(np.eye(4 * n)):
        expected = difference(lambda h, unit=unit: residual(both + h * unit))
        np.testing.assert_allclose(slopes[..., j], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("state", STATES)
def test_gradient_with_respect_to_the_weights(state: str, loss: str) -> None:
    """The remainder of a Taylor series falls with the square of the step, through all controls."""
    own = problem()
    transition = network(own, state)
    random = np.random.default_rng(2)
    motions = 0.1 * np.cumsum(random.standard_normal((2, 7, 2 * own.dynamics.nx)), axis=1)
    made = LOSSES[loss](transition.network, transition.frame, motions)
    f = with_decay(made, transition.network, 0.3)
    w, way = transition.weights, random.standard_normal(transition.network.count)
    value, gradient = f(w)
    steps = 1e-2 * 0.5 ** np.arange(5)
    remainder = [abs(f(w + h * way)[0] - value - h * (gradient @ way)) for h in steps]
    slope = np.diff(np.log(remainder)) / np.diff(np.log(steps))
    assert abs(slope[-1] - 2.0) < 0.05, slope


def test_the_state_of_the_body_has_no_place_and_no_heading() -> None:
    """A motion that begins elsewhere, in another direction, is continued as this one is."""
    own = problem()
    n = own.dynamics.nx
    c = 0.3 * np.random.default_rng(3).standard_normal(2 * n)
    turn, shift = 0.7, np.array([2.0, -3.0])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(controls: np.ndarray) -> np.ndarray:
        made = controls.copy()
        made[..., :2] = controls[..., :2] @ rotation.T + shift
        made[..., n : n + 2] = controls[..., n : n + 2] @ rotation.T
        made[..., 3] += turn
        return made

    body, world = (network(own, state) for state in STATES)
    np.testing.assert_allclose(body.unroll(moved(c), 5), moved(body.unroll(c, 5)), atol=1e-12)
    assert abs(world.unroll(moved(c), 5) - moved(world.unroll(c, 5))).max() > 1e-3


def test_one_control_after_the_other() -> None:
    own = problem()
    transition = network(own)
    c = 0.1 * np.random.default_rng(4).standard_normal((3, 2 * own.dynamics.nx))
    made = transition.unroll(c, 4)
    assert made.shape == (3, 5, 2 * own.dynamics.nx)
    np.testing.assert_array_equal(made[:, 0], c)
    np.testing.assert_allclose(transition.residual(made[:, :-1], made[:, 1:]), 0.0, atol=1e-13)


def test_a_file_holds_all_of_it(tmp_path) -> None:
    own = problem()
    transition = network(own, "world")
    transition.save(tmp_path / "walk.npz")
    again = learn.Transition.load(tmp_path / "walk.npz")
    again.check(own)
    assert repr(again) == repr(transition)
    c = np.random.default_rng(5).standard_normal(2 * own.dynamics.nx)
    np.testing.assert_array_equal(again.next(c), transition.next(c))


# -- the term --------------------------------------------------------------------------------------


def cases() -> list[tuple[str, octo.Problem]]:
    """Both bases, with a fixed end, and with nodes in pairs of which one is no node."""
    end = {"displacement": 0.1 * np.eye(walker().nx)[0]}
    pairs = {"costs": [octo.Effort(), octo.TorqueRate()]}
    return [
        ("hermite", problem()),
        ("hermite, fixed end", problem(**end)),
        ("nodes", problem("nodes", 12)),
        ("nodes, fixed end", problem("nodes", 12, **end)),
        ("pairs of nodes", problem("nodes", 13, **pairs)),
    ]


@pytest.mark.parametrize(("name", "plain"), cases(), ids=[name for name, _ in cases()])
def test_the_term_in_a_model(name: str, plain: octo.Problem) -> None:
    """b is the slope of E, H has JᵀJ, both stand in the blocks that are there without it, and
    CasADi's virtual machine gives what native code gives."""
    del name
    random = np.random.default_rng(6)
    weight = random.uniform(0.5, 1.5, plain.steps)
    batch = [regularised(plain, weight, seed) for seed in (0, 1)]
    compiled, bare = CompiledProblem(batch), CompiledProblem([plain] * 2)
    assert compiled.nc == bare.nc and compiled.K == bare.K
    n = compiled.n
    nodes = 0.02 * np.cumsum(random.standard_normal((2, compiled.steps + 2, n)), axis=1)
    v = compiled.unknowns(plain.start + nodes)
    way = random.standard_normal(v.shape)
    way[:, compiled.fixed] = 0.0
    for unit, part in compiled.idle:
        way[:, unit, part * n : (part + 1) * n] = 0.0
    at, term = compiled.evaluate(v), len(plain.costs)
    lam = random.standard_normal((2, compiled.K, compiled.ma))
    model, other = compiled.linearize(at, lam), bare.linearize(bare.evaluate(v), lam)

    def energy(h: float) -> np.ndarray:
        return compiled.term_values(compiled.evaluate(v + h * way))[:, term]

    def roots(h: float) -> np.ndarray:
        """Numbers whose squares are the term."""
        there, arrays = compiled.evaluate(v + h * way), compiled.arrays
        c = arrays._controls(there.unknowns, there.nodes)
        own = zip(batch, c, strict=True)
        r = np.stack([p.terms[term]._own.residual(each[:-1], each[1:]) for p, each in own])
        return np.sqrt(arrays._weight(term))[..., None] * r

    assert (energy(0.0) > 0.1).all()
    np.testing.assert_allclose((roots(0.0) ** 2).sum(axis=(1, 2)), energy(0.0), rtol=1e-12)
    b, H = model.b - other.b, model.H - other.H
    np.testing.assert_allclose((b * way).sum(axis=(1, 2)), difference(energy), rtol=1e-9)
    square = np.einsum("bki,bkij,bkj->b", way, H[:, :, 0], way)
    for lag in (1, 2):
        square += 2 * np.einsum("bki,bkij,bkj->b", way[:, lag:], H[:, lag:, lag], way[:, :-lag])
    expected = 2.0 * (difference(roots) ** 2).sum(axis=(1, 2))
    np.testing.assert_allclose(square, expected, rtol=1e-8)
    np.testing.assert_allclose(compiled.gradient(at)[0], compiled.linearize(at, None).b, atol=1e-9)

    machine = compiled.interpreted()
    there = machine.evaluate(v)
    np.testing.assert_allclose(there.terms[..., term], at.terms[..., term], rtol=1e-12)
    made = machine.linearize(there, lam)
    for name in ("H", "b"):
        one, two = getattr(made, name), getattr(model, name)
        np.testing.assert_allclose(one, two, rtol=0, atol=1e-12 * abs(two).max())


def test_members_of_a_batch_keep_their_networks() -> None:
    plain = problem("nodes", 6)
    batch = [regularised(plain, seed=seed) for seed in range(3)]
    nodes = np.repeat(plain.start[None, None], 3, axis=0)
    nodes = nodes + 0.1 * np.random.default_rng(7).standard_normal((3, 8, plain.dynamics.nx))
    compiled = CompiledProblem(batch)
    v = compiled.unknowns(nodes)
    whole = compiled.term_values(compiled.evaluate(v))[:, -1]
    part = compiled.take(np.array([2, 0]))
    np.testing.assert_allclose(part.term_values(part.evaluate(v[[2, 0]]))[:, -1], whole[[2, 0]])
    alone = [CompiledProblem([one]) for one in batch]
    each = [c.term_values(c.evaluate(v[k : k + 1]))[0, -1] for k, c in enumerate(alone)]
    np.testing.assert_allclose(whole, each)


def test_other_weights_compile_nothing() -> None:
    plain = problem("nodes", 6)
    first, second = (CompiledProblem([regularised(plain, seed=seed)]) for seed in (0, 1))
    assert first.program.c_text() == second.program.c_text()
    assert first.functions is second.functions


def test_a_step_without_weight_may_be_anything() -> None:
    plain = problem("nodes", 6)
    compiled = CompiledProblem([regularised(plain, np.array([1.0, 0, 0, 0, 0, 0]))])
    nodes = np.repeat(plain.start[None, None], 8, axis=1)
    nodes[:, -1] = 1e300
    v = compiled.unknowns(nodes)
    at = compiled.evaluate(v)
    assert np.isfinite(at.terms[..., -1]).all()


def test_a_converged_spline_is_where_the_next_solve_starts() -> None:
    """Its tangents are those that it was found with."""
    plain = problem(x0=None, parameters={"contact.w_perp": 2e3, "contact.w_par": 2e4})
    found = octo.solve(plain, max_iterations=100)
    assert found.converged
    again = octo.solve(plain, start=found)
    assert again.converged and again.iterations <= 2
    np.testing.assert_allclose(again.energy, found.energy, rtol=1e-6)
    made = learn.controls(found)
    np.testing.assert_allclose(made[1:], found.unknowns[:-1], atol=1e-12)
    np.testing.assert_allclose(made[0], [*plain.start, *np.zeros(plain.dynamics.nx)], atol=1e-12)
