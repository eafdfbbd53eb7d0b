"""From an iterate of phases to their motions, and to the whole that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from octo.dynamics.evaluate import RobotDynamics
from octo.problem.continued import BEFORE
from octo.problem.evaluation import Evaluation
from octo.problem.phased import Compiled, PhasedProblem
from octo.result.even import ROWS
from octo.result.measure import ground, measured
from octo.result.residuals import Residual
from octo.result.trajectory import Trajectory


def motion_of(problem: Compiled, at: Evaluation, member: int) -> dict[str, Any]:
    """The fields of a Trajectory, of one member's iterate of a problem or of phases."""
    if not isinstance(problem, PhasedProblem):
        return measured(problem, at, member)
    pairs = zip(problem.parts, problem.evaluations(at), strict=True)
    phases = [Trajectory(**measured(part, own, member)) for part, own in pairs]
    for k, phase in enumerate(phases[1:], start=1):
        phases[k] = replace(phase, unknowns=phase.unknowns[BEFORE:])
    return _whole(problem, at, member, phases)


def _whole(
    problem: PhasedProblem, at: Evaluation, member: int, phases: Sequence[Trajectory]
) -> dict[str, Any]:
    first, steps = phases[0], problem.first_steps
    began = problem.problems[member].times[list(steps[:-1])]  # (phases,) s
    terms: dict[str, float] = {}
    for phase in phases:
        for name, value in phase.terms.items():
            terms[name] = terms.get(name, 0.0) + value
    made = {name: getattr(first, name) for name in ("name", "character", "basis", "weight")}
    made |= {name: getattr(first, name) for name in ("length", "torque_limit", "contact_names")}
    made |= {name: np.concatenate([getattr(one, name) for one in phases]) for name in ROWS}
    made |= {
        name: max(getattr(one, name) for one in phases)
        for name in ("violation", "pointwise_residual")
    }
    places = list(enumerate(zip(phases, steps, began.tolist(), strict=False)))
    return made | {
        "dt": float(problem.problems[member].times[-1]) / problem.steps,
        "x": at.nodes[member].copy(),
        "unknowns": at.unknowns[member].copy(),
        "terms": terms,
        "parameters": first.parameters,
        "ground": _ground(problem, member, made["contact_point"]),
        "asked": tuple(
            replace(one, name=_named(one.name, k)) for k, (own, *_) in places for one in own.asked
        ),
        "bounds": tuple(
            replace(one, name=_named(one.name, k), step=one.step + step, time=one.time + time)
            for k, (own, step, time) in places
            for one in own.bounds
        ),
        "residuals": _worst(
            [
                replace(one, step=one.step + step, time=one.time + time)
                for _, (own, step, time) in places
                for one in own.residuals
            ]
        ),
        "phases": tuple(phases),
    }


def _named(name: str, phase: int) -> str:
    """What a term is called among those of all phases."""
    return f"{name} (phase {phase})"


def _worst(residuals: Sequence[Residual]) -> tuple[Residual, ...]:
    """Of each row of C the moment at which most is missing, over all phases."""
    worst: dict[str, Residual] = {}
    for one in residuals:
        if one.row not in worst or one.part > worst[one.row].part:
            worst[one.row] = one
    return tuple(worst.values())


def _ground(problem: PhasedProblem, member: int, points: Any) -> dict[str, Any]:
    """The ground of the first phase under the whole motion."""
    first = problem.parts[0]
    dynamics = first.dynamics
    if not isinstance(dynamics, RobotDynamics) or not points.size:
        return {}
    return ground(dynamics, first.p[member], points)
