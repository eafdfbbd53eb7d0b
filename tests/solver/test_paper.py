"""The verbatim trust region: normalised E, Eq. 11, the radius, what is accepted, when it ends."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.arrays import largest
from octo.problem.compiled import CompiledProblem
from octo.solver import trust_region
from octo.solver.options import SqpOptions
from octo.solver.rule import Clock
from octo.solver.status import Status
from octo.solver.subproblem import inner, minimize
from octo.solver.trust_region import TrustRegion

ITERATIONS = 60


class Recorder(TrustRegion):
    """One iteration after the other, with what Algorithm 1 says of each."""

    tried: list[np.ndarray]

    def run(self, at, iterations: int) -> list[dict[str, np.ndarray]]:
        lam, rows, model = np.zeros((self.problem.batch, self.problem.K, self.problem.ma)), [], None
        for iteration in range(iterations):
            model = self.problem.linearize(at, None)
            radius = self.radius.copy()
            self.tried.clear()
            move = self.move(at, lam, model, iteration)
            row = {
                "before": radius,
                "after": self.radius.copy(),
                "mu": self.mu.copy(),
                "accepted": move.accepted,
                "length": self.tried[0],
                "merit": (self._merit(at), self._merit(move.at)),
                "taken": move.taken,
                "converged": move.converged,
                "violation": (
                    largest(at.C) * self.problem.weight,
                    largest(move.at.C) * self.problem.weight,
                ),
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
