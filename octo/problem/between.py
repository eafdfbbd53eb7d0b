"""Terms over neighbouring Hermite controls as text: their functions and tables, in C that is CUDA
too.

between.c works from them on a CPU, between.cu of octo.gpu on a device; neighbours.py has the
mathematics.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from importlib import resources

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.dynamics.emit import function_of_numbers
from octo.interrupts import postponed
from octo.problem.codegen import CostFunctions


@dataclass(frozen=True, eq=False)
class BetweenCode:
    """Of the terms over (c_k, c_{k+1}) of a list, one after another.

    functions: of the whole list.
    """

    functions: CostFunctions

    @cached_property
    def size(self) -> int:
        """Numbers of a control."""
        return int(self.functions.between[0][1].numel_in(0))

    @cached_property
    def _first_row(self) -> list[int]:
        return _starts(function.numel_out(0) for _, function in self.functions.between)

    @cached_property
    def _patterns(self) -> list[ca.Sparsity]:
        """Of each term's derivatives, (rows, 2 size)."""
        return [function.sparsity_out(1) for _, function in self.functions.between]

    @property
    def _entry_rows(self) -> list[int]:
        firsts = self._first_row[:-1]
        return [
            row + first for p, first in zip(self._patterns, firsts, strict=True) for row in p.row()
        ]

    @property
    def rows(self) -> int:
        """Residuals of one segment."""
        return self._first_row[-1]

    @property
    def entries(self) -> int:
        """Their derivatives that may not be zero."""
        return sum(pattern.nnz() for pattern in self._patterns)

    @property
    def pattern(self) -> NDArray[np.bool_]:
        """(2 size, 2 size) what their squares couple."""
        whole = np.zeros((2 * self.size, 2 * self.size), dtype=bool)
        for own in self._patterns:
            rows = np.zeros(own.shape, dtype=bool)
            rows[own.row(), own.get_col()] = True
            whole |= rows.T @ rows
        return whole

    @cached_property
    @postponed()
    def bends(self) -> Bends:
        """Of the terms that are exact."""
        return Bends.of(self.functions)

    @cached_property
    @postponed()
    def text(self) -> str:
        """``octo_between(k, arg, res)``: the values of term k, or derivatives of term k −
        BETWEEN; sizes and tables; those of ``bends``."""
        references = self.functions.references
        made: list[list[ca.Function]] = [[], []]  # values, derivatives
        for _, function in self.functions.between:
            inputs = function.sx_in()
            r, jac = function(*inputs)[:2]
            slopes = ca.vertcat(*jac.nonzeros()) if jac.nnz() else ca.SX(0, 1)
            for kind, name, output in zip(made, ("value", "slope"), (r, slopes), strict=True):
                named = f"octo_between_{name}{len(kind)}"
                kind.append(ca.Function(named, inputs, [output], {"cse": True}))
        sizes = {
            "BETWEEN": len(self.functions.between),
            "BR": self.rows,
            "BZ": self.entries,
            "BC": self.size,
            "BTERM": len(references.terms),
            "BQ": self.functions.numbers,
        }
        functions = [*made[0], *made[1]]
        cases = " ".join(
            f"case {k}: {function.name()}(arg, res); break;" for k, function in enumerate(functions)
        )
        return "\n".join(
            [
                *map(function_of_numbers, functions),
                *self.bends.text(),
                *(f"#define {name} {value}" for name, value in sizes.items()),
                *self._tables(),
                "static void octo_between(int k, const double **arg, double **res) {",
                f"  switch (k) {{ {cases} }}\n}}",
            ]
        )

    def _tables(self) -> list[str]:
        tables: dict[str, Iterable[int]] = {
            "term": [term for term, _ in self.functions.between],
            "first_row": self._first_row,
            "first_entry": _starts(pattern.nnz() for pattern in self._patterns),
            "entry_row": self._entry_rows,
            "entry_column": [column for p in self._patterns for column in p.get_col()],
        }
        return [_table(name, values) for name, values in tables.items()]

    def c_text(self) -> str:
        """With between.c; stands after assemble.c."""
        rows = np.array(self._entry_rows, dtype=int)
        order = np.argsort(rows, kind="stable")
        start = np.searchsorted(rows[order], np.arange(self.rows + 1))
        own = (resources.files("octo.problem") / "between.c").read_text(encoding="utf-8")
        return "\n".join([self.text, _table("row_start", start), _table("row_entry", order), own])


@dataclass(frozen=True)
class Bends:
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
    def of(cls, functions: CostFunctions) -> Bends:
        made = cls([], [], [0], [], [])
        for term, function in functions.between:
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
            *(_table(name, values) for name, values in tables.items()),
            "static void octo_between_second(int k, const double **arg, double **res) {",
            f"  switch (k) {{ {cases} }}\n}}",
        ]


def _starts(counts: Iterable[int]) -> list[int]:
    return [int(k) for k in np.cumsum([0, *counts])]


def _table(name: str, values: Iterable[int]) -> str:
    listed = ", ".join(str(int(value)) for value in values) or "0"
    return f"static const int octo_between_{name}[] = {{{listed}}};"
