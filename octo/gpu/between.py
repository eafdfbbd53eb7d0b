"""Terms over neighbouring Hermite controls on a device: their generated code and the kernels of
between.cu."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from octo.dynamics.emit import function_of_numbers
from octo.gpu.device import Array, Device, source
from octo.problem.neighbours import NeighbourTerms

SMALL, WIDE = 32, 256  # threads of a block for a segment's terms, and for a block of H


class Between:
    """The compiled text of a list of terms over (c_k, c_{k+1}).

    rows: residuals of one segment.
    """

    def __init__(self, terms: NeighbourTerms, device: Device):
        self.device, self.size = device, terms.size
        functions, patterns = [function for _, function in terms.functions], []
        made: list[list[ca.Function]] = [[], []]  # values, derivatives
        for function in functions:
            inputs = function.sx_in()
            r, jac = function(*inputs)[:2]
            patterns.append(jac.sparsity())
            for kind, output in zip(
                made, (r, ca.vertcat(*jac.nonzeros()) if jac.nnz() else ca.SX(0, 1)), strict=True
            ):
                name = f"octo_between_{'slope' if kind is made[1] else 'value'}{len(kind)}"
                kind.append(ca.Function(name, inputs, [output], {"cse": True}))
        first_row = np.cumsum([0, *(function.numel_out(0) for function in functions)])
        first_entry = np.cumsum([0, *(pattern.nnz() for pattern in patterns)])
        self.rows, self.entries = int(first_row[-1]), int(first_entry[-1])
        sizes = {
            "BETWEEN": len(functions),
            "BR": self.rows,
            "BZ": self.entries,
            "BC": terms.size,
            "BTERM": terms.count,
            "BQ": terms.references,
        }
        tables: dict[str, Iterable[int]] = {
            "term": [term for term, _ in terms.functions],
            "first_row": first_row,
            "first_entry": first_entry,
            "entry_row": [
                row + first
                for p, first in zip(patterns, first_row[:-1], strict=True)
                for row in p.row()
            ],
            "entry_column": [column for p in patterns for column in p.get_col()],
        }
        cases = " ".join(
            f"case {k}: {function.name()}(arg, res); break;"
            for k, function in enumerate([*made[0], *made[1]])
        )
        bends = _Bends.of(terms)
        self.bends = bends.size
        text = [
            source("common.cuh"),
            *map(function_of_numbers, [*made[0], *made[1]]),
            *bends.text(),
            *(f"#define {name} {value}" for name, value in sizes.items()),
            *(
                f"static const int octo_between_{name}[] = {{{_listed(values)}}};"
                for name, values in tables.items()
            ),
            "static void octo_between(int k, const double **arg, double **res) {",
            f"  switch (k) {{ {cases} }}\n}}",
            source("between.cu"),
            *([source("between_curvature.cu")] if self.bends else []),
        ]
        self.kernel = device.module("\n".join(text)).kernel

    def values(self, anchor: Array, unknowns: Array, q: Array, terms: Array) -> None:
        """Writes their share of E into ``terms`` (batch, N, terms), at the last step of each
        segment."""
        batch, units = unknowns.shape[:2]
        controls, length = self._controls(anchor, unknowns), terms.shape[1] // (units - 1)
        threads = self.device.threads(SMALL)
        self.kernel("octo_between_values")(
            (units - 1, batch), threads, length, controls, q, terms, shared=8 * self.rows
        )

    def add(
        self, anchor: Array, unknowns: Array, q: Array, dummy: Array, H: Array, b: Array
    ) -> None:
        """Adds 2 JᵀJ and 2 Jᵀr to H (batch, K, 3, nc, nc) and b (batch, K, nc)."""
        batch, units = unknowns.shape[:2]
        controls, length = self._controls(anchor, unknowns), q.shape[1] // (units - 1)
        rows = self.device.empty((batch, units - 1, self.rows, 2 * self.size + 1))
        shared = 8 * (2 * self.rows + self.entries)
        self.kernel("octo_between_rows")(
            (units - 1, batch), self.device.threads(WIDE), length, controls, q, rows, shared=shared
        )
        self.kernel("octo_between_add")(
            (units - 1, 2, batch), self.device.threads(WIDE), dummy, rows, H, b
        )

    def bend(
        self, anchor: Array, unknowns: Array, q: Array, dummy: Array, curved: Array | None, H: Array
    ) -> None:
        """Adds the curvature of exact terms to H of the members ``curved``."""
        if not self.bends:
            return
        batch, units = unknowns.shape[:2]
        controls, length = self._controls(anchor, unknowns), q.shape[1] // (units - 1)
        threads = self.device.threads(SMALL)
        self.kernel("octo_between_bend")(
            (units - 1, batch),
            threads,
            length,
            curved,
            dummy,
            controls,
            q,
            H,
            shared=8 * self.bends,
        )

    def _controls(self, anchor: Array, unknowns: Array) -> Array:
        controls, threads = self.device.empty(unknowns.shape), self.device.threads(WIDE)
        count = int(unknowns.size)
        grid = (min(-(-count // threads), 65535),)
        self.kernel("octo_between_controls")(
            grid, threads, count, unknowns.shape[1], anchor, unknowns, controls
        )
        return controls


@dataclass(frozen=True)
class _Bends:
    """The second derivatives of the exact ones of a list of terms.

    functions: (c_k, c_{k+1}, q) -> the upper triangle of Σ r ∂²r of each; terms: their indices.
    first: where each begins among the numbers, of ``rows`` and ``columns``.
    """

    functions: list[ca.Function]
    terms: list[int]
    first: list[int]
    rows: list[int]
    columns: list[int]

    @classmethod
    def of(cls, terms: NeighbourTerms) -> _Bends:
        made = cls([], [], [0], [], [])
        for term, function in terms.functions:
            inputs = function.sx_in()
            upper = ca.triu(function(*inputs)[2]) if function.n_out() > 2 else ca.SX(1, 1)
            if not upper.nnz():
                continue
            name, numbers = f"octo_between_bend_{term}", ca.vertcat(*upper.nonzeros())
            made.functions.append(ca.Function(name, inputs, [numbers], {"cse": True}))
            made.terms.append(term)
            made.rows.extend(upper.sparsity().row())
            made.columns.extend(upper.sparsity().get_col())
            made.first.append(len(made.rows))
        return made

    @property
    def size(self) -> int:
        """Of a segment."""
        return len(self.rows)

    def text(self) -> list[str]:
        """C text of the functions, their sizes and places; nothing where there are none."""
        if not self.size:
            return []
        tables = {
            "bend_term": self.terms,
            "bend_first": self.first,
            "bend_row": self.rows,
            "bend_column": self.columns,
        }
        cases = " ".join(
            f"case {k}: {function.name()}(arg, res); break;"
            for k, function in enumerate(self.functions)
        )
        return [
            *map(function_of_numbers, self.functions),
            f"#define BENT {len(self.functions)}\n#define BS {self.size}",
            *(
                f"static const int octo_between_{name}[] = {{{_listed(values)}}};"
                for name, values in tables.items()
            ),
            "static void octo_between_second(int k, const double **arg, double **res) {",
            f"  switch (k) {{ {cases} }}\n}}",
        ]


def _listed(values: Iterable[int]) -> str:
    return ", ".join(str(int(value)) for value in values) or "0"
