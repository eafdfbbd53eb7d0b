"""E, C and their model in native code: assemble.c with the code of one program, over the steps of a
batch."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array, doubles
from octo.problem.data import Data
from octo.problem.evaluation import Blocks, Evaluation
from octo.problem.neighbours import controls_of
from octo.problem.plan import Plan

Kept = list[NDArray]  # arrays that must outlive the addresses that a task holds


class NativeSteps:
    """``evaluate`` and ``linearize`` by a compiled library, on ``threads`` threads."""

    def __init__(self, library: ctypes.CDLL, plan: Plan, data: Data, threads: int):
        self.library, self.plan, self.data, self.threads = library, plan, data, threads
        # terms over neighbouring controls, and over two steps in a row
        self.between = hasattr(library, "octo_between_values")
        self.pairs = hasattr(library, "octo_pair_room")

    def select(self, data: Data) -> NativeSteps:
        """For other numbers."""
        return NativeSteps(self.library, self.plan, data, self.threads)

    def evaluate(
        self, unknowns: Array, nodes: Array, fd: Array, terms: Array, rows: Array, C: Array
    ) -> None:
        """Fills FD (batch, N, n), each step's share of each term (batch, N, terms), the values of
        the bounded rows (batch, N, rows) and C."""
        own = self._own_task()
        task = own[0]
        task.nodes, task.fd = nodes.ctypes.data, fd.ctypes.data
        task.terms, task.rows, task.c = (a.ctypes.data for a in (terms, rows, C))
        if self.library.octo_evaluate(ctypes.byref(task), self.threads):
            raise MemoryError("octo_evaluate could not allocate its work arrays")
        if self.between:
            controls = controls_of(self.plan, self.data, unknowns)
            where = ctypes.c_void_p(controls.ctypes.data)
            self.library.octo_between_values(ctypes.byref(task), where, self.threads)
        self._free_tasks.append(own)

    def linearize(
        self, at: Evaluation, lam: Array | None, curved: NDArray[np.bool_] | None, out: Blocks
    ) -> None:
        """Fills H, if any, A, b, C, and R, if any."""
        batch, steps, n = len(self.data.p), self.plan.steps, self.plan.n
        nodes = doubles("nodes", at.nodes, (batch, steps + 2, n))
        fd = doubles("fd", at.fd, (batch, steps, n))
        own = self._own_task()
        task = own[0]
        task.nodes, task.fd = nodes.ctypes.data, fd.ctypes.data
        task.lam = None if lam is None else lam.ctypes.data
        members = None if curved is None else np.ascontiguousarray(curved, dtype=np.int32)
        task.curved = None if members is None else members.ctypes.data
        task.h, task.a, task.b, task.c, task.kept = (
            None if array is None else array.ctypes.data for array in out
        )
        if self.library.octo_linearize(ctypes.byref(task), self.threads):
            raise MemoryError("octo_linearize could not allocate its work arrays")
        if self.between:
            self._add_between(task, at.unknowns)
        self._free_tasks.append(own)

    def row_products(self, kept: Array, moved: Array, out: Array) -> None:
        """Fills R Δ (batch, N, rows), of R of a model and the step of the nodes."""
        batch, steps, rows = out.shape
        functions = self.library.octo_row_products
        given = doubles("moved", moved, (batch, steps + 2, self.plan.n))
        arrays = (ctypes.c_void_p(array.ctypes.data) for array in (kept, given, out))
        functions(batch, steps, *arrays, self.threads)

    def row_forces(self, kept: Array, weights: Array, out: Array) -> None:
        """Fills Rᵀ w (batch, K, nc), of R of a model and weights (batch, N, rows)."""
        batch, steps = kept.shape[:2]
        window, own = np.empty((batch, steps, 3 * self.plan.n)), self._own_task()
        arrays = (ctypes.c_void_p(array.ctypes.data) for array in (kept, weights, window, out))
        self.library.octo_row_forces(ctypes.byref(own[0]), *arrays, self.threads)
        self._free_tasks.append(own)

    def _add_between(self, task: Task, unknowns: Array) -> None:
        """What the terms over neighbouring controls add to H and b."""
        controls = controls_of(self.plan, self.data, unknowns)
        fixed = self.plan.still.astype(np.int32)
        where = (ctypes.c_void_p(array.ctypes.data) for array in (controls, fixed))
        self.library.octo_between_model(ctypes.byref(task), *where, self.threads)

    @cached_property
    def _free_tasks(self) -> list[tuple[Task, Kept]]:
        """Those that no thread is using: each call has one of its own, for it is where the native
        code writes."""
        return []

    def _own_task(self) -> tuple[Task, Kept]:
        """One for a call, which gives it back to ``_free_tasks``."""
        try:
            return self._free_tasks.pop()
        except IndexError:
            return self.task()

    def task(self) -> tuple[Task, Kept]:
        """One without nodes or results, and what must outlive it."""
        plan, data, s = self.plan, self.data, self.plan.stencil
        chunks = plan.chunks(self.threads)
        size = 6 * plan.nc**2 + 3 * plan.ma * plan.nc + 2 * plan.nc + plan.ma
        halo = np.empty((len(data.p), len(chunks[1]), max(size, 1)))
        stencil = (s.unit, s.part, s.coefficient, s.test_row, s.test_part, s.test_coefficient)
        tables = [np.ascontiguousarray(a) for a in (*chunks, *stencil)]
        values = [np.ascontiguousarray(a) for a in (data.p, data.q, data.row_scale)]
        sizes = (
            len(data.p),
            plan.steps,
            s.units,
            s.unit.shape[1],
            s.test_row.shape[1],
            plan.nc,
            plan.ma,
            len(chunks[1]),
        )
        task = task_of(sizes, tables, values, halo)
        kept = [*tables, *values, halo]
        if self.pairs:
            kept.append(np.empty((len(data.p), plan.steps, self.library.octo_pair_room())))
            task.pairs = kept[-1].ctypes.data
        if data.carry is not None:
            kept.append(np.ascontiguousarray(data.carry))
            task.carry = kept[-1].ctypes.data
        return task, kept


SIZES = ("batch", "steps", "units", "slots", "tests", "nc", "ma", "chunks")
TABLES = (
    *("chunk_step", "chunk_unit", "chunk_row", "slot_unit", "slot_part", "slot_value"),
    *("test_row", "test_part", "test_value"),
)
NUMBERS = ("p", "q", "row_scale")
FIELDS = (
    *(*TABLES, "nodes", *NUMBERS, "fd", "terms", "rows", "lam", "h", "a", "b", "c"),
    *("halo", "carry", "curved", "kept", "pairs"),
)


class Task(ctypes.Structure):
    """octo_task of assemble.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in SIZES),
        *((name, ctypes.c_void_p) for name in FIELDS),
        ("apart", ctypes.c_int),
    ]


def task_of(
    sizes: Sequence[int], tables: Sequence[NDArray], values: Sequence[NDArray], halo: NDArray
) -> Task:
    """octo_task over contiguous arrays that the caller keeps: ``tables`` of the chunks and the
    stencil (TABLES), ``values`` p, q and the scale of the rows."""
    task = Task(*sizes)
    names = (*TABLES, *NUMBERS, "halo")
    for name, array in zip(names, (*tables, *values, halo), strict=True):
        setattr(task, name, array.ctypes.data)
    return task
