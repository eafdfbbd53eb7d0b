"""Terms over two steps in a row on a device: their generated code and the kernels of
step_pairs.cu."""

from __future__ import annotations

from typing import Any

import casadi as ca

from octo.dynamics.codegen import integers, macros
from octo.emit import function_of_numbers
from octo.gpu.device import Array, Device, Kernels, source
from octo.problem.basis import WINDOW
from octo.problem.compiled import CompiledProblem
from octo.problem.step_pairs import PairFunctions

Numbers = tuple[Array, Array, Array, Array, Array | None]  # nodes, FD, p, q, carry

FLAT = 64  # threads of a block for residuals, a thread each


class StepPairs(Kernels):
    """The compiled text of a list of terms over two steps in a row."""

    def __init__(self, problem: CompiledProblem, functions: PairFunctions, device: Device):
        self.functions, self.nu = functions, problem.nu
        dynamics = problem.dynamics
        inputs = functions.slopes.sx_in()
        slopes = ca.Function(
            functions.slopes.name(), inputs, [functions.slopes(*inputs)[1]], {"cse": True}
        )
        own = [functions.value, slopes]
        own += [] if functions.curvature is None else [functions.curvature.function]
        sizes = {
            "NX": problem.n,
            "NU": problem.nu,
            "NP": problem.p.shape[1],
            "NQ": problem.q.shape[2],
            "NTERM": len(problem.functions.references.terms),
        }
        text = [
            source("common.cuh"),
            *map(function_of_numbers, own),
            macros(sizes),
            functions.tables,
            integers("pair_actuated", dynamics.actuated),
            source("step_pairs.cu"),
        ]
        super().__init__(device, "\n".join(text))

    def values(self, numbers: Numbers, terms: Array) -> None:
        """Adds their share of E to ``terms`` (batch, N, terms)."""
        self.each_step("octo_pair_values", terms.shape, 1, *numbers, terms)

    def derived(self, numbers: Numbers) -> Derived:
        """Their derivatives at an iterate."""
        shape, own = numbers[1].shape, self.functions
        r, jac = (
            self.device.empty((*shape[:2], max(k, 1))) for k in (own.rows, own.sparsity.nnz())
        )
        self.each_step("octo_pair_slopes", shape, 1, *numbers, r, jac)
        return Derived(self, numbers, (r, jac))

    def each_step(self, name: str, shape: tuple[int, ...], each: int, *arguments: Any) -> None:
        """A kernel over the steps of a batch (batch, N, …), ``each`` things of one."""
        self.flat(name, shape[0] * shape[1] * each, shape[1], *arguments, threads=FLAT)


class Derived:
    """The derivatives of one iterate, on their way to a model.

    Parameters
    ----------
    slopes: (batch, N, rows) r and (batch, N, entries) its derivatives to the window and torques.
    """

    def __init__(self, pairs: StepPairs, numbers: Numbers, slopes: tuple[Array, Array]):
        self.pairs, self.numbers, self.slopes = pairs, numbers, slopes
        self.bends: Array | None = None

    def pull(self, lam: Array) -> None:
        """Adds dE/du to the multipliers ``lam`` (batch, N, n) of FD."""
        own = (*self.numbers[3:], *self.slopes, lam)
        self.pairs.each_step("octo_pair_pull", lam.shape, self.pairs.nu, *own)

    def chain(self, fd_jac: Array, exact: bool, curved: Array | None) -> None:
        """The rows dr/dwindow and r, scaled, and with ``exact`` what exact terms have beside them,
        of the members ``curved``.

        fd_jac: (batch, N, n, 3n) slopes of FD.
        """
        own, device, width = self.pairs.functions, self.pairs.device, WINDOW * fd_jac.shape[2]
        count = max(own.rows, 1)
        self.rows = device.empty((*fd_jac.shape[:2], count, width + 1))
        rows = (*self.numbers[3:], *self.slopes, fd_jac, self.rows)
        self._each_window("octo_pair_rows", fd_jac.shape, count, *rows)
        if exact and own.curvature is not None:
            self.bends = device.empty((*fd_jac.shape[:2], width, width))
            bends = (curved, *self.numbers, fd_jac, self.bends)
            size = own.curvature.sparsity.nnz()
            self._each_window("octo_pair_bends", fd_jac.shape, size, *bends)

    def add(self, tables: dict[str, Array], H: Array, b: Array) -> None:
        """Adds 2 JᵀJ, the curvature of exact terms, and 2 Jᵀr to H (batch, K, 3, nc, nc) and b
        (batch, K, nc)."""
        names = [f"{n}_{k}" for n in ("pairs", "pairs_b") for k in ("first", "source", "value")]
        out = (*(tables[name] for name in names), self.rows, self.bends, H, b)
        steps, width = self.rows.shape[1], self.rows.shape[3] - 1
        grid, parts = (H.shape[1], 3, H.shape[0]), WINDOW * H.shape[-1] // width
        self.pairs.each("octo_pair_add", grid, steps, parts, *out)

    def _each_window(self, name: str, shape: tuple[int, ...], shared: int, *arguments: Any) -> None:
        """A kernel with a block of ``shared`` doubles for each step with one before it."""
        batch, steps = shape[:2]
        first = int(self.numbers[-1] is None)
        if steps > first:
            grid = (steps - first, batch)
            self.pairs.each(name, grid, steps, first, *arguments, shared=8 * shared)
