"""E, C and their model for a batch of problems of one structure: native code, or CasADi's virtual
machine and NumPy.

Both give the same arrays: ``evaluate`` the value of every term and residual, ``linearize`` H, A, b,
C of Eq. 9 in the block format of the solver (lag storage: H[:, k, o] couples unit k with unit k −
o).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo import native
from octo.arrays import every, host, like, some
from octo.checks import doubles
from octo.dynamics import symbolic
from octo.dynamics.evaluate import RobotDynamics
from octo.errors import ProblemError
from octo.interrupts import postponed
from octo.problem import codegen
from octo.problem.basis import Folded, Hermite, Stencil, node_values
from octo.problem.costs import NeighbourCost
from octo.problem.neighbours import NeighbourTerms
from octo.problem.problem import Problem
from octo.problem.structure import check_alike, functions_of

Array = NDArray[np.float64]
# what an Evaluation keeps on the host once it was asked for
HOSTED = frozenset(("numbers", "unit_sizes"))
# of a CompiledProblem, by members
BATCHED = ("p", "q", "row_scale", "start", "constant", "ends", "carry")
GROUP = 8  # steps that the dynamics take at a time, at most


@dataclass(eq=False)
class Evaluation:
    """E and C of a batch at one iterate."""

    unknowns: Array  # (batch, K, nc)
    nodes: Array  # (batch, N+2, n)
    fd: Array  # (batch, N, n), N m or N
    terms: Array  # (batch, N, terms), each step's share of each term
    C: Array  # (batch, K, ma), scaled
    summary: Array  # (batch, 4): E, ‖C‖₁, ‖C‖∞, ‖C‖₂²

    @classmethod
    def of(
        cls, unknowns: Array, nodes: Array, fd: Array, terms: Array, energy: Array, C: Array
    ) -> Evaluation:
        """With the summary of E (batch,) and C, in NumPy."""
        size = np.abs(C).reshape(len(C), -1)
        norms = [size.sum(axis=1), size.max(axis=1, initial=0.0), (size**2).sum(axis=1)]
        return cls(unknowns, nodes, fd, terms, C, np.stack([energy, *norms], axis=1))

    @cached_property
    def numbers(self) -> Array:
        """(batch, 4) the summary on the host: one copy of an iterate, whoever asks."""
        return host(self.summary)

    @cached_property
    def unit_sizes(self) -> Array:
        """(batch, K) ‖C‖₁ of each unit, on the host."""
        return host(abs(self.C).sum(axis=2))

    @property
    def energy(self) -> Array:
        """(batch,) E, on the host."""
        return self.numbers[:, 0]

    @property
    def size(self) -> Array:
        """(batch,) ‖C‖₁, on the host."""
        return self.numbers[:, 1]

    @property
    def largest(self) -> Array:
        """(batch,) ‖C‖∞, on the host."""
        return self.numbers[:, 2]

    @property
    def square(self) -> Array:
        """(batch,) ‖C‖₂², on the host."""
        return self.numbers[:, 3]

    @property
    def finite(self) -> NDArray[np.bool_]:
        """(batch,) where E and C are; on the host."""
        return np.isfinite(self.energy + self.size)

    def take(
        self, members: NDArray[Any] | Sequence[int] | Sequence[np.signedinteger[Any]]
    ) -> Evaluation:
        """Some members, by index or by a mask."""
        chosen = like(np.asarray(members), self.C)
        made = Evaluation(*(getattr(self, field.name)[chosen] for field in fields(self)))
        for name in HOSTED.intersection(self.__dict__):
            made.__dict__[name] = getattr(self, name)[np.asarray(members)]
        return made

    def put(self, members: NDArray, other: Evaluation) -> None:
        """Overwrite some members with those of ``other``."""
        chosen = like(np.asarray(members), self.C)
        for field in fields(self):
            getattr(self, field.name)[chosen] = getattr(other, field.name)
        for name in HOSTED.intersection(self.__dict__):
            mine = self.__dict__.pop(name)
            if name in other.__dict__:
                self.__dict__[name] = mine.copy()
                self.__dict__[name][members] = other.__dict__[name]

    def replaced(self, members: NDArray[np.bool_], other: Evaluation) -> Evaluation:
        """Members of ``other`` where the mask is set, of this one elsewhere; one of the two itself
        where all come from it."""
        if every(members):
            return other
        if not some(members):
            return self
        made, chosen = self.copy(), np.flatnonzero(members)
        made.put(chosen, other.take(chosen))
        return made

    def copy(self) -> Evaluation:
        """One that may be changed."""
        return self.take(np.arange(len(self.numbers)))

    def on_host(self) -> Evaluation:
        """The same in NumPy arrays."""
        return Evaluation(*(host(getattr(self, field.name)) for field in fields(self)))


@dataclass(eq=False)
class Model:
    """Eq. 9 at one iterate: H (batch, K, 3, nc, nc), A (batch, K, 3, ma, nc), b (batch, K, nc), C
    (batch, K, ma)."""

    H: Array
    A: Array
    b: Array
    C: Array


class CompiledProblem:
    """A batch of problems that differ in numbers only (start, dt, references, weights, parameters).

    Parameters
    ----------
    problems: all with the same model, terms, basis and number of steps.
    threads: of the native code.
    like: a batch with the same model and terms, whose generated code is shared.
    """

    def __init__(
        self, problems: Sequence[Problem], threads: int = 1, like: CompiledProblem | None = None
    ):
        first = problems[0]
        self.problems, self.threads = tuple(problems), max(1, int(threads))
        self.dynamics, self.basis, self.steps = first.dynamics, first.basis_object, int(first.steps)
        if like is None:
            check_alike(problems)
            self.functions = functions_of(first)
        else:
            self.functions = like.functions
            self.__dict__.update(
                {
                    name: like.__dict__[name]
                    for name in ("_library", "kinematics")
                    if name in like.__dict__
                }
            )
        self.batch, self.n, self.nu = len(problems), self.dynamics.nx, self.dynamics.nu
        self.m = len(self.dynamics.unactuated)
        self.p = np.stack([problem.p for problem in problems])
        self.q = np.stack(
            [self.functions.references.pack(problem.costs, problem.setting) for problem in problems]
        )
        self.row_scale = np.stack([problem.row_scale for problem in problems])  # (batch, m)
        self.weight = first.weight
        self.start = np.stack([problem.start for problem in problems])
        dt = np.array([problem.dt for problem in problems])[:, None]
        before = self.start - dt * np.stack([problem.start_velocity for problem in problems])
        self.constant = self.basis.constant(self.steps, self.start, before)
        self.carry = self._carry()
        self.stencil, self.fixed, self.ends = self._fix_ends()
        self.K = self.stencil.units
        self.nc = self.stencil.parts * self.n
        self.ma = self.stencil.parts * self.m
        self.neighbours: NeighbourTerms | None = (
            like.neighbours if like is not None else self._neighbour_terms()
        )

    def _neighbour_terms(self) -> NeighbourTerms | None:
        """Terms over neighbouring Hermite controls, which no single step sees."""
        between = isinstance(self.basis, Hermite) and any(
            isinstance(term, NeighbourCost) for term in self.problems[0].costs
        )
        return NeighbourTerms(self) if between else None

    def _carry(self) -> Array | None:
        """(batch, n, n) of cycles: x_0 = carry x_N + constant; the constants are set too."""
        closures = [problem.closure for problem in self.problems if problem.closure is not None]
        if not closures:
            return None
        self.constant[:, 1] = self.constant[:, 0] = np.stack(
            [closure.constant for closure in closures]
        )
        return np.stack([closure.matrix for closure in closures])

    def _fix_ends(self) -> tuple[Stencil, NDArray[np.intp], Array]:
        """Pins the units of a fixed last state: they become constants of the trajectory and dummies
        of the KKT matrix.

        The stencil without them, the dummies, and the values (batch, K, nc) of the pinned units,
        zero elsewhere.
        """
        stencil = self.basis.stencil(self.steps)
        ends = [p.end is not None for p in self.problems]
        fixed: list[int] = [stencil.units - 1] if isinstance(self.basis, (Hermite, Folded)) else []
        values = np.zeros((self.batch, stencil.units, stencil.parts * self.n))
        if any(ends):
            if not all(ends):
                raise ProblemError("x_end must be given for every problem of a batch or for none")
            pinned = [self._pinned(problem) for problem in self.problems]
            units = sorted(pinned[0])
            for k, table in enumerate(pinned):
                for unit, value in table.items():
                    values[k, unit] = value
            self.constant = node_values(stencil, values, self.constant)
            live = ~np.isin(stencil.unit, units)
            free = np.where(live, stencil.unit, -1).astype(np.int32)
            coefficient = np.where(live, stencil.coefficient, 0.0)
            stencil = Stencil(
                stencil.units,
                stencil.parts,
                free,
                stencil.part,
                coefficient,
                stencil.test_row,
                stencil.test_part,
                stencil.test_coefficient,
            )
            fixed += units
        return stencil, np.array(sorted(fixed), dtype=np.intp), values

    def _pinned(self, problem: Problem) -> dict[int, Array]:
        assert problem.end is not None
        v_end = np.zeros(self.n) if problem.v_end is None else problem.v_end
        return self.basis.fixed_end(self.steps, problem.end, v_end, problem.dt)

    @cached_property
    def idle(self) -> tuple[int, int] | None:
        """(unit, part) that no node is made of, of a cycle with an odd number of steps: its half of
        the pair at the fold."""
        return (self.K - 2, 1) if isinstance(self.basis, Folded) and self.steps % 2 else None

    def take(self, members: NDArray) -> CompiledProblem:
        """A batch of some members, by index; everything generated is shared."""
        part: CompiledProblem = object.__new__(CompiledProblem)
        part.__dict__.update(
            {
                k: v
                for k, v in self.__dict__.items()
                if k not in ("_free_tasks", "_chunks", "_machine")
            }
        )
        part.problems = tuple(self.problems[int(k)] for k in members)
        part.batch = len(part.problems)
        for name in BATCHED:
            whole = getattr(self, name)
            setattr(part, name, None if whole is None else np.ascontiguousarray(whole[members]))
        return part

    def prepare(self) -> None:
        """Generate and compile what is not there yet: set-up, not solving."""
        if self._library is None:
            self.linearize(
                self.evaluate(np.zeros((self.batch, self.K, self.nc))),
                np.zeros((self.batch, self.K, self.ma)),
            )

    # -- what a solver calls -----------------------------------------------------------------------

    def unknowns(self, nodes: Array) -> Array:
        """(batch, K, nc) unknowns of a trajectory (batch, N+2, n); the pinned ones are zero."""
        unknowns = self.basis.fit(np.asarray(nodes, dtype=float), float(self.problems[0].dt))
        unknowns[:, self.fixed] = 0.0
        return np.ascontiguousarray(unknowns)

    def evaluate(self, unknowns: Array) -> Evaluation:
        """E and C at ``unknowns`` (batch, K, nc)."""
        return self.evaluate_nodes(
            unknowns, node_values(self.stencil, unknowns, self.constant, self.carry)
        )

    def evaluate_nodes(self, unknowns: Array, nodes: Array) -> Evaluation:
        """E and C of a trajectory (batch, N+2, n), which the unknowns need not make."""
        nodes = doubles("nodes", nodes, (self.batch, self.steps + 2, self.n))
        fd = np.empty((self.batch, self.steps, self.n))
        terms = np.empty((self.batch, self.steps, len(self.functions.references.terms)))
        if self._library is not None:
            C = np.empty((self.batch, self.K, self.ma))
            self._native_evaluate(nodes, fd, terms, C)
        else:
            fd[:] = self.dynamics.evaluate(nodes, self.p)[0]
            terms[:] = self._machine.terms(nodes, fd)
            C = self.reduce(fd)
        if self.neighbours is not None:
            self.neighbours.values(self, unknowns, terms)
        return Evaluation.of(unknowns, nodes, fd, terms, terms.sum(axis=(1, 2)), C)

    def reduce(self, fd: Array) -> Array:
        """C = (Sᵀ ⊗ U_/) FD, scaled: (batch, K, ma)."""
        rows = fd[:, :, self.dynamics.unactuated] * self.row_scale[:, None]
        return np.matmul(self._test_matrix, rows).reshape(self.batch, self.K, self.ma)

    def linearize(
        self, at: Evaluation, lam: Array | None, curved: NDArray[np.bool_] | None = None
    ) -> Model:
        """Eq. 9 at an evaluated iterate; with ``lam`` (batch, K, ma) the curvature of lamᵀC and of
        the terms over torques, and of the terms over contacts for the members ``curved`` (batch,)
        bool, all by default."""
        lam = None if lam is None else doubles("lam", lam, (self.batch, self.K, self.ma))
        shape = (self.batch, self.K)
        H, A = np.empty((*shape, 3, self.nc, self.nc)), np.empty((*shape, 3, self.ma, self.nc))
        b, C = np.empty((*shape, self.nc)), np.empty((*shape, self.ma))
        if self._library is not None:
            self._native_linearize(at, lam, curved, (H, A, b, C))
        else:
            self._machine.linearize(at, lam, (H, A, b, C), curved)
        if self.neighbours is not None:
            self.neighbours.add(self, at.unknowns, H, b)
        H[:, self.fixed, 0] = np.eye(self.nc)
        if self.idle is not None:
            unit, part = self.idle
            own = np.arange(part * self.n, (part + 1) * self.n)
            H[:, unit, 0, own, own] = 1.0
        return Model(H, A, b, C)

    def term_values(self, at: Evaluation) -> Array:
        """(batch, terms) the parts of E."""
        return at.terms.sum(axis=1)

    # -- native ------------------------------------------------------------------------------------

    @cached_property
    def _test_matrix(self) -> Array:
        """(K·parts, N) Sᵀ of the test rows."""
        s = self.stencil
        matrix = np.zeros((s.units * s.parts, self.steps))
        for k in range(s.test_row.shape[1]):
            live = np.flatnonzero(s.test_row[:, k] >= 0)
            matrix[s.test_row[live, k] * s.parts + s.test_part[live, k], live] += (
                s.test_coefficient[live, k]
            )
        return matrix

    @property
    def library(self) -> ctypes.CDLL | None:
        """assemble.c with the code of this problem; None without a compiler."""
        return self._library

    @cached_property
    def _library(self) -> ctypes.CDLL | None:
        return native.load(
            self.dynamics.lanes_text() + codegen.cost_text(self.functions, self.dynamics)
        )

    @cached_property
    def _machine(self) -> Any:
        from octo.problem.interpreted import Interpreted

        return Interpreted(self)

    @cached_property
    def _chunks(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
        """First own step, unit and row of each chunk of neighbouring steps (see assemble.c)."""
        if isinstance(self.basis, Folded):  # both ends of the chain write to the same units
            zero = np.zeros(1, dtype=np.int32)
            return np.array([0, self.steps], dtype=np.int32), zero, zero
        q = self.basis.steps_per_segment if isinstance(self.basis, Hermite) else 1
        pieces, grain = self.steps // q, GROUP if q == 1 else 1
        groups = -(-pieces // grain)
        count = (
            1 if self.threads == 1 else max(1, min(4 * self.threads, groups // (3 if q > 1 else 1)))
        )
        first = np.array([groups * c // count * grain for c in range(count)], dtype=np.int32)
        row = first + (1 if q > 1 else 0)
        unit = first.copy()
        unit[0] = row[0] = 0
        return np.append(first * q, self.steps).astype(np.int32), unit, row.astype(np.int32)

    @cached_property
    def _free_tasks(self) -> list[tuple[_Task, list[Any]]]:
        """Those that no thread is using: each call has one of its own, for it is where the native
        code writes."""
        return []

    def _own_task(self) -> tuple[_Task, list[Any]]:
        """One for a call, which gives it back to ``_free_tasks``."""
        try:
            return self._free_tasks.pop()
        except IndexError:
            return self._make_task()

    def _make_task(self) -> tuple[_Task, list[Any]]:
        """octo_task, and the arrays that must outlive it."""
        step, unit, row = self._chunks
        chunks, s = len(unit), self.stencil
        size = 6 * self.nc**2 + 3 * self.ma * self.nc + 2 * self.nc + self.ma
        halo = np.empty((self.batch, chunks, max(size, 1)))
        tables = [
            step,
            unit,
            row,
            s.unit,
            s.part,
            s.coefficient,
            s.test_row,
            s.test_part,
            s.test_coefficient,
        ]
        kept = [np.ascontiguousarray(a) for a in (*tables, self.p, self.q, self.row_scale)]
        sizes = (
            self.batch,
            self.steps,
            s.units,
            s.unit.shape[1],
            s.test_row.shape[1],
            s.parts,
            chunks,
        )
        task = task_of(sizes, kept[:9], kept[9:], halo)
        if self.carry is not None:
            kept.append(np.ascontiguousarray(self.carry))
            task.carry = kept[-1].ctypes.data
        kept.append(halo)
        return task, kept

    def refresh(self) -> None:
        """Take over references and weights that changed in place in the problems' terms. Nothing is
        recompiled."""
        for k, problem in enumerate(self.problems):
            self.q[k] = self.functions.references.pack(problem.costs, problem.setting)
        self.__dict__.pop("_free_tasks", None)

    def _native_evaluate(self, nodes: Array, fd: Array, terms: Array, C: Array) -> None:
        assert self._library is not None
        own = self._own_task()
        task = own[0]
        task.nodes = nodes.ctypes.data
        task.fd = fd.ctypes.data
        task.terms = terms.ctypes.data
        task.c = C.ctypes.data
        if self._library.octo_evaluate(ctypes.byref(task), self.threads):
            raise MemoryError("octo_evaluate could not allocate its work arrays")
        self._free_tasks.append(own)

    def _native_linearize(
        self,
        at: Evaluation,
        lam: Array | None,
        curved: NDArray[np.bool_] | None,
        out: tuple[Array, ...],
    ) -> None:
        assert self._library is not None
        nodes = doubles("nodes", at.nodes, (self.batch, self.steps + 2, self.n))
        fd = doubles("fd", at.fd, (self.batch, self.steps, self.n))
        own = self._own_task()
        task = own[0]
        task.nodes, task.fd = nodes.ctypes.data, fd.ctypes.data
        task.lam = None if lam is None else lam.ctypes.data
        members = None if curved is None else np.ascontiguousarray(curved, dtype=np.int32)
        task.curved = None if members is None else members.ctypes.data
        task.h, task.a, task.b, task.c = (array.ctypes.data for array in out)
        if self._library.octo_linearize(ctypes.byref(task), self.threads):
            raise MemoryError("octo_linearize could not allocate its work arrays")
        self._free_tasks.append(own)

    @cached_property
    @postponed()
    def kinematics(self) -> ca.Function:
        """Contact forces, points, depths and velocities of one step, for reports: (x_next, x,
        p)."""
        dynamics = self.dynamics
        if not isinstance(dynamics, RobotDynamics):
            raise ProblemError("user-written dynamics have no contacts")
        x_next = ca.SX.sym("x_next", self.n)
        x = ca.SX.sym("x", self.n)
        p = ca.SX.sym("p", dynamics.layout.size)
        view = dynamics.layout.view(p)
        states = symbolic.contact_states(
            dynamics.character, x_next, x, dynamics.law, dynamics.terrain, view
        )
        columns = [
            [s.force for s in states],
            [s.point for s in states],
            [s.velocity for s in states],
            [s.normal for s in states],
        ]
        depth = ca.vertcat(*[s.depth for s in states]) if states else ca.SX(0, 1)
        outputs = [ca.horzcat(*column) if column else ca.SX(3, 0) for column in columns]
        return ca.Function("contacts", [x_next, x, p], [*outputs, depth])


def task_of(
    sizes: tuple[int, ...], tables: Sequence[NDArray], values: Sequence[NDArray], halo: NDArray
) -> _Task:
    """octo_task of assemble.c over contiguous arrays that the caller keeps: ``tables`` of the
    chunks and the stencil, ``values`` p, q and the scale of the rows."""
    at, given = [a.ctypes.data for a in tables], [a.ctypes.data for a in values]
    return _Task(
        *sizes,
        *at,
        None,
        *given,
        None,
        None,
        None,
        None,
        None,
        None,
        None,
        halo.ctypes.data,
        None,
        None,
    )


class _Task(ctypes.Structure):
    """octo_task of assemble.c."""

    _fields_ = [
        *(
            (name, ctypes.c_int)
            for name in ("batch", "steps", "units", "slots", "tests", "parts", "chunks")
        ),
        *(
            (name, ctypes.c_void_p)
            for name in (
                "chunk_step",
                "chunk_unit",
                "chunk_row",
                "slot_unit",
                "slot_part",
                "slot_value",
                "test_row",
                "test_part",
                "test_value",
                "nodes",
                "p",
                "q",
                "row_scale",
                "fd",
                "terms",
                "lam",
                "h",
                "a",
                "b",
                "c",
                "halo",
                "carry",
                "curved",
            )
        ),
    ]
