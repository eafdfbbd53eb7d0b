"""The verbatim trust region: normalised E, Eq. 11, the radius, what is accepted, when it ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import octo
from octo.arrays import largest
from octo.problem.compiled import CompiledProblem, Evaluation
from octo.solver import trust_region
from octo.solver.acceptance import Step
from octo.solver.filter import FilterAcceptance
from octo.solver.options import SqpOptions
from octo.solver.rule import Clock
from octo.solver.status import Status
from octo.solver.subproblem import inner, minimize
from octo.solver.trust_region import MeritAcceptance, TrustRegion

ITERATIONS = 60


class Recorder(TrustRegion):
    """One iteration after the other, with what Algorithm 1 says of each."""

    tried: list[np.ndarray]

    def run(self, at, iterations: int) -> list[dict[str, np.ndarray]]:
        problem, merit, direction = self.trials.problem, self.acceptance.merit, self.direction
        lam, rows, model = np.zeros((problem.batch, problem.K, problem.ma)), [], None
        for iteration in range(iterations):
            model = problem.linearize(at, None)
            radius = direction.radius.copy()
            self.tried.clear()
            move = self.move(at, lam, model, iteration)
            row = {
                "before": radius,
                "after": direction.radius.copy(),
                "mu": self.acceptance.mu.copy(),
                "accepted": move.accepted,
                "length": self.tried[0],
                "merit": (merit(at), merit(move.at)),
                "taken": move.taken,
                "converged": move.converged,
                "violation": (largest(at.C) * problem.weight, largest(move.at.C) * problem.weight),
                "same": (move.at.unknowns == at.unknowns).all(axis=(1, 2))
                & (move.lam == lam).all(axis=(1, 2)),
            }
            rows.append(row)
            at, lam = move.at, move.lam
        return rows


@pytest.fixture
def rows(swing_up, turning, monkeypatch) -> list[dict[str, np.ndarray]]:
    problem = CompiledProblem([swing_up()] * 2)
    nodes = np.stack([np.concatenate([turning[:1], path]) for path in (turning, turning**1.2)])
    unknowns = problem.unknowns(nodes)
    scaled = TrustRegion.normalised(problem, unknowns)
    at = scaled.evaluate(unknowns)
    recorder = Recorder(scaled, at, SqpOptions.paper(), Clock())
    recorder.tried = []

    def watched(*arguments):
        step = minimize(*arguments)
        recorder.tried.append(np.sqrt(inner(step.delta, step.delta)))
        return step

    monkeypatch.setattr(trust_region, "minimize", watched)
    return recorder.run(at, ITERATIONS)


def test_the_penalty_never_falls(rows):
    mu = np.stack([row["mu"] for row in rows])
    assert (np.diff(mu, axis=0) >= 0.0).all() and (mu[-1] > 0.0).all()


def test_radius_rules(rows):
    """∞ first, then ‖Δ‖; × 1.2 where the step was taken, 0.8‖Δ‖ where it was not."""
    assert np.isinf(rows[0]["before"]).all()
    for number, row in enumerate(rows):
        taken = row["accepted"]
        base = np.where(np.isinf(row["before"]), row["length"], row["before"])
        np.testing.assert_allclose(row["after"][taken], 1.2 * base[taken])
        assert (
            row["length"] <= np.where(np.isinf(row["before"]), np.inf, row["before"]) * (1 + 1e-9)
        ).all()
        np.testing.assert_allclose(row["after"][~taken], 0.8 * row["length"][~taken])
        if number:
            np.testing.assert_array_equal(row["before"], rows[number - 1]["after"])


def test_what_is_accepted(rows):
    """The merit falls, and ‖C‖∞ ends below C_max or below where it was; nothing moves otherwise."""
    accepted = np.stack([row["accepted"] for row in rows])
    assert accepted.any() and not accepted.all()
    for row in rows:
        taken, (before, after), (was, now) = row["accepted"], row["merit"], row["violation"]
        assert (after[taken] < before[taken]).all()
        assert ((now < 0.1) | (now < was))[taken].all()
        assert row["same"][~taken].all() and (row["taken"][~taken] == 0.0).all()


def test_it_ends_on_the_step_and_the_constraints(rows):
    for row in rows:
        expected = row["accepted"] & (row["taken"] < 1e-3) & (row["violation"][1] < 1e-5)
        np.testing.assert_array_equal(row["converged"], expected)


def test_energy_is_normalised_by_the_start(swing_up, balance, turning):
    """E_obj is 1 at the start and E_reg is 1e-4‖u‖² over the steps, for each member; the problem
    itself keeps its numbers."""
    problem = CompiledProblem([balance(x0=np.array([0.0, tilt])) for tilt in (0.1, 0.5)])
    unknowns = problem.unknowns(np.repeat(problem.start[:, None], 42, axis=1))
    plain = problem.evaluate(unknowns)
    scaled = TrustRegion.normalised(problem, unknowns)
    at = scaled.evaluate(unknowns)
    values = scaled.term_values(at)
    np.testing.assert_allclose(values[:, 0], 1.0)
    np.testing.assert_allclose(values[:, 1], 1e-4 * (at.fd[..., 0] ** 2).sum(axis=1))
    np.testing.assert_array_equal(problem.evaluate(unknowns).terms, plain.terms)


def test_steps_within_the_same_radius_rule_in_the_history(swing_up, turning):
    history = octo.solve(
        swing_up(), start=turning, options=SqpOptions.paper(), max_iterations=80
    ).history
    taken = history["taken"] > 0.0
    np.testing.assert_allclose(
        history["radius"][1:][taken[1:]] / history["radius"][:-1][taken[1:]], 1.2
    )
    assert (
        history["radius"][1:][~taken[1:]] <= 0.8 * history["radius"][:-1][~taken[1:]] * (1 + 1e-9)
    ).all()
    assert (np.diff(history["energy"]) != 0.0)[taken[:-1]].all()


def test_a_start_that_is_the_solution_already(balance):
    """Standing still with nothing to do: E is 0 / 0 in the paper's normalisation, and ends at once
    here."""
    solution = octo.solve(
        balance(x0=np.zeros(2)), start=np.zeros((41, 2)), options=SqpOptions.paper()
    )
    assert solution.status is Status.CONVERGED and solution.energy < 1e-20


def numbers(energy: float, size: float) -> Evaluation:
    """One member, with E and one row of C."""
    C = np.array([[[size]]])
    none = np.zeros((1, 1, 0))
    return Evaluation.of(none, none, none, np.array([[[energy]]]), none, C)


def test_the_penalty_of_the_merit():
    """Eq. 11 by hand: μ = energy / ((1 − ρ)·½(‖C‖² − ‖r‖²)), monotone; a step of a line leaves
    (1 − length) of C."""
    at = numbers(1.0, 2.0)
    rule = MeritAcceptance(most=0.5).started(at)
    one = np.ones(1)
    step = Step(one, -one, one, np.zeros((1, 1, 1)), (7.0 * one, 1.0 * one))
    assert not rule.accepts(at, numbers(12.0, 1.0), step)[0]  # 12 + μ/2 against 1 + 2μ
    np.testing.assert_allclose(rule.mu, 7.0 / (0.7 * 0.5 * 3.0))
    assert rule.accepts(at, numbers(10.9, 1.0), step)[0]
    assert not rule.accepts(at, numbers(-50.0, 3.0), step)[0]  # ‖C‖∞ grows, above ``most``
    assert rule.accepts(at, numbers(-50.0, 0.4), step)[0]
    assert not rule.accepts(at, numbers(np.nan, 0.0), step)[0]
    along = Step(0.5 * one, 40.0 * one, one, np.zeros((1, 1, 1)))
    rule.accepts(at, at, along)
    np.testing.assert_allclose(rule.mu, 20.0 / (0.7 * 0.5 * (4.0 - 1.0)))
    rule.accepts(at, at, step)
    np.testing.assert_allclose(rule.mu, 20.0 / (0.7 * 0.5 * (4.0 - 1.0)))


class Counted(MeritAcceptance):
    """The paper's rule by another name, which counts."""

    asked = 0

    def accepts(self, at, trial, step):
        Counted.asked += 1
        return super().accepts(at, trial, step)


def test_directions_and_acceptances_combine(swing_up, turning):
    """The merit decides about lines too, a filter and a rule of one's own about steps within a
    radius."""
    problem = swing_up()
    settings = {"start": turning, "max_iterations": 150, "device": "cpu"}
    paper = octo.solve(problem, options=SqpOptions.paper(), **settings)
    own = octo.solve(
        problem, options=SqpOptions.paper(acceptance=Counted(0.1 / problem.weight)), **settings
    )
    assert Counted.asked >= len(paper.history["energy"]) - 1
    for name in ("energy", "radius", "ratio", "taken"):
        np.testing.assert_array_equal(own.history[name], paper.history[name])
    exact, line = SqpOptions(step="trust_region", tolerance=1e-5), SqpOptions()
    for options, other in ((exact, FilterAcceptance()), (line, MeritAcceptance(1.0))):
        expected, found = (
            octo.solve(problem, options=replace(options, acceptance=rule), **settings)
            for rule in (None, other)
        )
        assert {found.status, expected.status} <= {Status.CONVERGED, Status.ACCEPTABLE}
        assert found.energy == pytest.approx(expected.energy, rel=1e-2)
