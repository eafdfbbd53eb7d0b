"""E, C and their model for a batch of problems of one structure: native code, or CasADi's virtual
machine and NumPy.

Both give the same arrays: ``evaluate`` the value of every term and residual, ``linearize`` H, A, b,
C of Eq. 9 in the block format of the solver (lag storage: H[:, k, o] couples unit k with unit
k − o).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo import native
from octo.checks import Array, doubles, numbers
from octo.errors import ProblemError, ValueRangeError
from octo.problem.array_terms import ArrayTerms
from octo.problem.basis import node_values
from octo.problem.constraints import Constraint
from octo.problem.data import Data, fill, lowered
from octo.problem.evaluation import Evaluation, Model
from octo.problem.interpreted import Interpreted
from octo.problem.native_steps import NativeSteps
from octo.problem.plan import Plan
from octo.problem.problem import Problem
from octo.problem.program import Program
from octo.problem.structure import check_alike, program_of

__all__ = ["CompiledProblem", "Evaluation", "Model"]


class CompiledProblem:
    """A batch of problems that differ in numbers only (start, dt, references, weights, parameters).

    Parameters
    ----------
    problems: all with the same model, terms, basis and number of steps.
    threads: of the native code.
    like: a batch with the same model and terms, whose generated code is shared.
    exact: all terms have exact second derivatives, whatever their ``curvature``; of ``like`` it is
        as there.

    Attributes
    ----------
    program: the generated functions, structure alone. plan: where a step's numbers go. data: the
        numbers, with a batch axis.
    """

    def __init__(
        self,
        problems: Sequence[Problem],
        threads: int = 1,
        like: CompiledProblem | None = None,
        exact: bool = False,
    ):
        first = problems[0]
        if like is None:
            check_alike(problems)
            program = program_of(first, exact)
        else:
            program = like.program
            if "library" in like.__dict__:
                self.__dict__["library"] = like.library
        self.problems, self.threads = tuple(problems), max(1, int(threads))
        self.weight = first.weight
        self._hold(program, *lowered(problems, program.functions))
        self.arrays  # noqa: B018  (refuses what terms written in arrays do not fit)

    def _hold(self, program: Program, plan: Plan, data: Data) -> None:
        """Take over what it is made of, and what is often asked of it by name."""
        self.program, self.plan, self.data = program, plan, data
        self.__dict__.pop("arrays", None)
        self.dynamics, self.functions = program.dynamics, program.functions
        self.basis, self.stencil = plan.basis, plan.stencil
        self.fixed, self.idle = plan.fixed, plan.idle
        self.batch, self.steps, self.n, self.m = len(data.p), plan.steps, plan.n, plan.m
        self.K, self.nc, self.ma, self.nu = plan.K, plan.nc, plan.ma, program.dynamics.nu
        self.p, self.q, self.row_scale = data.p, data.q, data.row_scale
        self.lower, self.upper = data.lower, data.upper
        self.start, self.constant = data.start, data.constant
        self.ends, self.carry = data.ends, data.carry

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and copies: no compiled code."""
        compiled = ("library", "steps_code")
        return {name: value for name, value in self.__dict__.items() if name not in compiled}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A copy's worlds are where its own problems have them, not those of the original."""
        self.__dict__.update(state)
        for own, problem in zip(self.p, self.problems, strict=True):
            own[:] = problem.dynamics.bound(problem.dynamics.unbound(own))

    @property
    def kinematics(self) -> ca.Function:
        """Of one step, for reports (:attr:`Program.kinematics`)."""
        return self.program.kinematics

    # -- others of the same structure --------------------------------------------------------------

    def take(self, members: NDArray) -> CompiledProblem:
        """A batch of some members, by index; everything generated is shared."""
        part = self.with_data(self.plan, self.data.select(members))
        part.problems = tuple(self.problems[int(k)] for k in members)
        if "steps_code" in self.__dict__:
            part.__dict__["steps_code"] = self.steps_code.select(part.data)
        return part

    def with_data(self, plan: Plan, data: Data) -> CompiledProblem:
        """The same with another plan and other numbers; everything generated is shared."""
        part: CompiledProblem = object.__new__(CompiledProblem)
        part.__dict__.update(self.__dict__)
        part._hold(self.program, plan, data)
        part.__dict__.pop("steps_code", None)
        return part

    def interpreted(self) -> CompiledProblem:
        """The same on CasADi's virtual machine, dynamics included, as where there is no
        compiler."""
        plain = self.with_data(self.plan, self.data)
        plain._hold(self.program.interpreted(), self.plan, self.data)
        plain.__dict__["library"] = None
        return plain

    def refresh(self) -> None:
        """Take over references, weights and bounds that changed in place in the problems' terms.
        Nothing is recompiled."""
        fill(self.data, self.plan, self.problems, self.functions)

    @cached_property
    def arrays(self) -> ArrayTerms:
        """The terms that are written in arrays."""
        return ArrayTerms(self.plan, self.data, self.problems)

    def check_squares(
        self, solver: str, bounds: bool = False, timed: bool = False, arrays: bool = False
    ) -> None:
        """Refuse terms that are no squares of E, for a ``solver`` that gives rows no weights, and a
        free duration.

        bounds: it keeps rows between bounds, so constraints are no such terms. timed: it finds
        durations. arrays: it evaluates terms that are written in arrays.

        Raises
        ------
        ProblemError: names the term.
        """
        if self.arrays and not arrays:
            raise ProblemError(
                f"{self.arrays.labels[0]} is written in arrays, which {solver} does not evaluate: "
                "leave it out, or solve with octo.solve"
            )
        if self.problems[0].duration is not None and not timed:
            raise ProblemError(
                f"duration is free and {solver} needs a fixed one: give steps and dt without it"
            )
        for k in self.functions.bounded:
            term = self.functions.references.terms[k]
            if bounds and isinstance(term, Constraint):
                continue
            label = term.label
            raise ProblemError(
                f"{label} is a bounded term, whose rows {solver} gives no weights; only squares "
                "can be given here"
            )

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (batch, N, rows) of the bounded rows."""
        return self.lower, self.upper

    @property
    def used_rows(self) -> NDArray[np.bool_]:
        """(batch, N, rows) the bounded rows at the steps at which their terms act."""
        return np.asarray(self.q[:, :, list(self.functions.bounded)] != 0.0)

    def set_row_weights(
        self, weights: Array, shifts: Array, multipliers: Array | None = None
    ) -> None:
        """What the bounded rows r (of terms whose kind is "bounded") add to the model from now on:
        D r' r'ᵀ to H and d r' to b; to H also second derivatives of Σ y r: those of FD through the
        torques, and of terms with ``curvature="exact"`` their own.

        Parameters
        ----------
        weights: D (batch, N, rows) ≥ 0; where it is zero the row is left out.
        shifts: d (batch, N, rows).
        multipliers: y (batch, N, rows); by default d.

        Raises
        ------
        ShapeError, ValueRangeError: ``weights``, ``shifts`` or ``multipliers`` are not of that
            kind.
        """
        shape = (self.batch, self.steps, len(self.functions.bounded))
        weights, shifts = numbers("weights", weights, shape), numbers("shifts", shifts, shape)
        if (weights < 0.0).any():
            raise ValueRangeError("weights of rows have a negative one, must not be negative")
        given = shifts if multipliers is None else numbers("multipliers", multipliers, shape)
        for place, values in zip(self.functions.row_weights, (weights, shifts, given), strict=True):
            self.q[:, :, place] = values

    @cached_property
    def library(self) -> ctypes.CDLL | None:
        """assemble.c with the code of this problem; None without a compiler."""
        return native.load(self.program.c_text())

    @cached_property
    def steps_code(self) -> NativeSteps | Interpreted:
        """What evaluates and derives the steps."""
        if self.library is None:
            return Interpreted(self.program, self.plan, self.data)
        return NativeSteps(self.library, self.plan, self.data, self.threads)

    def prepare(self) -> None:
        """Generate and compile what is not there yet: set-up, not solving."""
        if self.library is None:
            self.linearize(
                self.evaluate(np.zeros((self.batch, self.K, self.nc))),
                np.zeros((self.batch, self.K, self.ma)),
            )

    # -- what a solver calls -----------------------------------------------------------------------

    def unknowns(self, nodes: Array) -> Array:
        """(batch, K, nc) unknowns of a trajectory (batch, N+2, n); the pinned ones are zero."""
        return self.plan.unknowns(np.asarray(nodes, dtype=float))

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
        rows = np.empty((self.batch, self.steps, len(self.functions.bounded)))
        C = np.empty((self.batch, self.K, self.ma))
        self.steps_code.evaluate(unknowns, nodes, fd, terms, rows, C)
        self.arrays.values(unknowns, nodes, terms)
        return Evaluation.of(unknowns, nodes, fd, terms, rows, C)

    def reduce(self, fd: Array) -> Array:
        """C = (Sᵀ ⊗ U_/) FD, scaled: (batch, K, ma)."""
        return self.plan.reduce(fd[:, :, self.dynamics.unactuated], self.row_scale)

    def linearize(
        self, at: Evaluation, lam: Array | None, curved: NDArray[np.bool_] | None = None
    ) -> Model:
        """Eq. 9 at an evaluated iterate; with ``lam`` (batch, K, ma) the curvature of lamᵀC and of
        the terms over torques, and of the terms over contacts and the exact ones for the members
        ``curved`` (batch,) bool, all by default."""
        lam = None if lam is None else doubles("lam", lam, (self.batch, self.K, self.ma))
        H = np.empty((self.batch, self.K, 3, self.nc, self.nc))
        A, b, C = self._first_order()
        kept = self.program.kept
        R = None if kept is None else np.empty((self.batch, self.steps, kept.size))
        self.steps_code.linearize(at, lam, curved, (H, A, b, C, R))
        self.arrays.add(at.unknowns, at.nodes, H, b)
        self.plan.fill_dummies(H)
        return Model(H, A, b, C, R)

    def row_products(self, model: Model, delta: Array) -> Array:
        """R Δ (batch, N, rows): how the bounded rows change along a step of the unknowns, to first
        order.

        Parameters
        ----------
        model: of ``linearize``; where the weight D was zero then the slope of a row is zero, for a
            row that is left out may have none.
        delta: Δ (batch, K, nc).
        """
        products = np.empty((self.batch, self.steps, len(self.functions.bounded)))
        if model.R is not None:
            rest = np.zeros_like(self.constant)
            moved = node_values(self.stencil, delta, rest, self.carry)
            self.steps_code.row_products(model.R, moved, products)
        return products

    def row_forces(self, model: Model, weights: Array) -> Array:
        """Rᵀ w (batch, K, nc): what ``weights`` w (batch, N, rows) of the bounded rows are on the
        unknowns; ``model`` as of ``row_products``."""
        forces = np.zeros((self.batch, self.K, self.nc))
        if model.R is not None:
            shape = (self.batch, self.steps, len(self.functions.bounded))
            self.steps_code.row_forces(model.R, doubles("weights", weights, shape), forces)
        return forces

    def gradient(self, at: Evaluation) -> tuple[Array, Array]:
        """∇E (batch, K, nc) and A = ∂C/∂v (batch, K, 3, ma, nc) at an evaluated iterate, without
        second derivatives."""
        A, b, C = self._first_order()
        self.steps_code.linearize(at, None, None, (None, A, b, C, None))
        self.arrays.add(at.unknowns, at.nodes, None, b)
        return b, A

    def _first_order(self) -> tuple[Array, Array, Array]:
        """Room for A, b and C."""
        shape = (self.batch, self.K)
        return (
            np.empty((*shape, 3, self.ma, self.nc)),
            np.empty((*shape, self.nc)),
            np.empty((*shape, self.ma)),
        )

    def term_values(self, at: Evaluation) -> Array:
        """(batch, terms) the parts of E."""
        return at.terms.sum(axis=1)
