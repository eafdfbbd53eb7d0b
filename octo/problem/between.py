"""Terms over neighbouring Hermite controls as text: their functions and tables, in C that is CUDA
too.

between.c works from them on a CPU, between.cu of octo.gpu on a device; neighbours.py has the
mathematics.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from octo.emit import function_of_numbers, switch
from octo.interrupts import postponed
from octo.problem.codegen import CostFunctions
from octo.problem.curvature import nonzeros
from octo.problem.lane_tables import tables_text


@dataclass(frozen=True)
class Entries:
    """The nonzeros of a matrix of each of some terms, one after another.

    functions: (c_k, c_{k+1}, q) -> the nonzeros of each; terms: their indices. first: where each
    begins among the numbers, of ``rows`` and ``columns``.
    """

    functions: list[ca.Function] = field(default_factory=list)
    terms: list[int] = field(default_factory=list)
    first: list[int] = field(default_factory=lambda: [0])
    rows: list[int] = field(default_factory=list)
    columns: list[int] = field(default_factory=list)

    @property
    def size(self) -> int:
        """Of a segment."""
        return len(self.rows)

    def add(self, term: int, function: ca.Function, name: str, matrix: ca.SX, row: int = 0) -> None:
        """``matrix``, made of the symbols of a term's function; its rows are counted from ``row``
        on."""
        self.functions.append(_part(function, name, nonzeros(matrix)))
        self.terms.append(term)
        self.rows.extend(row + k for k in matrix.sparsity().row())
        self.columns.extend(matrix.sparsity().get_col())
        self.first.append(self.size)


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

    @property
    def rows(self) -> int:
        """Residuals of one segment."""
        return self._first_row[-1]

    @property
    def pattern(self) -> NDArray[np.bool_]:
        """(2 size, 2 size) what their squares couple."""
        rows = np.zeros((self.rows, 2 * self.size), dtype=bool)
        rows[self.slopes.rows, self.slopes.columns] = True
        return rows.T @ rows

    @cached_property
    @postponed()
    def slopes(self) -> Entries:
        """Their first derivatives that may not be zero."""
        made = Entries()
        for k, (term, function) in enumerate(self.functions.between):
            slopes = function(*function.sx_in())[1]
            made.add(term, function, f"slope{k}", slopes, self._first_row[k])
        return made

    @cached_property
    @postponed()
    def bends(self) -> Entries:
        """The upper triangle of Σ r ∂²r of the terms that are exact."""
        made = Entries()
        for term, function in self.functions.between:
            for second in function(*function.sx_in())[2:]:
                if ca.triu(second).nnz():
                    made.add(term, function, f"bend_{term}", ca.triu(second))
        return made

    @cached_property
    @postponed()
    def text(self) -> str:
        """``octo_between(k, arg, res)``: the values of term k, or derivatives of term k −
        BETWEEN; sizes and tables; those of ``bends``."""
        made = [
            _part(function, f"value{k}", function(*function.sx_in())[0])
            for k, (_, function) in enumerate(self.functions.between)
        ]
        made += self.slopes.functions
        sizes = {
            "BETWEEN": len(self.functions.between),
            "BR": self.rows,
            "BZ": self.slopes.size,
            "BC": self.size,
            "BTERM": len(self.functions.references.terms),
            "BQ": self.functions.numbers,
        }
        tables = {
            "term": self.slopes.terms,
            "first_row": self._first_row,
            "first_entry": self.slopes.first,
            "entry_row": self.slopes.rows,
            "entry_column": self.slopes.columns,
        }
        own = [tables_text(sizes, _named(tables)), switch("octo_between", made)]
        return "\n".join([*map(function_of_numbers, made), *self._bends_text(), *own])

    def _bends_text(self) -> list[str]:
        """C text of the second derivatives, their sizes and places; nothing where there are
        none."""
        bends = self.bends
        if not bends.size:
            return []
        tables = {
            "bend_term": bends.terms,
            "bend_first": bends.first,
            "bend_row": bends.rows,
            "bend_column": bends.columns,
        }
        sizes = {"BENT": len(bends.functions), "BS": bends.size}
        return [
            *map(function_of_numbers, bends.functions),
            tables_text(sizes, _named(tables)),
            switch("octo_between_second", bends.functions),
        ]

    def c_text(self) -> str:
        """With between.c; stands after assemble.c."""
        rows = np.array(self.slopes.rows, dtype=int)
        order = np.argsort(rows, kind="stable")
        start = np.searchsorted(rows[order], np.arange(self.rows + 1))
        own = (resources.files("octo.problem") / "between.c").read_text(encoding="utf-8")
        tables = tables_text({}, _named({"row_start": start, "row_entry": order}))
        return "\n".join([self.text, tables, own])


def _starts(counts: Iterable[int]) -> list[int]:
    return [int(k) for k in np.cumsum([0, *counts])]


def _part(function: ca.Function, name: str, output: ca.SX) -> ca.Function:
    """``output``, made of the symbols of a term's function, as a function of its own."""
    return ca.Function(f"octo_between_{name}", function.sx_in(), [output], {"cse": True})


def _named(tables: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    return {f"between_{name}": values for name, values in tables.items()}
