"""Where the numbers of a step go: variables in blocks of n, rows in blocks of m, nonzeros in
compressed columns.

One layout serves IPOPT (x is octo's unknowns), another fatrop (a stage's variables are its state
(x_i, x_{i−1}) and its control x_{i+1}, tied together by linear rows).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from octo.problem.compiled import CompiledProblem
from octo.reference.program import free_blocks, live_rows

Array = NDArray[np.float64]
Integers = NDArray[np.int32]
NODES = 3  # x_next, x, x_prev of a step


@dataclass(frozen=True, eq=False)
class Layout:
    """How each step's three nodes are made of blocks of x, and which rows of g it adds to.

    Attributes
    ----------
    blocks: how many blocks of n numbers x has. rows: length of g.
    local (N, L): the blocks that a step reads, -1 where fewer. weight (N, 3, L): what each adds to
        the three nodes.
    test_row (N, T): first of the m rows that FD's unactuated rows are summed into, -1 where none.
        test_value (N, T).
    linear: rows, columns, values of the constant part of g's Jacobian.
    carry (n, n): of a cycle, what the blocks in x_{-1} and x_0 are multiplied with.
    stagewise: for fatrop: no constants in the nodes, the whole symmetric Hessian.
    """

    blocks: int
    rows: int
    local: Integers
    weight: Array
    test_row: Integers
    test_value: Array
    stagewise: bool = False
    linear: tuple[Integers, Integers, Array] = field(
        default_factory=lambda: (np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0))
    )
    carry: Array | None = None


def octo_layout(compiled: CompiledProblem) -> Layout:
    """x is octo's unknowns without the dummies, g is C without the rows that are 0 = 0."""
    s, parts, steps = compiled.stencil, compiled.stencil.parts, compiled.steps
    blocks, live = free_blocks(compiled), live_rows(compiled)
    place, row_place = (np.full(compiled.K * parts, -1) for _ in range(2))
    place[blocks], row_place[live] = np.arange(len(blocks)), np.arange(len(live))
    rows: list[dict[int, Array]] = []
    for i in range(steps):
        table: dict[int, Array] = {}
        for node in range(NODES):
            for slot in np.flatnonzero(s.unit[i + 2 - node] >= 0):
                block = int(place[s.unit[i + 2 - node, slot] * parts + s.part[i + 2 - node, slot]])
                table.setdefault(block, np.zeros(NODES))[node] += s.coefficient[i + 2 - node, slot]
        rows.append(dict(sorted(table.items())))
    width = max(1, *(len(table) for table in rows))
    local, weight = np.full((steps, width), -1, dtype=np.int32), np.zeros((steps, NODES, width))
    for i, table in enumerate(rows):
        for k, (block, value) in enumerate(table.items()):
            local[i, k], weight[i, :, k] = block, value
    test_row = np.where(
        s.test_row >= 0, compiled.m * row_place[s.test_row * parts + s.test_part], -1
    )
    return Layout(
        len(blocks),
        compiled.m * len(live),
        local,
        weight,
        test_row.astype(np.int32),
        np.ascontiguousarray(s.test_coefficient),
        carry=None if compiled.carry is None else compiled.carry[0],
    )


def stage_layout(compiled: CompiledProblem) -> Layout:
    """Stage i: x_i, x_{i−1}, x_{i+1}; then rows s_{i+1} − (x_{i+1}, x_i) = 0, then U_/FD_i = 0."""
    n, m, steps = compiled.n, compiled.m, compiled.steps
    # blocks of x_next, x, x_prev
    local = (3 * np.arange(steps)[:, None] + np.array([2, 0, 1])).astype(np.int32)
    first = (2 * n + m) * np.arange(steps)
    test = first + 2 * n
    test[-1] = first[-1]  # nothing follows the last stage
    gap = (first[:-1, None] + np.arange(2 * n)).ravel()
    following = (3 * n * np.arange(1, steps)[:, None] + np.arange(2 * n)).ravel()
    source = (3 * n * np.arange(steps - 1)[:, None] + np.r_[2 * n : 3 * n, 0:n]).ravel()
    linear = (
        np.concatenate([gap, gap]).astype(np.int32),
        np.concatenate([following, source]).astype(np.int32),
        np.concatenate([np.ones(len(gap)), -np.ones(len(gap))]),
    )
    weight = np.ascontiguousarray(np.broadcast_to(np.eye(NODES), (steps, NODES, NODES)))
    rows = int(first[-1]) + m
    return Layout(
        3 * steps,
        rows,
        local,
        weight,
        test[:, None].astype(np.int32),
        np.ones((steps, 1)),
        True,
        linear,
    )


@dataclass(frozen=True, eq=False)
class Places:
    """Blocks that steps add into, and the nonzeros that are read from them.

    ``pair`` (N, L, L) and ``test`` (N, T, L) are the numbers of the (n, n) and (m, n) blocks, -1
    where none; ``hessian`` and ``jacobian`` are sparsities as CasADi's C interface wants them, with
    the place of every nonzero.
    """

    pair: Integers
    pairs: int
    test: Integers
    tests: int
    hessian: NDArray[np.int64]
    hessian_index: Integers
    jacobian: NDArray[np.int64]
    jacobian_index: Integers
    jacobian_constant: Array


