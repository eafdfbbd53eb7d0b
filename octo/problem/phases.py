"""Describe: problems one after the other, each of which begins where the one before ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from octo.checks import Array, asked, whole
from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.errors import ProblemError, ValueRangeError, said
from octo.model.character import Character
from octo.problem.basis import Basis, Nodes
from octo.problem.continued import BEFORE, Continued
from octo.problem.lists import sized
from octo.problem.problem import Problem
from octo.problem.step_pairs import refuse_step_pairs
from octo.problem.structure import says_equal
from octo.shown import listed

STARTS, ENDS = ("x0", "v0", "pose"), ("x_end", "v_end", "displacement")


@asked
def phases(problems: Sequence[Problem]) -> Phases:
    """Join problems in time: each begins in the state in which the one before ends, and all are
    solved as one.

    Phases may differ in dt, steps, terms, constraints, ground, contact law and parameters. E is the
    mean of the phases' E over time: each counts with its share of the whole duration, but for
    ``octo.Duration``, which counts as it is. A phase with a ``duration`` finds its own; its share
    stays that of the dt it was given.

    Parameters
    ----------
    problems: the phases in their order, all of one robot and in the nodes basis. The first one
        alone may have ``x0``, ``v0`` or ``pose``, the last one alone ``x_end``, ``v_end`` or
        ``displacement``. Terms that look at the start see that of the first phase.

    Returns
    -------
    What :func:`octo.solve` takes in place of a problem.

    Raises
    ------
    ProblemError, ValueRangeError: naming the phase, counted from 0, and what is not allowed.
    """
    if isinstance(problems, Problem) or not isinstance(problems, (list, tuple)):
        raise ProblemError(f"phases is {said(problems)}, must be a list of octo.Problem objects")
    if not problems:
        raise ValueRangeError("the list of phases is empty: give at least one octo.Problem")
    for k, problem in enumerate(problems):
        if not isinstance(problem, Problem):
            raise ProblemError(f"phase {k} is {said(problem)}, must be an octo.Problem")
        _check(problem, k, len(problems))
        if k:
            _check_robot(problems[0], problem, k)
    first = problems[0]
    durations = np.array([one.steps * one.dt for one in problems])
    own = _linked([first, *(_sized(problem, first) for problem in problems[1:])])
    return Phases(own, durations / durations.sum())


@dataclass(frozen=True, eq=False, repr=False)
class Phases:
    """Problems one after the other that are solved as one: what :func:`phases` makes.

    Attributes
    ----------
    problems: the phases; all but the first have x_{-1} and x_0 among their unknowns.
    shares: (phases,) what E of each counts with.
    """

    problems: tuple[Problem, ...]
    shares: Array

    def __repr__(self) -> str:
        who = self.problems[0].character
        dynamics = self.problems[0].dynamics
        name = dynamics.name if who is None else who.name
        if who is None and dynamics.names is None:
            name = "the user's dynamics"
        title = (
            f"{len(self.problems)} phases of {name}: {self.steps} steps in {self.times[-1]:.6g} s"
        )
        lines = [title]
        for k, problem in enumerate(self.problems):
            what = f"terms in phase {k}, {problem.steps} steps of {problem.dt:.6g} s"
            names = [term.label for term in (*problem.costs, *problem.constraints)]
            lines.append(listed(what, names))
        return "\n".join(lines)

    def replace(self, phase: int, **changes: Any) -> Phases:
        """The same with other fields of one phase, as :meth:`Problem.replace` has them; what E of
        each phase counts with follows from its new duration.

        Parameters
        ----------
        phase: which one, from 0; from the end where it is negative.

        Raises
        ------
        OctoError: there is no such phase or field, or the phases do not go together any more.
        """
        count = len(self.problems)
        at = whole("phase", phase, least=-count, most=count - 1) % count
        # as they were given: the basis of the later ones is what joins them
        first, *later = self.problems
        given = [first, *(one.replace(basis=Nodes()) for one in later)]
        given[at] = given[at].replace(**changes)
        return phases(given)

    def with_numbers(self, problems: Sequence[Problem]) -> Phases:
        """The same phases with other numbers; E of each counts as before."""
        return Phases(_linked(problems), self.shares)

    def with_parameters(self, parameters: Sequence[dict[str, float]]) -> Phases:
        """The same with other run-time parameters of the dynamics in each phase; nothing is
        compiled anew. parameters: of each phase, by name; the others stay."""
        pairs = zip(self.problems, parameters, strict=True)
        return self.with_numbers(
            [one.replace(parameters=own) if own else one for one, own in pairs]
        )

    def without_end(self) -> Phases:
        """The same with a free last state."""
        *others, last = self.problems
        free = last.replace(x_end=None, v_end=None, displacement=None)
        return self.with_numbers([*others, free])

    @property
    def steps(self) -> int:
        return sum(int(problem.steps) for problem in self.problems)

    @cached_property
    def first_steps(self) -> tuple[int, ...]:
        """The step with which each phase begins, counted over all, and behind them N."""
        return tuple(int(k) for k in np.cumsum([0, *(one.steps for one in self.problems)]))

    @cached_property
    def intervals(self) -> Array:
        """(N,) s, of each step."""
        return np.concatenate([np.full(int(one.steps), float(one.dt)) for one in self.problems])

    @property
    def times(self) -> Array:
        """(N+1,) s, of x_0 … x_N."""
        return np.append(0.0, np.cumsum(self.intervals))

    # -- as of one problem: what all phases share, or the first one has ----------------------------

    @property
    def dt(self) -> float:
        """s, of the first phase: what x_{-1} is behind x_0."""
        return self.problems[0].dt

    @property
    def start(self) -> Array:
        return self.problems[0].start

    @property
    def start_velocity(self) -> Array:
        return self.problems[0].start_velocity

    @property
    def dynamics(self) -> Dynamics:
        """That of the first phase; the others may have another ground and contact law."""
        return self.problems[0].dynamics

    @property
    def character(self) -> Character | None:
        return self.problems[0].character

    @property
    def weight(self) -> float:
        return self.problems[0].weight

    @property
    def basis_object(self) -> Basis:
        return Nodes()

    @property
    def closure(self) -> None:
        """None: phases are no cycle."""
        return None

    @property
    def cycle(self) -> None:
        return None

    @property
    def duration(self) -> tuple[tuple[float, float] | None, ...] | None:
        """Of each phase the range of its duration where that is free; None where all are fixed."""
        own = tuple(one.duration for one in self.problems)
        return own if any(own) else None


# what octo.solve solves
Described = Problem | Phases


def times_of(described: Described) -> Array:
    """(N+1,) s, of x_0 … x_N."""
    if isinstance(described, Phases):
        return described.times
    return np.asarray(described.dt * np.arange(described.steps + 1), dtype=float)


def _check(problem: Problem, k: int, count: int) -> None:
    """Refuse what phase k of ``count`` cannot have."""
    if problem.cycle is not None:
        raise ProblemError(f"phase {k} is a cycle: a phase begins and ends, leave out cycle=")
    if problem.basis_object != Nodes():
        refuse_step_pairs(problem.terms, f"phase {k}")
        name = problem.basis_object.name
        raise ProblemError(f"the basis of phase {k} is {name!r}, must be 'nodes'")
    if k == 0 and count > 1 and problem.steps < BEFORE:
        raise ProblemError(f"phase 0 has {problem.steps} step, must have at least {BEFORE}")
    for names, allowed, where in (
        (STARTS, k == 0, f"it begins where phase {k - 1} ends"),
        (ENDS, k == count - 1, f"it ends where phase {k + 1} begins"),
    ):
        for name in names:
            if getattr(problem, name) is not None and not allowed:
                raise ProblemError(f"{name} is given for phase {k}: {where}, leave it out")


def _check_robot(first: Problem, other: Problem, k: int) -> None:
    """Refuse phases whose states are not of the same coordinates."""
    pairs = [(_coordinates(one.dynamics, one.character)) for one in (first, other)]
    if pairs[0] != pairs[1]:
        names = [
            f"{one.dynamics.nx} coordinates of the user's dynamics"
            if one.character is None
            else one.character.name
            for one in (first, other)
        ]
        raise ProblemError(
            f"phase {k} is of {names[1]}, must be of the robot of phase 0, {names[0]}, with the "
            "same coordinates, motors and mass"
        )


def _coordinates(dynamics: Dynamics, robot: Character | None) -> tuple[Any, ...]:
    """What must be alike of two phases."""
    motors = tuple(int(j) for j in dynamics.actuated)
    if robot is None:
        return dynamics.nx, motors, dynamics.name, dynamics.weight
    joints = tuple((joint.name, joint.kind) for joint in robot.joints)
    return dynamics.nx, motors, joints, robot.mass, robot.terrain_contacts


def _sized(problem: Problem, first: Problem) -> Problem:
    """A later phase with the terms of lists that take a length anew: that of the first one's start,
    and no time to get going."""
    given = problem.__dict__.get("unsized", ())
    if not given:
        return problem
    return problem.replace(costs=sized(given, first.length, np.full(1, np.inf)))


def _linked(problems: Sequence[Problem]) -> tuple[Problem, ...]:
    """Phases that begin with the state before them, all of which know the first one's start."""
    first, made = problems[0], [problems[0]]
    for problem in problems[1:]:
        later = problem.replace(basis=Continued())
        later.__dict__["start"] = first.start
        alike = (one.dynamics for one in made if _same_world(one.dynamics, later.dynamics))
        later.__dict__["dynamics"] = next(alike, later.dynamics)  # generated code is made once
        made.append(later)
    return tuple(made)


def _same_world(one: Dynamics, other: Dynamics) -> bool:
    """Whether two phases move the same robot on the same ground by the same law."""
    if not isinstance(one, RobotDynamics) or not isinstance(other, RobotDynamics):
        return one is other
    same_ground = says_equal(one.law, other.law) and says_equal(one.terrain, other.terrain)
    return one.character is other.character and same_ground
