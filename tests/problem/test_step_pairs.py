"""Terms over two steps in a row: units of two nodes, E and its model against other forms, what is
refused."""

from __future__ import annotations

import importlib
from functools import lru_cache

import numpy as np
import pytest
from extending.pseudo_huber import PseudoHuber
from extending.torque_rate import PowerChange
from walker import BASES, START, walker, wiggle_near_ground

import octo
from octo.errors import ProblemError
from octo.gpu.problem import DeviceProblem
from octo.problem.basis import Folded, Nodes, PairedNodes, node_values
from octo.problem.compiled import CompiledProblem
from octo.reference.program import free_places, nlp, point_of, rows_of
from octo.starts import first_nodes
from tests import emulator
from tests.emulator import EmulatedDevice

DT = 0.05
DOUBLE = octo.CodeStage(
    "double_",
    inputs=1,
    outputs=1,
    text="static void double_(const double *a, double *value, double *slopes) {\n"
    "  value[0] = 2.0 * a[0];\n  if (slopes) slopes[0] = 2.0;\n}\n",
    python=lambda a: (2.0 * a, np.full((*a.shape[:-1], 1, 1), 2.0)),
)
CASES = [  # the basis, the steps, whether the end is fixed
    ("nodes", 12, False),
    ("nodes", 13, False),
    ("nodes", 13, True),
    ("nodes", 24, True),
    ("hermite", 12, False),
    ("hermite", 12, True),
    ("mirrored", 12, False),
    ("mirrored", 15, False),
    ("turning", 5, False),
    ("turning", 14, False),
]
CYCLES = {
    "mirrored": octo.Cycle(speed=0.5, period=0.6),
    "turning": octo.Cycle(speed=0.3, sideways=0.1, turn=-0.4, period=0.6, mirror=False),
}


def problem(basis: str, steps: int, end: bool, *terms: octo.Cost) -> octo.Problem:
    costs = [octo.Effort(), *(terms or [octo.TorqueRate(weight=2.0)])]
    if basis in CYCLES:
        return octo.Problem(mammal(), steps=steps, costs=costs, cycle=CYCLES[basis])
    x_end = START + 0.02 if end else None
    return octo.Problem(
        walker(), steps=steps, dt=DT, costs=costs, basis=BASES[basis], x0=START, x_end=x_end
    )


@lru_cache
def mammal() -> octo.Character:
    return octo.gallery.mammal()


@lru_cache
def compiled(basis: str, steps: int, end: bool, threads: int = 1) -> CompiledProblem:
    per_step = np.linspace(0.0, 2.0, steps)[::-1]
    terms = [octo.TorqueRate(weight=per_step), PowerChange(at="last")]
    like = compiled(basis, steps, end) if threads > 1 else None
    return CompiledProblem([problem(basis, steps, end, *terms)] * 2, threads, like=like)


def wiggle(made: CompiledProblem) -> np.ndarray:
    """(batch, K, nc) unknowns of a motion close to the ground."""
    if made.carry is None:
        return wiggle_near_ground(made)
    nodes = np.stack([first_nodes(each, 3, None) for each in made.problems])
    return made.unknowns(nodes + 0.01 * np.random.default_rng(0).standard_normal(nodes.shape))


def dense(made: CompiledProblem, blocks: np.ndarray) -> np.ndarray:
    """H of the first member."""
    K, nc = made.K, made.nc
    whole = np.zeros((K, nc, K, nc))
    for k in range(K):
        for lag in range(min(k, 2) + 1):
            whole[k, :, k - lag] = blocks[0, k, lag]
            whole[k - lag, :, k] = blocks[0, k, lag].T
    return whole.reshape(K * nc, K * nc)


def free(made: CompiledProblem, blocks: np.ndarray) -> np.ndarray:
    """The same over the unknowns that a node is made of."""
    at = free_places(made)
    return dense(made, blocks)[np.ix_(at, at)]


def close(found: np.ndarray, expected: np.ndarray, relative: float = 1e-10) -> None:
    scale = max(1e-12, np.abs(expected).max(initial=0.0))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=relative * scale)