def places(
    layout: Layout, n: int, hessian: NDArray[np.bool_], jacobian: NDArray[np.bool_]
) -> Places:
    """From the pattern of one step, (3n, 3n) and (m, 3n), to that of all of them."""
    pair, pair_blocks, pair_masks = _pairs(layout, n, hessian)
    test, test_blocks, test_masks = _tests(layout, n, jacobian)
    size = layout.blocks * n
    which, i, j = np.nonzero(pair_masks)
    rows, columns = pair_blocks[which, 0] * n + i, pair_blocks[which, 1] * n + j
    index = (which * n + i) * n + j
    keep = rows <= columns
    rows, columns, index = rows[keep], columns[keep], index[keep]
    if layout.stagewise:
        below = rows < columns
        rows, columns = (
            np.concatenate([rows, columns[below]]),
            np.concatenate([columns, rows[below]]),
        )
        index = np.concatenate([index, index[below]])
    hessian_sparsity, order = _compressed(size, size, rows, columns)
    hessian_index = index[order].astype(np.int32)
    m = jacobian.shape[0]
    which, i, j = np.nonzero(test_masks)
    lin_rows, lin_columns, values = layout.linear
    rows = np.concatenate([test_blocks[which, 0] + i, lin_rows])
    columns = np.concatenate([test_blocks[which, 1] * n + j, lin_columns])
    index = np.concatenate([(which * m + i) * n + j, np.full(len(values), -1)])
    constant = np.concatenate([np.zeros(len(which)), values])
    jacobian_sparsity, order = _compressed(layout.rows, size, rows, columns)
    return Places(
        pair,
        len(pair_blocks),
        test,
        len(test_blocks),
        hessian_sparsity,
        hessian_index,
        jacobian_sparsity,
        index[order].astype(np.int32),
        constant[order],
    )


def _carried(layout: Layout, n: int, i: int) -> NDArray[np.bool_]:
    """(3n, 3n) pattern of what step ``i``'s nodes have of the blocks that they are made of."""
    chain = np.eye(NODES * n, dtype=bool)
    if layout.carry is not None:
        for node in range(i + 1, NODES):
            own = slice(node * n, (node + 1) * n)
            chain[own, own] = layout.carry != 0.0
    return chain


def _pairs(
    layout: Layout, n: int, pattern: NDArray[np.bool_]
) -> tuple[Integers, NDArray[np.intp], NDArray[np.bool_]]:
    """Number of the block of each pair of local blocks; rows and columns of the blocks (count, 2);
    their patterns."""
    steps, width = layout.local.shape
    place = np.full((steps, width, width), -1, dtype=np.int32)
    numbers: dict[tuple[int, int], int] = {}
    masks: list[NDArray[np.bool_]] = []
    seen: dict[bytes, NDArray[np.bool_]] = {}
    for i in range(steps):
        live, chain = layout.weight[i] != 0.0, _carried(layout, n, i)
        key = live.tobytes() + chain.tobytes()
        if key not in seen:
            four = (chain.T @ pattern @ chain).reshape(NODES, n, NODES, n).transpose(0, 2, 1, 3)
            seen[key] = np.einsum("sa,tb,stij->abij", live, live, four, dtype=bool)
        for a, b in np.ndindex(width, width):
            first, second = int(layout.local[i, a]), int(layout.local[i, b])
            if first < 0 or second < 0 or first > second or not seen[key][a, b].any():
                continue
            k = numbers.setdefault((first, second), len(numbers))
            place[i, a, b] = k
            if k == len(masks):
                masks.append(seen[key][a, b].copy())
            else:
                masks[k] |= seen[key][a, b]
    return (
        place,
        np.array(list(numbers), dtype=np.intp).reshape(-1, 2),
        np.array(masks, dtype=bool).reshape(-1, n, n),
    )


def _tests(
    layout: Layout, n: int, pattern: NDArray[np.bool_]
) -> tuple[Integers, NDArray[np.intp], NDArray[np.bool_]]:
    """The same for rows: first row and column block of each block of the Jacobian."""
    m = len(pattern)
    (steps, width), tests = layout.local.shape, layout.test_row.shape[1]
    place = np.full((steps, tests, width), -1, dtype=np.int32)
    numbers: dict[tuple[int, int], int] = {}
    masks: list[NDArray[np.bool_]] = []
    for i in range(steps if m else 0):
        live = layout.weight[i] != 0.0
        three = (pattern @ _carried(layout, n, i)).reshape(m, NODES, n).transpose(1, 0, 2)
        mask = np.einsum("ta,tij->aij", live, three, dtype=bool)
        for k, a in np.ndindex(tests, width):
            row, block = int(layout.test_row[i, k]), int(layout.local[i, a])
            if row < 0 or block < 0 or not mask[a].any():
                continue
            number = numbers.setdefault((row, block), len(numbers))
            place[i, k, a] = number
            if number == len(masks):
                masks.append(mask[a].copy())
            else:
                masks[number] |= mask[a]
    return (
        place,
        np.array(list(numbers), dtype=np.intp).reshape(-1, 2),
        np.array(masks, dtype=bool).reshape(-1, m, n),
    )


def _compressed(
    height: int, width: int, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """CasADi's [rows, columns, start of each column, row of each nonzero], and the order of the
    entries in it."""
    order = np.lexsort((rows, columns))
    start = np.searchsorted(columns[order], np.arange(width + 1))
    return np.concatenate([[height, width], start, rows[order]]).astype(np.int64), order
