"""How unknowns make a trajectory (§5.1): a node is a stencil S over control variables.

The unknowns are K *units* v_k of nc numbers. Node j of the trajectory (x_{-1} … x_N, stored at j +
1) is

    x_j = constant_j + Σ_slots coefficient · v_unit[part·n : (part + 1)·n]

and residual i is tested on row block k with the coefficients of its middle node i (C = Σ_i S_iᵀ U_/
FD_i), so that row block k touches the units k, k−1, k−2 only: A is block-lower-triangular with
three blocks a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array, one_of
from octo.errors import ProblemError, said
from octo.problem.splines import hermite_table, tangents_of

WINDOW = 4  # nodes that a step and the one before it look at
LEAST_CYCLE = 4  # steps: with two a residual would see a node twice, and three are no stride


@dataclass(frozen=True, eq=False)
class Stencil:
    """The tables of one basis for N steps: what the assembly, in C or NumPy, works from.

    Attributes
    ----------
    unit: (N+2, slots) unit each slot of a node takes part of, -1 where it takes none.
    part: (N+2, slots) which block of n numbers of that unit.
    coefficient: (N+2, slots).
    test_row, test_part, test_coefficient: (N, tests) the rows a residual is summed into, -1 where
        none.
    """

    units: int
    parts: int
    unit: NDArray[np.int32]
    part: NDArray[np.int32]
    coefficient: Array
    test_row: NDArray[np.int32]
    test_part: NDArray[np.int32]
    test_coefficient: Array


@dataclass(frozen=True)
class Basis:
    """What a trajectory is made of: by default of nodes that are unknowns themselves."""

    name: ClassVar[str] = "nodes"

    @property
    def parts(self) -> int:
        """Blocks of n numbers of a unit."""
        return 1

    def check(self, steps: int) -> None:
        """Refuse a number of steps that it cannot have; by default none."""

    def units(self, steps: int) -> int:
        """K."""
        return -(-steps // self.parts)

    def stencil(self, steps: int) -> Stencil:
        """S and where the residuals are tested."""
        place = np.arange(steps, dtype=np.int32) + -steps % self.parts  # of x_1 … x_N
        unit = np.concatenate([np.full(2, -1, np.int32), place // self.parts])[:, None]
        part = np.concatenate([np.zeros(2, np.int32), place % self.parts])[:, None]
        tests = unit[2:].copy(), part[2:].copy(), np.ones((steps, 1))
        made = unit, part, (unit >= 0).astype(float)
        return Stencil(self.units(steps), self.parts, *made, *tests)

    def dummies(self, steps: int) -> NDArray[np.bool_]:
        """(K, parts) where no node is made of a part of a unit."""
        stencil = self.stencil(steps)
        unused, live = np.ones((stencil.units, stencil.parts), dtype=bool), stencil.unit >= 0
        unused[stencil.unit[live], stencil.part[live]] = False
        return unused

    def idle(self, steps: int) -> list[tuple[int, int]]:
        """(unit, part) that are no nodes, but for a unit that is none at all."""
        unused = self.dummies(steps)
        unused[unused.all(axis=1)] = False
        return [(int(unit), int(part)) for unit, part in np.argwhere(unused)]

    def constant(self, steps: int, x0: Array, x_previous: Array) -> Array:
        """(…, N+2, n) the part of the trajectory that no unknown moves; of a cycle what carries x_N
        and x_{N−1} back by a stride, beside the matrix that it is done with."""
        constant = np.zeros((*x0.shape[:-1], steps + 2, x0.shape[-1]))
        constant[..., 0, :] = x_previous
        constant[..., 1, :] = x0
        return constant

    def fit(self, nodes: Array) -> Array:
        """(…, K, nc) the unknowns of a trajectory (…, N+2, n)."""
        *batch, count, n = nodes.shape
        s = self.stencil(count - 2)
        unknowns = np.zeros((*batch, s.units, s.parts, n))
        unknowns[..., s.unit[2:, 0], s.part[2:, 0], :] = nodes[..., 2:, :]
        return unknowns.reshape(*batch, s.units, s.parts * n)

    def fixed_end(self, steps: int, x_end: Array, v_end: Array, dt: float) -> dict[int, Array]:
        """Units that a fixed last state (x_N, v_N) pins, with their values."""
        if steps < 3:
            raise ProblemError(
                f"steps is {steps}: a fixed end state needs at least 3 steps in the nodes basis"
            )
        return {steps - 1: x_end, steps - 2: x_end - dt * v_end}


@dataclass(frozen=True)
class Nodes(Basis):
    """Every x_1 … x_N is an unknown (S is the identity); pairs of steps give SBT(2(2n−|u|))."""


@dataclass(frozen=True)
class PairedNodes(Basis):
    """The nodes of problems with terms over two steps in a row: two neighbouring nodes a unit.

    Such a term looks at four nodes, x_{i−2} … x_{i+1}: they lie in three neighbouring units at
    most, so that H keeps its pattern. FD_i stands in the rows of its newest node x_{i+1}. Of an odd
    number of steps the first half of the first unit is no node, so that the last unit always holds
    x_{N−1} and x_N, which a fixed end pins together.
    """

    @property
    def parts(self) -> int:
        return 2

    def fixed_end(self, steps: int, x_end: Array, v_end: Array, dt: float) -> dict[int, Array]:
        pinned = super().fixed_end(steps, x_end, v_end, dt)
        both = np.concatenate([pinned[steps - 2], pinned[steps - 1]], axis=-1)
        return {self.units(steps) - 1: both}


@dataclass(frozen=True)
class Hermite(Basis):
    """Cubic Hermite segments: control c_k = (x_k, τ ẋ_k), τ = q·dt; pairs of controls give
    SBT(4(2n−|u|)).

    Unit k is c_{k+1}; c_0 is given by (x_0, v_0). The last unit is a dummy that carries the test
    row of c_Z.

    Parameters
    ----------
    steps_per_segment: q, two or more; the problem's steps are a multiple of it.
    """

    steps_per_segment: int = 10
    name: ClassVar[str] = "hermite"

    @property
    def parts(self) -> int:
        return 2

    def check(self, steps: int) -> None:
        q = self.steps_per_segment
        if isinstance(q, bool) or not isinstance(q, int) or q < 2:
            raise ProblemError(f"steps_per_segment is {said(q)}, must be at least 2")
        if steps % q:
            near = max(q, q * round(steps / q))
            raise ProblemError(
                f"steps is {steps}, must be a multiple of the Hermite segment of {q} steps (for "
                f"example {near})"
            )

    def units(self, steps: int) -> int:
        return steps // self.steps_per_segment + 1

    def stencil(self, steps: int) -> Stencil:
        segment, coefficient = hermite_table(steps, self.steps_per_segment)
        control = segment[:, None] + np.array([0, 0, 1, 1], dtype=np.int32)
        part = np.tile(np.array([0, 1, 0, 1], dtype=np.int32), (steps + 1, 1))
        live = (coefficient != 0.0) & (control >= 1)
        unit = np.where(live, control - 1, -1).astype(np.int32)
        first = np.full((1, 4), -1, dtype=np.int32)
        tested = coefficient[:steps] != 0.0
        return Stencil(
            self.units(steps),
            2,
            np.concatenate([first, unit]),
            np.concatenate([np.zeros_like(first), part]),
            np.concatenate([np.zeros((1, 4)), np.where(live, coefficient, 0.0)]),
            np.where(tested, control[:steps], -1).astype(np.int32),
            part[:steps].copy(),
            np.where(tested, coefficient[:steps], 0.0),
        )

    def constant(self, steps: int, x0: Array, x_previous: Array) -> Array:
        q = self.steps_per_segment
        _, coefficient = hermite_table(steps, self.steps_per_segment)
        constant = super().constant(steps, x0, x_previous)
        tangent = q * (x0 - x_previous)  # τ v_0
        for j in range(q):
            constant[..., j + 1, :] = coefficient[j, 0] * x0 + coefficient[j, 1] * tangent
        return constant

    def fit(self, nodes: Array) -> Array:
        """Controls through the knots of a trajectory; tangents are those of the spline that it is,
        else central differences."""
        q, x = self.steps_per_segment, nodes[..., 1:, :]
        steps = x.shape[-2] - 1
        controls = np.concatenate([x[..., q::q, :], tangents_of(nodes, q)], axis=-1)
        dummy = np.zeros((*controls.shape[:-2], 1, controls.shape[-1]))
        assert controls.shape[-2] == steps // q
        return np.concatenate([controls, dummy], axis=-2)

    def fixed_end(self, steps: int, x_end: Array, v_end: Array, dt: float) -> dict[int, Array]:
        q = self.steps_per_segment
        if steps < 2 * q:
            raise ProblemError(
                f"steps is {steps}: a fixed end state needs at least {2 * q} steps in the hermite "
                "basis"
            )
        return {steps // q - 1: np.concatenate([x_end, q * dt * v_end], axis=-1)}


@dataclass(frozen=True)
class Folded(Basis):
    """The nodes of a cycle: all of x_1 … x_N are unknown, and x_{-1}, x_0 are x_{N−1}, x_N carried
    back by one stride.

    A chain that closes on itself couples its first units with its last ones. Folded in the middle,
    units k and N−1−k side by side, it is a chain again: each pair touches the two pairs before it
    and no others, so that every solver of open chains, on every device, solves closed ones:
    SBT(4(2n−|u|)) of N/4 blocks. FD_i stands in the rows of the last pair that it looks at: on the
    way out that of x_{i+1}, on the way back that of x_{i−1}. At the fold FD_F, F = ⌈N/2⌉, and of an
    even N FD_{F+1} stand in the rows of a dummy, the last unit. The rows of the first pair stay
    empty; of an odd N half of the pair at the fold is no node, and half of the dummy's rows stay
    empty too.

    Parameters
    ----------
    pairs: that stand in one unit: two where a term looks at four nodes, which then are in three
        neighbouring units.
    """

    pairs: int = 1

    @property
    def parts(self) -> int:
        return 2 * self.pairs

    def check(self, steps: int) -> None:
        if steps < LEAST_CYCLE:
            raise ProblemError(f"steps is {steps}: a cycle needs at least {LEAST_CYCLE} steps")

    def units(self, steps: int) -> int:
        return (steps + 1) // 2 // self.pairs + 1

    def _place(self, pair: NDArray, back: NDArray) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Unit and part of the pairs' halves."""
        unit, part = pair // self.pairs, 2 * (pair % self.pairs) + back
        return unit.astype(np.int32), part.astype(np.int32)

    def stencil(self, steps: int) -> Stencil:
        k = np.arange(steps)
        back = k >= (steps + 1) // 2
        places = self._place(np.where(back, steps - 1 - k, k), back)  # of x_1 … x_N
        unit, part = (place[np.arange(-2, steps) % steps][:, None] for place in places)
        back = k > (steps + 1) // 2
        row = np.where(back, steps + 1 - k, k)
        row[0], back[0] = 1, True  # FD_0 looks at x_1, x_N and x_{N−1}
        ones, (row, row_part) = np.ones((steps + 2, 1)), self._place(row, back)
        tests = row[:, None], row_part[:, None]
        made = unit, part, ones
        return Stencil(self.units(steps), self.parts, *made, *tests, np.ones((steps, 1)))

    def fixed_end(self, steps: int, x_end: Array, v_end: Array, dt: float) -> dict[int, Array]:
        raise ProblemError("a cycle has no end to fix: x_end cannot be given with cycle")


