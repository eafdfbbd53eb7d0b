"""Where there is one optimum, octo, IPOPT and fatrop find it; and what a run says about itself."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import octo
from octo import costs, native
from octo.continuation.schedule import schedule
from octo.errors import OctoError, ProblemError, ShapeError
from octo.problem.basis import Hermite
from octo.problem.problem import Problem
from octo.reference import Fatrop, Ipopt, fatrop, ipopt, nlp
from octo.reference.run import one_core
from octo.solver.options import SqpOptions
from octo.solver.status import HISTORY, Status
from octo.starts import first_nodes

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
SAME = 1e-6  # part of E


def _agree(problem: Problem, solvers: tuple[Callable, ...]) -> None:
    own = octo.solve(
        problem, start=np.repeat(problem.start[None], problem.steps + 1, axis=0), device="cpu"
    )
    assert own.converged
    for solver in solvers:
        run = solver(problem)
        assert run.solution.status is Status.CONVERGED and run.compiled, run.said
        assert run.solution.energy == pytest.approx(own.energy, rel=SAME, abs=0.0)
        assert run.solution.violation <= 1e-6 * own.weight
        assert np.abs(run.solution.x - own.x).max() < 5 * SAME**0.5  # E is flat at its least


@pytest.mark.parametrize("basis", ["nodes", Hermite(10)])
def test_cart_pole_balanced(basis: str | Hermite, cart_pole: Callable[..., Problem]) -> None:
    _agree(cart_pole(basis=basis), (ipopt, fatrop) if basis == "nodes" else (ipopt,))


def test_settle(robot: Callable[..., Problem]) -> None:
    """Of the first two terms alone the still stance is a saddle between two optima, each the
    other's mirror image."""
    problem = robot(
        "biped", 20, [costs.CenterOfMassVelocity(), costs.Effort(), costs.Posture(weight=0.005)]
    )
    names = ("contact.w_perp", "contact.w_par", "contact.onset")  # as they are: one pass
    values = dict(zip(problem.dynamics.layout.names, problem.p.tolist(), strict=True))
    _agree(problem.replace(parameters={name: values[name] for name in names}), (ipopt, fatrop))


def test_a_fixed_end(cart_pole: Callable[..., Problem]) -> None:
    problem = cart_pole(x_end=np.array([0.2, 0.0]))
    _agree(problem, (ipopt, fatrop))


def test_a_cycle(cycle: Callable[..., Problem]) -> None:
    """From one start; and IPOPT from beside octo's solution, with the multipliers that belong to
    it."""
    problem = cycle("biped", 12, octo.Cycle(speed=0.5, period=0.8))
    stage = schedule(problem, 1)[0]
    assert stage is not None
    problem = problem.replace(parameters=stage.parameters(problem.weight))
    options = SqpOptions(dual_tolerance=1e-7, step_tolerance=1e-5, plateau_change=1e-13)
    solver, start = Ipopt(problem, options), first_nodes(problem, 0, None)
    own = octo.solve(problem, start=start[1:], options=options, device="cpu")
    noise = 1e-3 * np.random.default_rng(0).standard_normal(start.shape)
    cold, near = solver.solve(start).solution, solver.solve(own.x + noise).solution
    assert own.status is cold.status is near.status is Status.CONVERGED
    assert [cold.energy, near.energy] == pytest.approx([own.energy] * 2, rel=SAME)
    assert np.abs(near.x - own.x).max() < 5 * SAME**0.5
    assert max(run.violation for run in (own, cold, near)) <= 1e-6 * own.weight
    warm = solver.solve(own.x, own.multipliers).solution
    assert warm.converged and warm.iterations < near.iterations


RATES = {
    "nodes": {},
    "hermite": {"basis": Hermite(10)},
    "odd, to a fixed end": {"steps": 41, "x_end": np.array([0.2, 0.0])},
}


@pytest.mark.parametrize("name", RATES)
def test_how_fast_a_force_changes(name: str, cart_pole: Callable[..., Problem]) -> None:
    problem = cart_pole(**RATES[name])
    _agree(problem.replace(costs=[*problem.costs, costs.TorqueRate(weight=1e-4)]), (ipopt,))


