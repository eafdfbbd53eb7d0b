"""Why a solve ended as it did, in words and in numbers: which constraints are broken, which laws of
physics do not hold, which terms dominate, and what contradicts what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from octo.checks import Array
from octo.result.bounds import Bound
from octo.result.residuals import Residual
from octo.result.trajectory import Trajectory
from octo.solver.status import Status

LARGE = 0.1  # of E: a term with less does not dominate
MOST = 3  # terms, rows of C and constraints that hold, as many lines at most
# of a pass's record, in a sentence: why its steps have a limit that no constraint says, or why they
# have none though the motion leaps
LIMITED, LEFT_OUT = "limited", "limit_left_out"
# What usually helps, by how a solve ended.
HELP = {
    Status.STALLED: "another start (start=, seeds=) or a smaller dt may get further",
    Status.ITERATION_LIMIT: "give it more iterations (max_iterations=), or another start",
    Status.TIME_LIMIT: "give it more time (time_limit=), or another start",
    Status.INTERRUPTED: "octo.solve(problem, start=solution) goes on from here",
    Status.NOT_FINITE: "look at x0, v0 and the parameters of the dynamics: FD has no value there",
    Status.UNSOLVED: "take a smaller dt",
}


@dataclass(frozen=True, eq=False, repr=False)
class Conflict:
    """Constraints that cannot hold together: without any one of them the others can.

    Attributes
    ----------
    rows: of each of them the worst row of the motion that breaks them least.
    end: whether the fixed last state (x_end, v_end, displacement) is one of them.
    seconds: s, of the motion, which a free duration makes another one than of the solution.
    motion: (N+1, nx) where everything holds together, a motion that shows it: a start for
        ``octo.solve``; None where nothing contradicts and none was found.
    certain: whether each search that found no motion ended at one that breaks its constraints least
        among its neighbours; if not, some gave up before.
    solves: how many searches it took.
    """

    rows: tuple[Bound, ...] = ()
    end: bool = False
    seconds: float = 0.0
    motion: Array | None = None
    certain: bool = True
    solves: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Of the constraints, and "the fixed end"; none where nothing contradicts."""
        return (*(row.name for row in self.rows), *(("the fixed end",) if self.end else ()))

    def __str__(self) -> str:
        if not self.names:
            if self.motion is not None:
                return "everything can hold together: conflict.motion shows it, take it as start="
            return (
                "even without any constraint no motion was found that obeys the laws of physics: "
                "look at the start, at dt and at the parameters"
            )
        words = [_where(row) for row in self.rows]
        words += [f"the fixed end at {self.seconds:.4g} s"] if self.end else []
        if len(words) == 1:
            said = f"{words[0]} cannot hold, whatever else is given up"
        else:
            said = f"{listed(words)} cannot hold together; without any one of them the rest can"
        return said if self.certain else f"as far as {self.solves} searches show, {said}"

    def __repr__(self) -> str:
        return str(self)

    def report(self) -> dict[str, Any]:
        """For JSON, without the motion."""
        return {
            "names": list(self.names),
            "rows": [row.report() for row in self.rows],
            "end": self.end,
            "motion_found": self.motion is not None,
            "certain": self.certain,
            "solves": self.solves,
            "sentence": str(self),
        }


def _where(row: Bound) -> str:
    """A constraint with the bound that is worst kept, in a sentence."""
    what = f"{row.row}{row.when}"
    if row.side == "exactly" and row.bound == 0.0:  # the distance to a target
        return f"{row.name} ({what})"
    allowed = f"{row.side} {row.bound:.4g} {row.unit}".rstrip()
    return f"{row.name} ({what}, {allowed})"