def basis_named(name: str | Basis) -> Basis:
    """The basis a user named: "nodes", "hermite", or one of the two objects."""
    if isinstance(name, Basis):
        return name
    table: dict[str, Basis] = {"nodes": Nodes(), "hermite": Hermite()}
    return table[one_of("basis", name, table)]


def node_values(
    stencil: Stencil, unknowns: Array, constant: Array, carry: Array | None = None
) -> Array:
    """x_{-1} … x_N (…, N+2, n) of unknowns (…, K, nc): T_x = (S ⊗ I) T_c, of the first parts·n
    numbers of each unit.

    carry (…, n, n): of a cycle, what the unknowns in x_{-1} and x_0 are multiplied with.
    """
    n = constant.shape[-1]
    nodal = unknowns[..., : stencil.parts * n]
    split = nodal.reshape(*unknowns.shape[:-1], stencil.parts, n)
    nodes = constant.copy()
    for s in range(stencil.unit.shape[1]):
        live = np.flatnonzero(stencil.unit[:, s] >= 0)
        values = split[..., stencil.unit[live, s], stencil.part[live, s], :]
        nodes[..., live, :] += stencil.coefficient[live, s, None] * values
    if carry is not None:
        first = nodes[..., :2, :] - constant[..., :2, :]
        nodes[..., :2, :] = constant[..., :2, :] + first @ np.swapaxes(carry, -1, -2)
    return nodes


