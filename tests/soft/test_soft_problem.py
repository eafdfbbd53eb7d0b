"""Soft bodies in problems: at rest, compiled and interpreted alike, solved, played back."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from soft.clouds import cloud

import octo
from octo import laws, soft
from octo.problem.compiled import CompiledProblem

STEPS, DT = 24, 0.025


@lru_cache
def hopper() -> soft.SoftDynamics:
    """1.5 kg on a law that it sinks into by about half a centimetre."""
    return soft.SoftDynamics(cloud(5, 150), laws.Smooth(w_perp=1e5, onset=0.01))


def off(step: octo.costs.StepSymbols, p: dict[str, ca.SX]) -> ca.SX:
    return (step.x_next[:3] - p["target"]) / 0.1


def hop(**fields: object) -> octo.Problem:
    """Up by 12 cm, and on by 5 cm."""
    start = hopper().rest(hopper().layout.pack())
    target = start[:3] + [0.05, 0.0, 0.12]
    costs = [
        octo.CustomCost(off, {"target": target}, name="Apex", at="last"),
        octo.Effort(reference=50.0),
    ]
    usual = {"steps": STEPS, "dt": DT, "costs": costs, "x0": start}
    return octo.Problem(hopper(), **{**usual, **fields})


def test_a_body_rests_where_nothing_moves() -> None:
    dynamics, p = hopper(), hopper().layout.pack()
    x = dynamics.rest(p)
    left = dynamics.evaluate(np.repeat(x[None, None], 3, axis=1), p[None])[0]
    assert np.abs(left).max() < 1e-7 * dynamics.weight
    motion = octo.simulate(dynamics, x, seconds=0.5, dt=DT)
    np.testing.assert_allclose(motion.x, np.tile(x, (len(motion.x), 1)), atol=1e-6)
    assert np.abs(x[6:]).max() > 1e-4  # it sags
    begun = octo.Problem(dynamics, steps=4, dt=DT, costs=[octo.Effort()])
    np.testing.assert_array_equal(begun.start, octo.Problem.start.func(begun))
    assert np.abs(begun.start - x).max() < 1e-6


def test_a_body_that_cannot_rest_is_named() -> None:
    dynamics = hopper()
    slope = octo.Plane(slope=0.3)
    rolling = soft.SoftDynamics(dynamics.body, dynamics.law, slope)
    with pytest.raises(octo.errors.StaticPoseError, match="cloud comes to no rest"):
        rolling.rest(rolling.layout.pack())


def test_forces_are_measured_in_the_weight() -> None:
    problem, body = hop(), hopper().body
    assert problem.weight == pytest.approx(9.81 * body.mass, rel=1e-12)
    heights = (
        hopper()
        ._stages[2]
        .places(soft.nodes.Nodes.of(hopper().moments, hopper()._stages[0], problem.start[None]))[
            ..., 2
        ]
    )
    assert problem.length == pytest.approx(problem.start[2] - heights.min(), rel=1e-12)
    np.testing.assert_allclose(problem.row_scale[:3], 1.0 / problem.weight)
    np.testing.assert_allclose(problem.row_scale[3:], 1.0 / problem.weight / problem.length)
    one = soft.SoftDynamics(body, actuated=[1])
    assert len(one.row_scale(0.1)) == 10 and np.ptp(one.row_scale(0.1)[6:]) == 0.0


def test_native_and_interpreted_problems_are_one() -> None:
    problem = CompiledProblem([hop()], exact=True)
    rng = np.random.default_rng(0)
    nodes = np.repeat(problem.problems[0].start[None], STEPS + 2, axis=0)
    nodes[2:] += 0.004 * rng.normal(size=(STEPS, hopper().nx))
    made = []
    for one in (problem, problem.interpreted()):
        unknowns = one.unknowns(nodes[None])
        at = one.evaluate(unknowns)
        lam = np.random.default_rng(1).normal(size=(1, one.K, one.ma))
        model = one.linearize(at, lam)
        made.append([at.fd, at.C, model.H, model.A, model.b])
    for own, other in zip(*made, strict=True):
        np.testing.assert_allclose(own, other, rtol=0.0, atol=1e-12 * np.abs(other).max())


def test_a_hop_is_found_and_played_back() -> None:
    problem = hop()
    solution = octo.solve(problem, max_iterations=300)
    assert solution.converged, str(solution)
    target = problem.start[:3] + [0.05, 0.0, 0.12]
    assert np.abs(solution.x[-1, :3] - target).max() < 0.02
    assert solution.violation < 1e-6
    motion = octo.simulate(hopper(), problem.start, controls=solution.u, dt=DT)
    assert motion.converged.all()
    np.testing.assert_allclose(motion.x, solution.x, atol=1e-5)


def test_ipopt_finds_the_same_hop() -> None:
    """By octo's own functions, from the same start."""
    problem = hop()
    found, other = octo.solve(problem, max_iterations=300), octo.reference.ipopt(problem).solution
    assert found.converged and other.converged, str(other)
    assert other.energy == pytest.approx(found.energy, rel=0.05)