@pytest.mark.slow
def test_how_fast_torques_change_in_a_cycle(cycle: Callable[..., Problem]) -> None:
    """IPOPT stays at octo's solution, with two pairs a unit and the seam."""
    problem = cycle("biped", 12, octo.Cycle(speed=0.5, period=0.8))
    stage = schedule(problem, 1)[0]
    assert stage is not None
    terms = [term for term in problem.costs if term is not problem.anchor]
    problem = problem.replace(
        parameters=stage.parameters(problem.weight), costs=[*terms, costs.TorqueRate()]
    )
    options = SqpOptions(dual_tolerance=1e-7, step_tolerance=1e-5, plateau_change=1e-13)
    own = octo.solve(problem, start=first_nodes(problem, 0, None)[1:], options=options)
    near = Ipopt(problem, options).solve(own.x, own.multipliers).solution
    assert own.status is near.status is Status.CONVERGED
    assert own.terms["TorqueRate"] > 1e-4 * own.energy
    assert near.energy == pytest.approx(own.energy, rel=SAME)


LIMITS = {
    "a motor's force": {"constraints": [octo.TorqueLimits(limit=4.7)]},
    "in hermite": {"basis": Hermite(10), "constraints": [octo.TorqueLimits(limit=4.2)]},
    "a speed": {"constraints": [octo.JointSpeedLimits(limit=0.32)]},
    "a way and its end": {
        "constraints": [
            octo.StepLimit(largest=[0.018, np.inf]),
            octo.CustomConstraint(lambda step, p: step.x_next[0], 0.01, 0.01, at="last"),
        ]
    },
}


@pytest.mark.parametrize("name", LIMITS)
def test_what_is_between_bounds(name: str, cart_pole: Callable[..., Problem]) -> None:
    """A bound costs each solver its last weight of the barrier: E agrees to a millionth."""
    problem = cart_pole(**LIMITS[name])
    start = np.repeat(problem.start[None], problem.steps + 1, axis=0)
    own, free = (octo.solve(p, start=start) for p in (problem, problem.replace(constraints=[])))
    assert own.converged and own.energy > free.energy + 1e-5
    runs = [ipopt(problem)]
    if problem.basis_object.name == "nodes":
        runs.append(fatrop(problem, settings={"tolerance": 1e-8}))
    for run in runs:
        assert run.solution.status is Status.CONVERGED, run.said
        assert run.solution.energy == pytest.approx(own.energy, abs=1e-6, rel=0.0)
        assert all(bound.held for bound in run.solution.bounds)
        assert np.abs(run.solution.x - own.x).max() < 1e-3
    warm = Ipopt(problem).solve(own.x, own.multipliers).solution
    assert warm.converged and warm.iterations < runs[0].solution.iterations


@pytest.mark.slow
def test_a_cycle_between_bounds(cycle: Callable[..., Problem]) -> None:
    """IPOPT stays at octo's solution, where motors and joints are at their limits."""
    problem = cycle("biped", 12, octo.Cycle(speed=0.5, period=0.8))
    stage = schedule(problem, 1)[0]
    assert stage is not None
    limits = [octo.TorqueLimits(limit=36.5), octo.JointSpeedLimits(limit=6.0)]
    problem = problem.replace(parameters=stage.parameters(problem.weight), constraints=limits)
    options = SqpOptions(dual_tolerance=1e-7, step_tolerance=1e-5, plateau_change=1e-13)
    own = octo.solve(problem, start=first_nodes(problem, 0, None)[1:], options=options)
    near = Ipopt(problem, options).solve(own.x, own.multipliers).solution
    assert own.status is near.status is Status.CONVERGED
    assert near.energy == pytest.approx(own.energy, abs=1e-6, rel=0.0)
    assert np.abs(near.x - own.x).max() < 1e-4
    for bound in (*own.bounds, *near.bounds):
        assert -1e-4 < bound.excess < 1e-6