@pytest.mark.parametrize("steps", [12, 13])
def test_two_nodes_a_unit(steps):
    """The same trajectory as with one a unit; rows and windows of four nodes within three units."""
    basis, random = PairedNodes(), np.random.default_rng(0)
    nodes = random.standard_normal((2, steps + 2, 3))
    constant = basis.constant(steps, nodes[:, 1], nodes[:, 0])
    stencil = basis.stencil(steps)
    unknowns = basis.fit(nodes)
    assert unknowns.shape == (2, basis.units(steps), 6)
    np.testing.assert_array_equal(node_values(stencil, unknowns, constant), nodes)
    assert (not basis.idle(steps)) == (steps % 2 == 0)
    for i in range(steps):
        row, window = stencil.test_row[i, 0], stencil.unit[max(i - 1, 0) : i + 3, 0]
        live = window[window >= 0]
        assert live.max() - live.min() <= 2 and live.max() == row == stencil.unit[i + 2, 0]
    places = stencil.unit[2:] * 2 + stencil.part[2:]
    assert len(np.unique(places)) == steps
    pinned = basis.fixed_end(steps, nodes[:, -1], np.ones((2, 3)), DT)
    (unit, value), *others = pinned.items()
    assert unit == basis.units(steps) - 1 and not others
    np.testing.assert_array_equal(value, np.hstack([nodes[:, -1] - DT, nodes[:, -1]]))


