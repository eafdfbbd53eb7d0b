"""The costs over a step's state, cut into pieces that threads of a block evaluate side by side.

One function of all terms and of all their derivatives is a long chain for one thread, and spills. A piece is the value of
one term, or its derivatives with respect to one of (x_next, x, x_prev, u).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.problem.codegen import CostFunctions


@dataclass(frozen=True, eq=False)
class Pieces:
    """functions: first ``values`` that write rows of r from ``at`` on, then those that write entries of the Jacobian.

    rows, columns (NZ,): of the entries, those with respect to u last.
    """

    functions: list[ca.Function]
    at: list[int]
    values: int
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    @classmethod
    def of(cls, functions: CostFunctions) -> Pieces:
        """The pieces of all terms over the state."""
        inputs = functions.state.sx_in()
        r, terms = functions.state(*inputs), np.array(functions.state_terms, dtype=int)
        made: list[ca.Function] = []
        at: list[int] = []

        def add(output: ca.SX, place: int) -> None:
            made.append(ca.Function(f"octo_piece_{len(made)}", inputs, [output], {"cse": True}))
            at.append(place)

        own = {int(term): np.flatnonzero(terms == term) for term in dict.fromkeys(terms.tolist())}
        for rows in own.values():
            add(r[rows.tolist()], int(rows[0]))
        values, count, first = len(made), 0, 0
        entry_rows, entry_columns = [], []
        for group in inputs[:4]:
            for rows in own.values():
                jac = ca.jacobian(r[rows.tolist()], group)
                if jac.nnz():
                    add(ca.vertcat(*jac.nonzeros()), count)
                    entry_rows += [int(rows[k]) for k in jac.sparsity().row()]
                    entry_columns += [first + k for k in jac.sparsity().get_col()]
                    count += jac.nnz()
            first += group.numel()
        return cls(made, at, values, np.array(entry_rows, dtype=int), np.array(entry_columns, dtype=int))

    def text(self) -> str:
        """C text that calls piece k; the functions stand before it."""
        cases = " ".join(f"case {k}: octo_piece_{k}(arg, res, iw, w, 0); break;" for k in range(len(self.functions)))
        return "\n".join([
            f"#define PIECES {len(self.functions)}", f"#define VALUES {self.values}",
            f"static const int octo_piece_at[] = {{{', '.join(map(str, self.at)) or '0'}}};",
            "static void octo_piece(int k, const double **arg, double **res, int *iw, double *w) {",
            f"  switch (k) {{ {cases} }}", "}", "",
        ])  # fmt: skip
