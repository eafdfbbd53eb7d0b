"""Terms over neighbouring Hermite controls as text: their functions and tables, in C that is CUDA
too.

between.c works from them on a CPU, between.cu of octo.gpu on a device; neighbours.py has the
mathematics.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from octo.dynamics.emit import function_of_numbers
from octo.interrupts import postponed
from octo.problem.codegen import CostFunctions
from octo.problem.curvature import nonzeros
from octo.problem.lane_tables import tables_text


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
        values, slopes = [], []
        for k, (_, function) in enumerate(self.functions.between):
            r, jac = function(*function.sx_in())[:2]
            values.append(_part(function, f"value{k}", r))
            slopes.append(_part(function, f"slope{k}", nonzeros(jac)))
        sizes = {
            "BETWEEN": len(self.functions.between),
            "BR": self.rows,
            "BZ": self.entries,
            "BC": self.size,
            "BTERM": len(self.functions.references.terms),
            "BQ": self.functions.numbers,
        }
        tables = {
            "term": [term for term, _ in self.functions.between],
            "first_row": self._first_row,
            "first_entry": _starts(pattern.nnz() for pattern in self._patterns),
            "entry_row": self._entry_rows,
            "entry_column": [column for p in self._patterns for column in p.get_col()],
        }
        made = [*values, *slopes]
        return "\n".join(
            [
                *map(function_of_numbers, made),
                *self.bends.text(),
                tables_text(sizes, _named(tables)),
                _choice("octo_between", made),
            ]
        )

    def c_text(self) -> str:
        """With between.c; stands after assemble.c."""
        rows = np.array(self._entry_rows, dtype=int)
        order = np.argsort(rows, kind="stable")
        start = np.searchsorted(rows[order], np.arange(self.rows + 1))
        own = (resources.files("octo.problem") / "between.c").read_text(encoding="utf-8")
        tables = tables_text({}, _named({"row_start": start, "row_entry": order}))
        return "\n".join([self.text, tables, own])


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
            if function.n_out() == 2:
                continue
            upper = ca.triu(function(*function.sx_in())[2])
            if not upper.nnz():
                continue
            made.functions.append(_part(function, f"bend_{term}", nonzeros(upper)))
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
        sizes = {"BENT": len(self.functions), "BS": self.size}
        return [
            *map(function_of_numbers, self.functions),
            tables_text(sizes, _named(tables)),
            _choice("octo_between_second", self.functions),
        ]


def _starts(counts: Iterable[int]) -> list[int]:
    return [int(k) for k in np.cumsum([0, *counts])]


def _part(function: ca.Function, name: str, output: ca.SX) -> ca.Function:
    """``output``, made of the symbols of a term's function, as a function of its own."""
    return ca.Function(f"octo_between_{name}", function.sx_in(), [output], {"cse": True})


def _named(tables: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    return {f"between_{name}": values for name, values in tables.items()}


def _choice(name: str, functions: Sequence[ca.Function]) -> str:
    """C text of a function that calls the one of a number."""
    cases = " ".join(
        f"case {k}: {function.name()}(arg, res); break;" for k, function in enumerate(functions)
    )
    return (
        f"static void {name}(int k, const double **arg, double **res) {{\n"
        f"  switch (k) {{ {cases} }}\n}}"
    )