@pytest.mark.parametrize("steps", range(4, 20))
def test_two_pairs_a_unit(steps):
    """A cycle: every node once, rows and windows of four nodes within three units, also over the
    seam; what no node is made of is idle or a dummy."""
    basis, plain = Folded(2), Folded()
    nodes = np.random.default_rng(0).standard_normal((steps + 2, 3))
    nodes[:2] = nodes[-2:]  # carried back by nothing
    stencil, constant = basis.stencil(steps), np.zeros_like(nodes)
    np.testing.assert_array_equal(node_values(stencil, basis.fit(nodes), constant), nodes)
    unit = np.concatenate([stencil.unit[steps - 1 : steps], stencil.unit])[:, 0]  # x_{−2} …
    for i in range(steps):
        window, row = unit[i : i + 4], stencil.test_row[i, 0]
        assert window.max() - window.min() <= 2
        assert ((row - window[1:] >= 0) & (row - window[1:] <= 2)).all()
    unused = basis.dummies(steps)
    assert unused.sum() == unused.size - steps
    whole = int(unused[-1].all())
    assert len(basis.idle(steps)) + 4 * whole == unused.sum()
    np.testing.assert_array_equal(plain.stencil(steps).unit // 2, stencil.unit)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("threads", [1, 3])
def test_native_and_interpreted(case, threads):
    made = compiled(*case, threads)
    plain, unknowns = made.interpreted(), wiggle(made)
    lam = np.random.default_rng(0).standard_normal((2, made.K, made.ma))
    at, other = made.evaluate(unknowns), plain.evaluate(unknowns)
    close(at.terms, other.terms)
    assert (at.terms[:, 1:-1, 1] > 0.0).all() and (at.terms[:, :-1, 2] == 0.0).all()
    assert at.terms[:, 0, 1].all() == (made.carry is not None)  # what is before the first step
    for multipliers in (None, lam):
        model, expected = made.linearize(at, multipliers), plain.linearize(other, multipliers)
        for name in ("H", "A", "b", "C"):
            close(getattr(model, name), getattr(expected, name))


@pytest.mark.skipif(emulator.compiler() is None, reason="no C++ compiler")
@pytest.mark.parametrize("case", [CASES[2], CASES[4], CASES[7]])
def test_on_a_device(case):
    made = compiled(*case)
    unknowns, device = wiggle(made), DeviceProblem(made, EmulatedDevice(32, 1))
    lam = np.random.default_rng(0).standard_normal((2, made.K, made.ma))
    at, other = made.evaluate(unknowns), device.evaluate(device.device.array(unknowns))
    close(np.asarray(other.terms), at.terms)
    for multipliers in (None, lam):
        model, found = made.linearize(at, multipliers), device.linearize(other, multipliers)
        for name in ("H", "A", "b", "C"):
            close(np.asarray(getattr(found, name)), getattr(model, name))


@pytest.mark.parametrize("case", CASES)
def test_the_model_is_that_of_casadi(case):
    """E, its gradient and, of a residual that is linear in the torques, its whole Hessian."""
    made = nlp(problem(*case))
    own = made.compiled
    at = own.evaluate(wiggle(own))
    x, p = point_of(own, at.unknowns), made.parameters
    lam = np.random.default_rng(0).standard_normal((1, own.K, own.ma))
    model = own.linearize(at, lam)
    close(np.asarray(made.objective(x, p)).ravel(), at.energy)
    close(np.asarray(made.constraints(x, p)).ravel(), rows_of(own, at.C[0]))
    close(point_of(own, model.b), np.asarray(made.gradient(x, p)).ravel())
    close(free(own, model.H), np.asarray(made.hessian(x, p, 1.0, rows_of(own, lam[0]))))


@pytest.mark.skipif(emulator.compiler() is None, reason="no C++ compiler")
@pytest.mark.parametrize(
    "case", [CASES[2], CASES[8], *(pytest.param(CASES[k], marks=pytest.mark.slow) for k in (4, 7))]
)
def test_exact_terms(case):
    """A residual that bends: its Hessian by CasADi, in C, interpreted and on a device."""
    terms = [PowerChange(loss=PseudoHuber(0.1)), octo.TorqueRate(loss=octo.Huber(0.1))]
    described = problem(*case, *terms)
    form, made = nlp(described), CompiledProblem([described], exact=True)
    unknowns = wiggle(made)
    lam = np.random.default_rng(0).standard_normal((1, made.K, made.ma))
    at = made.evaluate(unknowns)
    model = made.linearize(at, lam)
    x, p = point_of(made, unknowns), form.parameters
    close(free(made, model.H), np.asarray(form.hessian(x, p, 1.0, rows_of(made, lam[0]))))
    without = made.linearize(at, lam, np.zeros(1, dtype=bool)).H
    assert np.abs(without - model.H).max() > 1e-3 * np.abs(model.H).max()
    plain, device = made.interpreted(), DeviceProblem(made, EmulatedDevice(32, 1))
    close(plain.linearize(plain.evaluate(unknowns), lam).H, model.H)
    close(plain.linearize(plain.evaluate(unknowns), lam, np.zeros(1, dtype=bool)).H, without)
    found = device.linearize(device.evaluate(device.device.array(unknowns)), lam)
    close(np.asarray(found.H), model.H)


def test_a_term_without_weight_changes_nothing():
    """Two nodes a unit are the same problem as one."""
    idle = problem("nodes", 13, False, octo.TorqueRate(weight=0.0))
    pairs = CompiledProblem([idle])
    plain = CompiledProblem([idle.replace(costs=[octo.Effort()])])
    assert isinstance(pairs.basis, PairedNodes) and isinstance(plain.basis, Nodes)
    first, second = (made.evaluate(wiggle_near_ground(made)) for made in (pairs, plain))
    np.testing.assert_array_equal(first.nodes, second.nodes)
    np.testing.assert_allclose(first.energy, second.energy, rtol=1e-12)
    one, two = (made.linearize(at, None) for made, at in ((pairs, first), (plain, second)))
    n = plain.n
    blocks = dense(pairs, one.H)[n:, n:]  # the first half of the first unit is no node
    np.testing.assert_allclose(blocks, dense(plain, two.H), rtol=1e-10, atol=1e-10)


def test_a_cycle_is_solved():
    free = problem("mirrored", 12, False, octo.JointVelocity(weight=0.01), octo.Slip())
    slow = free.replace(costs=[*free.costs, octo.TorqueRate(weight=0.02)])
    rates = []
    for each in (free, slow):
        solution = octo.solve(each, passes=1, device="cpu")
        assert solution.converged
        rates.append(np.sqrt((np.diff(solution.u, axis=0) ** 2).mean()) / solution.dt)
    assert rates[1] < 0.8 * rates[0]


def test_torques_change_more_slowly():
    """A motion with the term and without: what it is for."""
    free = octo.Problem(walker(), steps=25, dt=DT, costs=[octo.Posture(), octo.Effort()], x0=START)
    slow = free.replace(costs=[*free.costs, octo.TorqueRate(weight=0.5)])
    rates = []
    for each in (free, slow):
        solution = octo.solve(each, passes=1)
        assert solution.converged
        rates.append(np.sqrt((np.diff(solution.u, axis=0) ** 2).mean()) / DT)
    assert rates[1] < 0.7 * rates[0]


@pytest.mark.parametrize("steps", [1, 2])
def test_few_steps(steps):
    """One step has nothing before it."""
    made = CompiledProblem([problem("nodes", steps, False)])
    plain = made.interpreted()
    at, other = (each.evaluate(wiggle_near_ground(made)) for each in (made, plain))
    assert (at.terms[0, :, 1].any()) == (steps == 2)
    one, two = (each.linearize(e, None) for each, e in ((made, at), (plain, other)))
    np.testing.assert_allclose(one.H, two.H, rtol=0.0, atol=1e-10 * np.abs(two.H).max())
    form = nlp(made.problems[0])
    found = form.objective(point_of(made, at.unknowns), form.parameters)
    np.testing.assert_allclose(float(found), at.energy[0], rtol=1e-12)


class Mapped(octo.TorqueRate):
    def pair_residual(self, step, before, p):
        return before.call(DOUBLE, step.u[0])


class Hard(octo.TorqueRate):
    kind = "bounded"


def test_memory_is_that_of_the_units(monkeypatch):
    """Twice that of single nodes with two nodes a unit, and four times with four."""
    asked = []

    def room(what: str, doubles: float) -> None:
        asked.append(doubles)
        raise ProblemError(what)

    monkeypatch.setattr(importlib.import_module("octo.solve"), "room", room)
    for basis, term in (("nodes", octo.Slip()), ("nodes", octo.TorqueRate())):
        with pytest.raises(ProblemError, match="12 steps of 3 starts"):
            octo.solve(problem(basis, 12, False, term), seeds=3)
    assert asked[1] == 2.0 * asked[0]
    assert Folded(pairs=2).units(400) * Folded(pairs=2).parts ** 2 == pytest.approx(1616)


def test_refused():
    with pytest.raises(ProblemError, match="TorqueRate looks at two .* fatrop"):
        octo.reference.fatrop(problem("nodes", 12, False))
    with pytest.raises(ProblemError, match="TorqueRate looks at two .* controller"):
        octo.mpc.Controller(problem("nodes", 12, False))
    with pytest.raises(ProblemError, match="TorqueRate looks at two .* animate"):
        octo.mpc.animate(problem("nodes", 12, False), 1.0)
    with pytest.raises(ProblemError, match="Hard looks at two .* kind is 'bounded', must be"):
        CompiledProblem([problem("nodes", 12, False, Hard())])
    with pytest.raises(ProblemError, match="Mapped looks at two .* cannot call .* 'double_'"):
        CompiledProblem([problem("nodes", 12, False, Mapped())])
    rate, plain = (problem("nodes", 12, False, term) for term in (octo.TorqueRate(), octo.Slip()))
    with pytest.raises(ProblemError, match="terms differ between problems of one batch"):
        CompiledProblem([rate, plain])
    with pytest.raises(ProblemError, match="basis is that of a cycle: give cycle"):
        plain.replace(basis=Folded())
    for kind in ("residual", "pair_residual", "contact_residual"):
        base = {"residual": octo.Cost, "pair_residual": octo.StepPairCost}
        empty = type("Empty", (base.get(kind, octo.ContactCost),), {})()
        with pytest.raises(ProblemError, match=rf"Empty\.{kind} is missing: write {kind}\(self"):
            CompiledProblem([problem("nodes", 12, False, empty)])
    with pytest.raises(octo.errors.ValueRangeError, match="TorqueRate.reference is 0.0 N m/s"):
        CompiledProblem([problem("nodes", 12, False, octo.TorqueRate(reference=0.0))])