def node_forces(stencil: Stencil, forces: Array, nc: int, carry: Array | None = None) -> Array:
    """The transpose of ``node_values`` without its constant: what ``forces`` (batch, N+2, n) on the
    nodes are on the unknowns (batch, K, nc)."""
    batch, _, n = forces.shape
    if carry is not None:
        forces = forces.copy()
        forces[:, :2] = forces[:, :2] @ carry
    split = np.zeros((stencil.units, stencil.parts, batch, n))
    for s in range(stencil.unit.shape[1]):
        live = np.flatnonzero(stencil.unit[:, s] >= 0)
        own = stencil.coefficient[live, s, None] * forces[:, live]
        np.add.at(split, (stencil.unit[live, s], stencil.part[live, s]), np.swapaxes(own, 0, 1))
    out = np.zeros((batch, stencil.units, nc))
    nodal = split.transpose(2, 0, 1, 3).reshape(batch, stencil.units, -1)
    out[..., : nodal.shape[-1]] = nodal
    return out


# a node of a window, the unit it is made of, the part of that unit, and the coefficient
Slot = tuple[int, int, int, float]


def slots_of(stencil: Stencil, step: int, nodes: int = 3) -> list[Slot]:
    """What the nodes x_{i+1}, x_i, x_{i−1} of a step, or more of them, are made of; of a cycle
    x_{−2} is made of what x_{N−2} is."""
    s, places = stencil, [step + 2 - node for node in range(nodes)]
    return [
        (node, int(s.unit[at, k]), int(s.part[at, k]), float(s.coefficient[at, k]))
        for node, at in enumerate(at if at >= 0 else len(s.unit) - 3 for at in places)
        for k in np.flatnonzero(s.unit[at] >= 0)
    ]


def block(k: int, n: int) -> slice:
    """The k-th n numbers of a unit, or of a window of nodes."""
    return slice(k * n, (k + 1) * n)


def scatter(
    slots: Sequence[Slot], n: int, hess: Array, gradient: Array, H: Array, b: Array
) -> None:
    """Adds what a window of nodes has, (batch, w, w) and (batch, w), to H (batch, K, 3, nc, nc) and
    b (batch, K, nc) of the units that it is made of, ``n`` numbers a part."""
    for node, unit, part, value in slots:
        own, to = block(node, n), block(part, n)
        b[:, unit, to] += value * gradient[:, own]
        for other, unit2, part2, value2 in slots:
            if unit2 <= unit:
                made = value * value2 * hess[:, own, block(other, n)]
                H[:, unit, unit - unit2, to, block(part2, n)] += made
