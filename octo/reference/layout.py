"""Where the numbers of the blocks stand in x, in g and in the compressed columns of their
derivatives.

One layout serves IPOPT (x is octo's unknowns), another fatrop (a stage's variables are its state
(x_i, x_{i−1}) and its control x_{i+1}, tied together by linear rows). Nonzeros are those of the
steps' own patterns, not of whole blocks: a sparse factorisation pays for each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from octo.checks import Array
from octo.problem.compiled import CompiledProblem
from octo.reference.patterns import pair_rows, patterns
from octo.reference.program import free_places, live_places, node_matrix, node_variables
from octo.reference.rows import Slopes, given_rows, steps_rows

Indices = NDArray[np.intp]
Entries = tuple[Indices, Indices, Indices]  # rows, columns, and where the numbers stand
NODES = 3  # x_next, x, x_prev of a step


@dataclass(frozen=True, eq=False)
class Layout:
    """Index tables of adapter.c.

    Attributes
    ----------
    place (variables,): of each number of x among the unknowns and in b. row_place (rows,): of each
        of g in C and, from ``tested`` on, among the bounded rows (N, rows); -1 where none.
    node_variable, node_value (nodes, slots): first of the n numbers of x that a node is made of,
        -1 where none, and what they are multiplied with.
    hessian, jacobian: sparsities as CasADi's C interface wants them; hessian_index, jacobian_index:
        place of every nonzero in H, or in A and behind it in ``slopes``, -1 where it is that of
        ``jacobian_constant``.
    linear: rows, columns, values of the constant part of g's Jacobian. slopes: of bounded rows.
    stagewise: for fatrop: no constants in the nodes, the whole symmetric Hessian.
    """

    place: Indices
    row_place: Indices
    node_variable: Indices
    node_value: Array
    hessian: NDArray[np.int64]
    hessian_index: Indices
    jacobian: NDArray[np.int64]
    jacobian_index: Indices
    jacobian_constant: Array
    linear: tuple[Indices, Indices, Array]
    slopes: Slopes
    tested: int
    stagewise: bool

    @property
    def bounded_place(self) -> Indices:
        """(rows,) of each of g among the bounded rows (N, rows), -1 where none."""
        return np.where(self.row_place >= self.tested, self.row_place - self.tested, -1)

    @property
    def of_c(self) -> NDArray[np.bool_]:
        """(rows,) those of g that are in C."""
        return (self.row_place >= 0) & (self.row_place < self.tested)

    @property
    def variables(self) -> int:
        return len(self.place)

    @property
    def rows(self) -> int:
        return len(self.row_place)


def octo_layout(compiled: CompiledProblem) -> Layout:
    """x is octo's unknowns without those that nothing moves, g is C without the rows that are 0 =
    0, and the bounded rows."""
    c, place, row_place = compiled, free_places(compiled), live_places(compiled)
    node_variable = node_variables(c)
    first, second = _octo_patterns(c, place, row_place, node_variable)
    i, j = (a[first.row <= first.col] for a in (first.row, first.col))
    units, own = np.divmod(place, c.nc)
    newer, older = np.where(units[i] >= units[j], (i, j), (j, i))
    block = 3 * units[newer] + units[newer] - units[older]
    hessian = i, j, (block * c.nc + own[newer]) * c.nc + own[older]
    i, j = second.row, second.col
    row_units, row = np.divmod(row_place, max(c.ma, 1))
    block = 3 * row_units[i] + row_units[i] - units[j]
    jacobian = i, j, (block * c.ma + row[i]) * c.nc + own[j]
    slopes = Slopes.of(c, made_of(c), steps_rows(c.steps, c.n))
    tested, behind = c.K * c.ma, len(row_place) + slopes.row
    jacobian = _joined(jacobian, (behind, slopes.column), 3 * tested * c.nc)
    row_place = np.concatenate([row_place, tested + given_rows(c)])
    none = np.zeros(0, dtype=np.intp)
    nodes = node_variable, c.stencil.coefficient
    linear = none, none, np.zeros(0)
    return _layout(place, row_place, nodes, hessian, jacobian, linear, slopes, tested)


def stage_layout(compiled: CompiledProblem) -> Layout:
    """Stage i: x_i, x_{i−1}, x_{i+1}; then rows s_{i+1} − (x_{i+1}, x_i) = 0, then U_/FD_i = 0,
    then its bounded rows."""
    n, m, steps = compiled.n, compiled.m, compiled.steps
    size, step = NODES * n, np.arange(steps)
    given = given_rows(compiled)
    counts = rows_of_stages(compiled) - m
    before = np.cumsum(counts) - counts  # bounded rows of the stages before
    first = (2 * n + m) * step + before
    test = first + 2 * n
    test[-1] = first[-1]  # nothing follows the last stage
    gap = (first[:-1, None] + np.arange(2 * n)).ravel()
    following = (size * step[1:, None] + np.arange(2 * n)).ravel()
    source = (size * step[:-1, None] + np.r_[2 * n : size, 0:n]).ravel()
    values = np.repeat([1.0, -1.0], len(gap))
    linear = np.concatenate([gap, gap]), np.concatenate([following, source]), values
    own = np.r_[n:size, 0:n]  # a stage's variables among x_next, x, x_prev
    behind = np.repeat(test + m - before, counts) + np.arange(len(given))
    row_place = np.full(int(test[-1] + m + counts[-1]), -1)
    row_place[(test[:, None] + np.arange(m)).ravel()] = np.arange(steps * m)
    row_place[behind] = steps * m + given
    model, slope = patterns(compiled)
    slope = slope[compiled.dynamics.unactuated]
    of, i, j = np.nonzero(np.broadcast_to(model[np.ix_(own, own)], (steps, size, size)))
    upper, lower = np.sort([own[i], own[j]], axis=0)
    hessian = of * size + i, of * size + j, (of * size + upper) * size + lower
    of, i, j = np.nonzero(np.broadcast_to(slope[:, own], (steps, m, size)))
    jacobian = test[of] + i, of * size + j, (of * m + i) * size + own[j]
    nodes = size * step[:, None] + n * np.array([2, 0, 1])  # of x_next, x, x_prev
    apart = sparse.csr_array(sparse.eye(size * steps))
    slopes = Slopes.of(compiled, apart, (nodes[:, :, None] + np.arange(n)).reshape(steps, size))
    jacobian = _joined(jacobian, (behind[slopes.row], slopes.column), steps * m * size)
    return _layout(
        (size * step[:, None] + own).ravel(),
        row_place,
        (nodes.reshape(-1, 1), np.ones((nodes.size, 1))),
        hessian,
        jacobian,
        linear,
        slopes,
        steps * m,
        stagewise=True,
    )


def rows_of_stages(compiled: CompiledProblem) -> Indices:
    """(N,) rows of a stage that are no gap."""
    step = given_rows(compiled) // max(len(compiled.functions.bounded), 1)
    return compiled.m + np.bincount(step, minlength=compiled.steps)


def made_of(compiled: CompiledProblem) -> sparse.csr_array:
    """((N+2)·n, x) what the nodes are made of."""
    own = node_matrix(compiled)
    places = own.row(), own.sparsity().get_col()
    return sparse.csr_array((own.nonzeros(), places), own.shape)


def _joined(entries: Entries, more: tuple[Indices, Indices], first: int) -> Entries:
    """With more rows and columns, whose numbers stand from ``first`` on."""
    own = np.concatenate([entries[0], more[0]]), np.concatenate([entries[1], more[1]])
    return *own, np.concatenate([entries[2], first + np.arange(len(more[0]))])


def _octo_patterns(
    c: CompiledProblem, place: Indices, row_place: Indices, node_variable: Indices
) -> tuple[sparse.coo_array, sparse.coo_array]:
    """What may be nonzero in the Hessian and the Jacobian over x: the steps' patterns through the
    stencil, those of terms over neighbours through their controls."""
    width, each = len(place), np.arange(c.n)
    nodes = sum(
        _chosen(np.where(first[:, None] >= 0, first[:, None] + each, -1), width)
        for first in node_variable.T
    )
    if c.carry is not None:
        others = np.eye(c.n * c.steps, dtype=bool)
        nodes = sparse.block_diag([c.carry[0] != 0.0, c.carry[0] != 0.0, others]).tocsr() @ nodes
    windows = nodes.tocsr()[steps_rows(c.steps, c.n).ravel()]
    step, fd = patterns(c)
    own = (step, fd[c.dynamics.unactuated])
    model, slope = (sparse.kron(sparse.eye(c.steps), pattern) for pattern in own)
    hessian = windows.T @ model @ windows
    if c.program.between is not None:
        variable = np.full((c.K + 1) * c.nc, -1)
        variable[c.nc + place] = np.arange(width)  # c_0 is given, unit k is c_{k+1}
        both = np.arange(c.K - 1)[:, None] * c.nc + np.arange(2 * c.nc)
        controls = _chosen(variable[both], width)
        pairs = sparse.kron(sparse.eye(c.K - 1), c.program.between.pattern)
        hessian = hessian + controls.T @ pairs @ controls
    if c.functions.pairs is not None and c.steps > 1:
        rows = pair_rows(c, fd, nodes.tocsr(), windows)
        hessian = hessian + rows.T @ rows
    tests = sparse.kron(c.plan.test_matrix != 0.0, np.eye(c.m)).tocsr()[row_place]
    return sparse.coo_array(hessian), sparse.coo_array(tests @ slope @ windows)


def _chosen(index: Indices, width: int) -> sparse.csr_array:
    """(index.size, width) with a one in column index[row] of each row, none where it is -1."""
    flat = index.ravel()
    rows = np.flatnonzero(flat >= 0)
    return sparse.csr_array((np.ones(len(rows)), (rows, flat[rows])), (len(flat), width))


def _layout(
    place: Indices,
    row_place: Indices,
    nodes: tuple[Indices, Array],
    hessian: Entries,
    jacobian: Entries,
    linear: tuple[Indices, Indices, Array],
    slopes: Slopes,
    tested: int,
    stagewise: bool = False,
) -> Layout:
    """The tables in compressed columns."""
    i, j, at = hessian
    whole, order = _compressed(len(place), len(place), i, j)
    rows, columns, values = linear
    i, j = np.concatenate([jacobian[0], rows]), np.concatenate([jacobian[1], columns])
    index = np.concatenate([jacobian[2], np.full(len(values), -1)])
    constant = np.concatenate([np.zeros(len(jacobian[2])), values])
    compressed, by_column = _compressed(len(row_place), len(place), i, j)
    return Layout(
        place,
        row_place,
        *nodes,
        whole,
        at[order],
        compressed,
        index[by_column],
        constant[by_column],
        linear,
        slopes,
        tested,
        stagewise,
    )


def _compressed(
    height: int, width: int, rows: Indices, columns: Indices
) -> tuple[NDArray[np.int64], Indices]:
    """CasADi's [rows, columns, start of each column, row of each nonzero], and the order of the
    entries in it."""
    order = np.lexsort((rows, columns))
    start = np.searchsorted(columns[order], np.arange(width + 1))
    return np.concatenate([[height, width], start, rows[order]]).astype(np.int64), order
