"""Terms over two steps in a row on a device: their generated code and the kernels of
step_pairs.cu."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from octo.dynamics.codegen import integers
from octo.dynamics.emit import function_of_numbers
from octo.gpu.device import Array, Device, source
from octo.gpu.tables import Gather, slots_of
from octo.problem.basis import Stencil
from octo.problem.compiled import CompiledProblem
from octo.problem.step_pairs import WINDOW, PairFunctions

FLAT, WIDE = 64, 256  # threads of a block for residuals, a thread each, and for a block of H


class StepPairs:
    """The compiled text of a list of terms over two steps in a row."""

    def __init__(self, problem: CompiledProblem, functions: PairFunctions, device: Device):
        self.device, self.functions, self.nu = device, functions, problem.nu
        dynamics = problem.dynamics
        inputs = functions.slopes.sx_in()
        slopes = ca.Function(
            functions.slopes.name(), inputs, [functions.slopes(*inputs)[1]], {"cse": True}
        )
        sizes = {
            "NX": problem.n,
            "NU": problem.nu,
            "NP": problem.p.shape[1],
            "NQ": problem.q.shape[2],
            "NTERM": len(problem.functions.references.terms),
        }
        text = [
            source("common.cuh"),
            *map(function_of_numbers, [functions.value, slopes]),
            *([] if functions.bend is None else [function_of_numbers(functions.bend)]),
            *(f"#define {name} {size}" for name, size in sizes.items()),
            functions.tables,
            integers("pair_actuated", dynamics.actuated),
            source("step_pairs.cu"),
        ]
        self.kernel = device.module("\n".join(text)).kernel

    def values(self, nodes: Array, fd: Array, p: Array, q: Array, terms: Array) -> None:
        """Adds their share of E to ``terms`` (batch, N, terms)."""
        self._flat("octo_pair_values", terms.shape, 1, nodes, fd, p, q, terms)

    def slopes(self, nodes: Array, fd: Array, p: Array, q: Array) -> tuple[Array, Array]:
        """(batch, N, rows) r and (batch, N, entries) its derivatives."""
        rows, entries = self.functions.rows, self.functions.sparsity.nnz()
        r, jac = (self.device.empty((*fd.shape[:2], max(k, 1))) for k in (rows, entries))
        self._flat("octo_pair_slopes", fd.shape, 1, nodes, fd, p, q, r, jac)
        return r, jac

    def pull(self, q: Array, slopes: tuple[Array, Array], lam: Array) -> None:
        """Adds dE/du to the multipliers ``lam`` (batch, N, n) of FD."""
        self._flat("octo_pair_pull", lam.shape, self.nu, q, *slopes, lam)

    def rows(self, q: Array, slopes: tuple[Array, Array], fd_jac: Array) -> Array:
        """(batch, N, rows, 4n + 1) dr/dwindow and r, scaled, from those of FD (batch, N, n, 3n)."""
        batch, steps, n, _ = fd_jac.shape
        count = self.functions.rows
        rows = self.device.empty((batch, steps, max(count, 1), WINDOW * n + 1))
        if steps > 1:
            self.kernel("octo_pair_rows")(
                (steps - 1, batch),
                self.device.threads(WIDE),
                steps,
                q,
                *slopes,
                fd_jac,
                rows,
                shared=8 * max(count, 1),
            )
        return rows

    def bends(self, curved: Array | None, numbers: Sequence[Array], fd_jac: Array) -> Array | None:
        """(batch, N, 4n, 4n) what exact terms have beside rowsᵀ rows, of the members ``curved``;
        None where there is nothing.

        numbers: nodes, FD, p, q.
        """
        batch, steps, n, _ = fd_jac.shape
        if self.functions.bend is None or steps < 2:
            return None
        bends = self.device.empty((batch, steps, WINDOW * n, WINDOW * n))
        self.kernel("octo_pair_bends")(
            (steps - 1, batch),
            self.device.threads(WIDE),
            steps,
            curved,
            *numbers,
            fd_jac,
            bends,
            shared=8 * self.functions.bends.nnz(),
        )
        return bends

    def add(
        self, tables: dict[str, Array], rows: Array, bends: Array | None, H: Array, b: Array
    ) -> None:
        """Adds 2 JᵀJ, the curvature of exact terms, and 2 Jᵀr to H (batch, K, 3, nc, nc) and b
        (batch, K, nc)."""
        names = [f"{n}_{k}" for n in ("pairs", "pairs_b") for k in ("first", "source", "value")]
        own = [tables[name] for name in names]
        grid = (H.shape[1], 3, H.shape[0])
        self.kernel("octo_pair_add")(
            grid, self.device.threads(WIDE), rows.shape[1], *own, rows, bends, H, b
        )

    def _flat(self, name: str, shape: tuple[int, ...], each: int, *arguments: Array) -> None:
        """A kernel over the steps of a batch (batch, N, …), ``each`` things of one."""
        threads, count = self.device.threads(FLAT), shape[0] * shape[1] * each
        grid = (min(-(-count // threads), 65535),)
        self.kernel(name)(grid, threads, count, shape[1], *arguments)


def gathers(stencil: Stencil, steps: int) -> dict[str, Gather]:
    """Where the blocks of H ("pairs") and b ("pairs_b") take what they have from: (step, node,
    other node) and (step, node) of the windows of four nodes, as one number."""
    hessian, gradient = [], []
    for i in range(1, steps):
        slots = list(slots_of(stencil, i, WINDOW))
        for a, unit, part, value in slots:
            gradient.append((unit, WINDOW * i + a, part, value))
            for other, other_unit, other_part, other_value in slots:
                if other_unit <= unit:
                    place = (WINDOW * i + a) * WINDOW + other
                    pair = part * stencil.parts + other_part
                    lag = 3 * unit + unit - other_unit
                    hessian.append((lag, place, pair, value * other_value))
    return {
        "pairs": Gather.of(3 * stencil.units, stencil.parts**2, hessian),
        "pairs_b": Gather.of(stencil.units, stencil.parts, gradient),
    }
