"""From an iterate of phases to their motions, and to the whole that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.dynamics.evaluate import RobotDynamics
from octo.problem.compiled import CompiledProblem
from octo.problem.continued import BEFORE
from octo.problem.evaluation import Evaluation
from octo.problem.phased import Compiled, PhasedProblem
from octo.result.bounds import Bound, bounds_kept
from octo.result.measure import ground, measured, passed
from octo.result.residuals import Residual
from octo.result.trajectory import ROWS, VECTORS, Trajectory
from octo.soft.dynamics import SoftDynamics


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
    under = np.concatenate(
        [passed(one.soft is not None, one.x, one.contact_point) for one in phases]
    )
    phases = _of_all_vertices(phases)
    first = phases[0]
    made = {name: getattr(first, name) for name in ("name", "character", "soft", "basis", "weight")}
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
        "ground": _ground(problem, member, under),
        "world": first.world,
        "asked": tuple(
            replace(one, name=_named(one.name, k)) for k, (own, *_) in places for one in own.asked
        ),
        "bounds": _in_order([phase.bounds for phase in phases], steps, began),
        "residuals": _worst(
            [
                replace(one, step=one.step + step, time=one.time + time)
                for _, (own, step, time) in places
                for one in own.residuals
            ]
        ),
        "phases": tuple(phases),
    }


def _of_all_vertices(phases: Sequence[Trajectory]) -> list[Trajectory]:
    """Those of a soft body with the contacts of all phases, for each knows those that come near the
    ground in it; of what another phase knows it is not known where it is, and it carries nothing.
    """
    names = sorted({name for one in phases for name in one.contact_names})
    if phases[0].soft is None or not names:
        return list(phases)
    made = []
    for one in phases:
        columns = [names.index(name) for name in one.contact_names]
        own: dict[str, Any] = {"contact_names": tuple(names)}
        for field in ("contact_depth", *VECTORS):
            known = getattr(one, field)
            whole = np.zeros((known.shape[0], len(names), *known.shape[2:]))
            whole[:, columns] = known
            own[field] = whole
        made.append(replace(one, **own))
    return made


def all_bounds_kept(problem: Compiled, at: Evaluation, member: int) -> tuple[Bound, ...]:
    """Of each constraint of one member, of a problem or of phases, the worst row."""
    if not isinstance(problem, PhasedProblem):
        return bounds_kept(problem, at, member)
    pairs = zip(problem.parts, problem.evaluations(at), strict=True)
    kept = [bounds_kept(part, own, member) for part, own in pairs]
    steps = problem.first_steps
    return _in_order(kept, steps, problem.problems[member].times[list(steps[:-1])])


def _in_order(
    kept: Sequence[Sequence[Bound]], steps: Sequence[int], began: Any
) -> tuple[Bound, ...]:
    """Those of each phase, with its number and with steps and times (phases,) s of the whole."""
    return tuple(
        replace(one, name=_named(one.name, k), step=one.step + step, time=one.time + float(time))
        for k, (own, step, time) in enumerate(zip(kept, steps, began, strict=False))
        for one in own
    )


def row_labels(problem: Compiled) -> NDArray[Any]:
    """(N, rows) names of the constraints that the bounded rows are of; "" where a phase has no such
    row."""
    if not isinstance(problem, PhasedProblem):
        return _labels(problem)
    tables = [_labels(part, k) for k, part in enumerate(problem.parts)]
    made = np.full((problem.steps, max(table.shape[1] for table in tables)), "", dtype=object)
    for first, table in zip(problem.first_steps, tables, strict=False):
        made[first : first + len(table), : table.shape[1]] = table
    return made


def _labels(problem: CompiledProblem, phase: int | None = None) -> NDArray[Any]:
    """(N, rows) of a problem, or of a phase."""
    labels = [problem.problems[0].terms[k].label for k in problem.functions.bounded]
    named = labels if phase is None else [_named(label, phase) for label in labels]
    return np.array([named] * problem.steps, dtype=object).reshape(problem.steps, len(named))


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


def _ground(problem: PhasedProblem, member: int, places: Array) -> dict[str, Any]:
    """The ground of the first phase under places (k, 3) m of the whole motion."""
    first = problem.parts[0]
    dynamics = first.dynamics
    if not isinstance(dynamics, (RobotDynamics, SoftDynamics)) or not len(places):
        return {}
    return ground(dynamics, first.p[member], places)
