"""Terms over two steps in a row (StepPairCost) as CasADi functions of four nodes and two torques,
and as the tables that step_pairs.c works from.

The inputs are x_{i+1}, x_i, x_{i−1}, x_{i−2}, u_i, u_{i−1}, p, q. The slopes are with respect to
the window of four nodes and to the two torques; what these add to the window comes with the slopes
of FD of two steps, dr/dwindow = r_z + r_u U_i + r_ub U_{i−1}.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources

import casadi as ca

from octo.dynamics.codegen import check_curvature, lanes_text
from octo.dynamics.long import check_length
from octo.errors import ProblemError
from octo.problem.basis import WINDOW, Basis, Folded, Nodes, PairedNodes, basis_named
from octo.problem.costs import Cost, StepPairCost
from octo.problem.curvature import HINT, StateCurvature, gated, nonzeros
from octo.problem.lane_tables import tables_text
from octo.problem.references import References, blamed, sizes
from octo.problem.symbols import StepSymbols


def has_step_pairs(terms: Sequence[Cost]) -> bool:
    """Whether a term looks at two steps in a row."""
    return any(isinstance(term, StepPairCost) for term in terms)


def refuse_step_pairs(terms: Sequence[Cost], what: str) -> None:
    """Raise where a term looks at two steps in a row, which ``what`` cannot have.

    Raises
    ------
    ProblemError: naming the term.
    """
    for term in terms:
        if isinstance(term, StepPairCost):
            raise ProblemError(
                f"{term.label} looks at two steps in a row, which {what} cannot have: leave it out"
            )


def basis_of(name: str | Basis, terms: Sequence[Cost], cycle: bool) -> Basis:
    """The basis in which a problem with these terms is solved.

    Raises
    ------
    UnknownNameError: no such basis. ProblemError: that of a cycle, without one.
    """
    pairs = has_step_pairs(terms)
    if cycle:
        return Folded(2 if pairs else 1)
    named = basis_named(name)
    if isinstance(named, Folded):
        raise ProblemError("basis is that of a cycle: give cycle=octo.Cycle(…), and no basis")
    return PairedNodes() if pairs and isinstance(named, Nodes) else named


@dataclass(frozen=True, eq=False)
class PairResiduals:
    """Residuals of two steps in a row as expressions.

    Attributes
    ----------
    inputs: x_next, x, x_prev, x_older, u, u_before, p, q. rows: of each term; terms: their indices.
    exact: the indices of those whose second derivatives are.
    """

    inputs: list[ca.SX]
    rows: list[ca.SX]
    terms: list[int]
    exact: Collection[int]

    @cached_property
    def value(self) -> ca.Function:
        """inputs -> all residuals."""
        r = ca.densify(ca.vertcat(*self.rows))
        return ca.Function("octo_step_pair", self.inputs, [r], {"cse": True})

    def derived(self) -> PairFunctions:
        """The functions of the residuals and of their first derivatives."""
        terms = [k for k, r in zip(self.terms, self.rows, strict=True) for _ in range(r.numel())]
        r = ca.densify(ca.vertcat(*self.rows))
        jac = ca.jacobian(r, ca.vertcat(*self.inputs[: WINDOW + 2]))
        slopes = self._function("octo_step_pair_jac", r, nonzeros(jac))
        what = "terms over two steps in a row"
        check_length(what, slopes.n_instructions(), "write them in fewer operations")
        second, curvature = self._second(), None
        if second.nnz():
            bend = self._function("octo_step_pair_bend", nonzeros(second))
            curvature = StateCurvature(bend, second.sparsity())
        return PairFunctions(self.value, slopes, jac.sparsity(), tuple(terms), curvature)

    def _second(self) -> ca.SX:
        """The upper triangle of Σ 2 c r ∂²r/∂(window, u, u_before)² of the exact ones, zero where c
        is: a step that a term leaves out may have no finite residual."""
        over = ca.vertcat(*self.inputs[: WINDOW + 2])
        whole = ca.SX(over.numel(), over.numel())
        for k, r in zip(self.terms, self.rows, strict=True):
            if k in self.exact:
                held, (p, q) = ca.SX.sym("held", r.numel()), self.inputs[WINDOW + 2 :]
                pulled, c = ca.dot(held, r), q[k]
                what = "second derivatives of terms over two steps in a row"
                check_curvature(what, [over, held, p, q], ca.gradient(pulled, over), HINT)
                whole += gated(ca.triu(ca.hessian(pulled, over)[0]), held, 2.0 * c * r, c)
        return whole

    def _function(self, name: str, *out: ca.SX) -> ca.Function:
        return ca.Function(name, self.inputs, list(out), {"cse": True})


@dataclass(frozen=True, eq=False)
class PairFunctions:
    """The terms over two steps in a row, ready to be evaluated and written as C.

    Attributes
    ----------
    value: inputs -> r. slopes: inputs -> r, nonzeros of dr/d(window, u, u_before), at ``sparsity``.
    terms: of each row. curvature: what exact terms have beside Gauss and Newton's model; None where
        there is nothing.
    """

    value: ca.Function
    slopes: ca.Function
    sparsity: ca.Sparsity
    terms: tuple[int, ...]
    curvature: StateCurvature | None

    @property
    def rows(self) -> int:
        return len(self.terms)

    @property
    def tables(self) -> str:
        """Sizes as macros and index tables, in C that is CUDA too."""
        bends = ca.Sparsity(0, 0) if self.curvature is None else self.curvature.sparsity
        sizes = {"ROWS": self.rows, "ENTRIES": self.sparsity.nnz(), "BENDS": bends.nnz()}
        places = {
            "row_term": self.terms,
            "entry_row": self.sparsity.row(),
            "entry_column": self.sparsity.get_col(),
            "bend_row": bends.row(),
            "bend_column": bends.get_col(),
        }
        return tables_text(
            {f"PAIR_{name}": size for name, size in sizes.items()},
            {f"pair_{name}": place for name, place in places.items()},
        )

    @property
    def c_text(self) -> str:
        """With a time step in every lane; stands before assemble.c."""
        own = [self.value, self.slopes]
        own += [] if self.curvature is None else [self.curvature.function]
        made = [lanes_text(function, {6}) for function in own]  # shared: p
        text = (resources.files("octo.problem") / "step_pairs.c").read_text(encoding="utf-8")
        return "\n".join([*made, self.tables, text])


def pair_residuals(
    references: References,
    nodes: list[ca.SX],
    step: StepSymbols,
    p: ca.SX,
    q: ca.SX,
    exact: Collection[int] = (),
) -> PairResiduals | None:
    """Of all such terms; None where there is none.

    Parameters
    ----------
    nodes: x_next, x, x_prev, u of a step; step: what a term sees of them. exact: indices of the
        terms whose second derivatives are.
    """
    if not has_step_pairs(references.terms):
        return None
    x_next, x, x_prev, u = nodes
    x_older, u_before = ca.SX.sym("x_older", x.numel()), ca.SX.sym("u_before", u.numel())
    now = replace(step, calls=[])
    before = replace(step, x_next=x, x=x_prev, x_prev=x_older, u=u_before, calls=now.calls)
    inputs = [x_next, x, x_prev, x_older, u, u_before, p, q]
    made = PairResiduals(inputs, [], [], exact)
    for k, term in enumerate(references.terms):
        if isinstance(term, StepPairCost):
            term.check_square("looks at two steps in a row")
            view = references.view(q, k)
            with blamed(term, f"its residual cannot be built from {sizes(references, k)}"):
                made.rows.append(term.shaped(term.pair_residual(now, before, view), view))
            if now.calls:
                raise ProblemError(
                    f"{term.label} looks at two steps in a row, which cannot call stages of code: "
                    f"{now.calls[0].stage.name!r}"
                )
            made.terms.append(k)
    return made
