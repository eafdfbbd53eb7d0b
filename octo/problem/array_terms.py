"""E and its Gauss–Newton blocks of the terms that are written in arrays (ArrayCost), one code for
both bases: r(c_i, c_{i+1}) looks at three or four blocks of the unknowns, which lie in two or three
neighbouring units, so that H keeps its pattern.

It stands behind what evaluates the steps, native code, CasADi's virtual machine or a device's
kernels: only values of terms, H and b, which lie where the unknowns are, are added to.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, array_module, like
from octo.errors import ProblemError, ShapeError
from octo.problem.array_costs import ArrayCost
from octo.problem.basis import Basis, Hermite, Nodes, PairedNodes
from octo.problem.data import Data
from octo.problem.neighbours import controls_of
from octo.problem.plan import Plan
from octo.problem.problem import Problem

BASES = (Nodes, PairedNodes, Hermite)


@dataclass(frozen=True, eq=False)
class Window:
    """The blocks of n numbers of the unknowns that each transition looks at.

    Attributes
    ----------
    unit, part: (transitions, blocks) where a block stands; unit −1 where nothing moves it.
    chain: (blocks, 4) what a block adds to x, the second half of c, x_next and that of c_next.
    """

    unit: NDArray[np.intp]
    part: NDArray[np.intp]
    chain: Array

    @classmethod
    def of(cls, plan: Plan) -> Window:
        if isinstance(plan.basis, Hermite):
            k = np.arange(plan.K - 1)[:, None]
            unit = k + np.array([-1, -1, 0, 0])
            unit = np.where((unit >= 0) & ~plan.still[unit], unit, -1)
            return cls(unit, np.broadcast_to([0, 1, 0, 1], unit.shape), np.eye(4))
        table, steps = plan.stencil, plan.steps
        # x_{i+1}, x_i, x_{i−1}, each one node, which one unknown is
        rows = np.arange(steps)[:, None] + np.array([2, 1, 0])
        chain = np.array([[0.0, 0.0, 1.0, 1.0], [1.0, 1.0, 0.0, -1.0], [0.0, -1.0, 0.0, 0.0]])
        return cls(table.unit[rows, 0], table.part[rows, 0], chain)

    def pairs(self) -> Iterator[tuple[int, int, NDArray[np.intp], tuple[int, int]]]:
        """Blocks a and b, the transitions of which the unit of b is that of a or before it, and the
        parts that they are, the same for all of these."""
        for a in range(len(self.chain)):
            for b in range(len(self.chain)):
                live = (self.unit[:, b] >= 0) & (self.unit[:, b] <= self.unit[:, a])
                keys = self.part[:, [a, b]]
                for key in np.unique(keys[live], axis=0):
                    where = np.flatnonzero(live & (keys == key).all(axis=1))
                    yield a, b, where, (int(key[0]), int(key[1]))


class ArrayTerms:
    """Of the terms of a batch of problems.

    Parameters
    ----------
    plan, data: of the batch. problems: whose terms these are, one for each member.

    Raises
    ------
    ProblemError: a cycle, a phase, or a free duration, which such terms cannot be part of; or the
        term does not fit a problem.
    """

    def __init__(self, plan: Plan, data: Data, problems: Sequence[Problem]):
        self.plan, self.data, self.problems = plan, data, problems
        self.places = [k for k, t in enumerate(problems[0].terms) if isinstance(t, ArrayCost)]
        checked: set[tuple[int, int]] = set()
        for problem in problems if self.places else ():
            for term in self._own(problem):
                if (id(term), id(problem)) not in checked:
                    _check(term, problem, plan.basis)
                    checked.add((id(term), id(problem)))

    def __bool__(self) -> bool:
        return bool(self.places)

    def _own(self, problem: Problem) -> list[ArrayCost]:
        return [term for term in problem.terms if isinstance(term, ArrayCost)]

    @property
    def labels(self) -> list[str]:
        return [term.label for term in self._own(self.problems[0])]

    @property
    def only_here(self) -> list[str]:
        """The labels of those that take arrays of NumPy alone."""
        return [term.label for term in self._own(self.problems[0]) if not term.anywhere]

    @cached_property
    def _window(self) -> Window:
        return Window.of(self.plan)

    @cached_property
    def _pairs(self) -> list[tuple[int, int, NDArray[np.intp], tuple[int, int]]]:
        return list(self._window.pairs())

    @cached_property
    def _groups(self) -> list[tuple[int, ArrayCost, NDArray[np.intp]]]:
        """Each place among the terms, the term that stands there, and the members that share it."""
        made: dict[tuple[int, int], tuple[ArrayCost, list[int]]] = {}
        for member, problem in enumerate(self.problems):
            for k, term in zip(self.places, self._own(problem), strict=True):
                made.setdefault((k, id(term)), (term, []))[1].append(member)
        return [(k, term, np.array(members)) for (k, _), (term, members) in made.items()]

    def take(self, members: NDArray[np.intp]) -> ArrayTerms:
        """Of some members, by index."""
        made: ArrayTerms = object.__new__(ArrayTerms)
        made.plan, made.data, made.places = self.plan, self.data.select(members), self.places
        made.problems = tuple(self.problems[int(k)] for k in members)
        return made

    def _controls(self, unknowns: Array, nodes: Array) -> Array:
        """(batch, transitions + 1, 2n)."""
        if isinstance(self.plan.basis, Hermite):
            return controls_of(self.plan, self.data, unknowns)
        return array_module(nodes).concatenate(
            [nodes[:, 1:], nodes[:, 1:] - nodes[:, :-1]], axis=-1
        )

    def _all(self, members: NDArray[np.intp], array: Array) -> Array | slice:
        """The members as an index of ``array``."""
        return slice(None) if len(members) == len(self.problems) else like(members, array)

    def _weight(self, k: int) -> Array:
        """(batch, transitions) what |r|² counts with."""
        own = self.data.q[:, :, k]
        return own.reshape(len(own), len(self._window.unit), -1).sum(axis=-1)

    def values(self, unknowns: Array, nodes: Array, terms: Array) -> None:
        """Writes their share of E into ``terms`` (batch, N, terms), at the last step of each
        transition."""
        if not self:
            return
        controls = self._controls(unknowns, nodes)
        length = self.plan.steps // (controls.shape[1] - 1)
        xp = array_module(controls)
        for k, term, members in self._groups:
            at, weight = self._all(members, controls), like(self._weight(k)[members], controls)
            own = controls[at]
            with np.errstate(over="ignore", invalid="ignore"):  # a step too far is not taken
                r = term.value(own[:, :-1], own[:, 1:], self.problems[members[0]].setting)
                _check_shape(term, "value", r, (*weight.shape, r.shape[-1]))
                share = xp.where(weight == 0.0, 0.0, weight * (r**2).sum(axis=-1))
            terms[at, :, k] = 0.0
            terms[at, length - 1 :: length, k] = share

    def add(self, unknowns: Array, nodes: Array, H: Array | None, b: Array) -> None:
        """Adds 2 JᵀJ, where there is an H, and 2 Jᵀr to the blocks."""
        if not self:
            return
        controls, n = self._controls(unknowns, nodes), self.plan.n
        xp, chain = array_module(controls), like(self._window.chain, controls)
        for k, term, members in self._groups:
            own = controls[self._all(members, controls)]
            weight = like(self._weight(k)[members], controls)
            r, slopes = term.slopes(own[:, :-1], own[:, 1:], self.problems[members[0]].setting)
            _check_shape(term, "slopes", slopes, (*weight.shape, r.shape[-1], 4 * n))
            # of the blocks, with the root of twice the weight
            root = xp.sqrt(2.0 * weight)[..., None]
            J = chain @ slopes.reshape(*slopes.shape[:-1], 4, n)
            J = root[..., None] * J.reshape(*r.shape, -1)
            idle = weight[..., None] == 0.0  # they may not be finite there
            J, r = xp.where(idle[..., None], 0.0, J), xp.where(idle, 0.0, root * r)
            self._scatter(J, (r[..., None, :] @ J)[..., 0, :], members, H, b)

    def _scatter(
        self, J: Array, gradient: Array, members: NDArray[np.intp], H: Array | None, b: Array
    ) -> None:
        """Adds JᵀJ and a gradient of the blocks, (members, transitions, …)."""
        n, unit = self.plan.n, self._window.unit
        blocks = [slice(a * n, (a + 1) * n) for a in range(len(self._window.chain))]
        row = like(members[:, None], b)
        square = None if H is None else array_module(J).swapaxes(J, -1, -2) @ J
        for a, c, where, parts in self._pairs:
            own, to = like(where, b), blocks[parts[0]]
            at, lag = like(unit[where, a], b), like(unit[where, a] - unit[where, c], b)
            if a == c:
                b[row, at, to] += gradient[:, own, blocks[a]]
            if H is not None and square is not None:
                over = square[:, own, blocks[a], blocks[c]]
                H[row, at, lag, to, blocks[parts[1]]] += over


def _check(term: ArrayCost, problem: Problem, basis: Basis) -> None:
    """Refuse what such a term cannot be part of."""
    if type(basis) not in BASES:
        what = "a cycle" if problem.cycle is not None else f"the basis {basis.name!r} of phases"
        raise ProblemError(
            f"{term.label} is written in arrays and has no form for {what}: leave it out"
        )
    if problem.duration is not None:
        raise ProblemError(
            f"{term.label} is written in arrays, and duration is free: give steps and dt without it"
        )
    term.check(problem)


def _check_shape(term: ArrayCost, what: str, found: Array, expected: tuple[int, ...]) -> None:
    if found.shape != expected:
        raise ShapeError(f"{term.label}.{what}", found.shape, expected)