def test_an_acceptable_point_is_at_its_bounds(cart_pole: Callable[..., Problem]) -> None:
    """octo's rule waits for complementarity, however level E is on the way."""
    options = SqpOptions(plateau=2, plateau_change=0.99, tolerance=1e-2)
    problem = cart_pole(constraints=[octo.TorqueLimits(limit=4.7)])
    run = ipopt(problem, options=options, settings={"mu_init": 1e-3, "dual_inf_tol": 1e-300})
    assert run.solution.status is Status.ACCEPTABLE and "octo's rule" in run.said
    assert run.solution.energy == pytest.approx(ipopt(problem).solution.energy, abs=1e-6)


def test_fatrop_refuses_cycles(cycle: Callable[..., Problem]) -> None:
    with pytest.raises(ProblemError, match="cannot solve a cycle"):
        fatrop(cycle("biped", 6, octo.Cycle(speed=0.5, period=0.6)))


def test_fatrop_refuses_hermite(cart_pole: Callable[..., Problem]) -> None:
    with pytest.raises(ProblemError, match="hermite basis.*must be nodes"):
        fatrop(cart_pole(basis="hermite"))


@pytest.mark.parametrize("kind", [Ipopt, Fatrop])
def test_history_and_limits(kind: type, cart_pole: Callable[..., Problem]) -> None:
    problem = cart_pole(x0=np.array([0.0, 1.5]))
    run = kind(problem).solve()
    history = run.solution.history
    assert set(history) == set(HISTORY)
    assert len(history["energy"]) >= run.solution.iterations
    assert (np.diff(history["seconds"]) >= 0.0).all() and history["seconds"][
        -1
    ] <= run.solution.seconds
    assert history["violation"][-1] <= 1e-5 < history["violation"][0]
    assert history["energy"][-1] == pytest.approx(run.solution.energy)
    short = kind(problem, SqpOptions(max_iterations=2)).solve().solution
    assert short.status is Status.ITERATION_LIMIT and short.iterations <= 3


def test_ipopt_starts_warm(cart_pole: Callable[..., Problem]) -> None:
    """From its own solution and multipliers it has nothing left to do."""
    solver = Ipopt(cart_pole(x0=np.array([0.0, 1.0])))
    cold = solver.solve(seed=3).solution
    warm = solver.solve(cold.x, cold.multipliers).solution
    assert warm.iterations <= 1 < cold.iterations and cold.seed == 3


def test_octos_rule_of_an_acceptable_point_stops_ipopt(cart_pole: Callable[..., Problem]) -> None:
    run = ipopt(
        cart_pole(x0=np.array([0.0, 1.5])),
        options=SqpOptions(dual_tolerance=1e-300, plateau=2, plateau_change=1e-2),
    )
    assert run.solution.status is Status.ACCEPTABLE and "octo's rule" in run.said


def test_one_core_is_one_core(cart_pole: Callable[..., Problem]) -> None:
    """Asked of the library itself: MUMPS calls a BLAS of CasADi's own, as wide as the machine by
    default."""
    Ipopt(cart_pole())  # loads it
    found = list(Path(ca.__file__).parent.glob("libcasadi-tp-openblas.so*"))
    if not found:
        pytest.skip("this CasADi has another BLAS")
    blas = ctypes.CDLL(str(found[0]))
    blas.openblas_set_num_threads(2)
    before = blas.openblas_get_num_threads()
    with one_core():
        assert blas.openblas_get_num_threads() == 1
    assert blas.openblas_get_num_threads() == before


def test_without_a_compiler_casadi_interprets(
    cart_pole: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(native, "compiler", lambda: None)
    run = ipopt(cart_pole())
    assert run.solution.status is Status.CONVERGED and not run.compiled


def test_what_is_no_problem_or_no_start(cart_pole: Callable[..., Problem]) -> None:
    described = cart_pole()
    for solver in (ipopt, fatrop, nlp):
        with pytest.raises(ProblemError, match="problem is .*, must be an octo.Problem"):
            solver([described])
        with pytest.raises(OctoError, match="start"):
            solver(described, start="walk.npz")
    with pytest.raises(ShapeError, match="start"):
        nlp(described, start=np.zeros((3, described.dynamics.nx)))