@dataclass(frozen=True, eq=False, repr=False)
class Explanation:
    """Why a solve ended as it did: a text, or its fields.

    Attributes
    ----------
    status: how the solve ended. stopped: the same in a sentence.
    bounds: of each constraint the worst row, those that are broken most first.
    residuals: of each row of C the moment at which most is missing, the largest first; empty where
        the laws of physics hold to the tolerance.
    terms: the parts of E by name, the largest first.
    weight: N, of the robot.
    hints: what to know, and what may help, one sentence each.
    conflict: what contradicts what; None where nobody looked (``octo.explain(problem, solution)``
        does).
    """

    status: Status
    stopped: str
    bounds: tuple[Bound, ...]
    residuals: tuple[Residual, ...]
    terms: dict[str, float]
    weight: float
    hints: tuple[str, ...] = ()
    conflict: Conflict | None = None

    @property
    def broken(self) -> tuple[Bound, ...]:
        """The constraints that do not hold."""
        return tuple(own for own in self.bounds if not own.held)

    @property
    def shares(self) -> dict[str, float]:
        """Parts of E of the terms that dominate, the largest first."""
        total = sum(self.terms.values())
        if not total > 0.0:
            return {}
        parts = {name: value / total for name, value in self.terms.items()}
        return {name: part for name, part in list(parts.items())[:MOST] if part >= LARGE}

    def __str__(self) -> str:
        lines = [self.stopped]
        lines += [f"  {own}" for own in self.broken]
        held = [own for own in self.bounds if own.held]
        lines += [f"  {own}" for own in held[:MOST]]
        if len(held) > MOST:
            lines.append(f"  {len(held) - MOST} more constraints held")
        if self.residuals:
            lines.append("  the laws of physics do not hold yet:")
            lines += [f"    {own}" for own in self.residuals[:MOST]]
        if self.shares:
            parts = ", ".join(f"{name} {part:.0%}" for name, part in self.shares.items())
            lines.append(f"  of E = {sum(self.terms.values()):.4g}: {parts}")
        lines += [f"  {one}" for one in self.hints]
        lines += [] if self.conflict is None else [f"  {self.conflict}"]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return str(self)

    def report(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "status": self.status.label,
            "stopped": self.stopped,
            "bounds": [own.report() for own in self.bounds],
            "residuals": [own.plain() for own in self.residuals],
            "terms": dict(self.terms),
            "shares": self.shares,
            "hints": list(self.hints),
            "conflict": None if self.conflict is None else self.conflict.report(),
        }


def sentence_of(status: Status, bounds: tuple[Bound, ...]) -> str:
    """How a solve ended in a sentence, with the constraints that it leaves broken."""
    broken = sorted((own for own in bounds if not own.held), key=lambda own: -own.excess)
    if status.converged or not broken:
        return status.value
    worst, names = broken[0], [own.name for own in broken]
    many = f"constraint {names[0]} is" if len(names) == 1 else f"constraints {listed(names)} are"
    most = "" if len(names) == 1 else f"most {worst.name}, "
    return status.infeasible(f"the {many} violated: {most}{worst.short}")


def explained(
    motion: Trajectory, status: Status, passes: Sequence[Mapping[str, Any]] = ()
) -> Explanation:
    """What a motion and the end of its solve say, without another solve. passes: a record of
    each."""
    bounds = tuple(sorted(motion.bounds, key=lambda own: -own.excess))
    residuals = tuple(sorted(motion.residuals, key=lambda own: -own.part))
    missing = () if status.converged else tuple(own for own in residuals if not own.held)
    hints = [*motion.warnings, *([] if status.converged else _hints(status, bounds))]
    last = passes[-1] if passes else {}
    hints += [f"pass {own['pass']}: {own[LIMITED]}" for own in passes if LIMITED in own]
    if status.converged and not last.get("converged", True):
        failed = f"pass {last.get('pass')} did not converge ({last.get('status')})"
        hints.append(f"{failed}: this is the motion of the pass before it")
    terms = dict(sorted(motion.terms.items(), key=lambda item: -item[1]))
    stopped = sentence_of(status, motion.bounds)
    return Explanation(status, stopped, bounds, missing, terms, motion.weight, tuple(hints))


def _hints(status: Status, bounds: tuple[Bound, ...]) -> list[str]:
    """What may help where a solve did not converge."""
    said = [HELP[status]] if status in HELP else []
    if any(not own.held for own in bounds):
        said.append(
            "octo.explain(problem, solution) looks for constraints that contradict each other"
        )
    return said


def listed(words: list[str]) -> str:
    """a; a and b; a, b and c."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
