"""Everything a user may tune of the solver, with the reason of each default."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from octo.checks import instance, number, one_of, positive, whole
from octo.errors import ValueRangeError, said
from octo.solver.acceptance import Acceptance

CHOICES = {
    "hessian": ("exact", "dynamics", "gauss_newton"),
    "step": ("line_search", "trust_region", "levenberg_marquardt", "lbfgs"),
    "linear_solver": ("auto", "elimination", "cyclic_reduction"),
    "goal": ("optimal", "feasible"),
}
SOFT = ("levenberg_marquardt", "lbfgs")  # steps of soft constraints
# of the line search; the classes of octo.solver.heuristics say what each is worth
HEURISTICS = (
    "leap_damping",
    "local_damping",
    "extrapolation",
    "feasibility_step",
    "second_order_correction",
    "restoration",
)
TOLERANCES = ("tolerance", "step_tolerance", "dual_tolerance")
# steps for the constraints alone begin as early
FEASIBLE: dict[str, Any] = {"goal": "feasible", "plateau": 3, "plateau_change": 3e-2}
LOOSEST = 1.0  # of every tolerance: the weight, a radian, E of order one


@dataclass(frozen=True)
class SqpOptions:
    """How Algorithm 1 runs. The defaults are the exact-curvature line search; :meth:`paper` is the
    paper's own.

    Attributes
    ----------
    hessian: "exact" adds to JᵀJ the curvature of lamᵀC and of the torque terms, and once E has
        settled, of itself less than ``settled`` over ten iterations, that of the terms over
        contacts and of those whose ``curvature`` is "exact"; "dynamics" leaves these out;
        "gauss_newton" is JᵀJ.
    step: "line_search", a regularised KKT step accepted by a filter; "trust_region", §6.1; or of
        soft constraints (§8.4), E + ½ρ‖C‖² in place of C = 0: "levenberg_marquardt", or "lbfgs",
        SciPy's.
    penalty: ρ of soft constraints, of C in mg.
    goal: "optimal"; with "feasible" it is enough that bounds hold, to a millionth, where E is level
        (``plateau``): see :meth:`feasible`.
    gauss_newton_first: this many iterations of JᵀJ before the exact curvature is switched on.
    max_iterations: of one pass. time_limit: s, of all passes.
    tolerance: of ‖C‖∞ in mg (line_search), in N (trust_region). The default is 1e-5 N at 49 N of
        weight.
    step_tolerance: of ‖Δ‖∞ of the full KKT step, rad and m.
    dual_tolerance: of ‖∇E + Aᵀlam‖∞; E is of order one where nothing moves yet.
    cap: rad and m, largest change of one number in one step.
    first_sigma: the first regularisation weight that is tried when the inertia is wrong.
    linear_solver: of the KKT system: "elimination", "cyclic_reduction", or "auto", the first where
        nothing speaks against it.
    c_max: N, the paper's C_max: a step that ends above it is refused unless it reduces ‖C‖.
    plateau, plateau_change: "acceptable" when E changed by less than this part of itself over so
        many iterations.
    acceptance: which steps are taken: an :class:`octo.Acceptance`; None is the filter for
        line_search, and the paper's merit for trust_region. Those of soft constraints have their
        own.
    heuristics: of the line search, those of HEURISTICS that are on, by default all:
        octo.solver.heuristics says what each is worth.
    """

    hessian: Literal["exact", "dynamics", "gauss_newton"] = "exact"
    step: Literal["line_search", "trust_region", "levenberg_marquardt", "lbfgs"] = "line_search"
    gauss_newton_first: int = 0
    max_iterations: int = 3000
    time_limit: float = np.inf
    tolerance: float = 2e-7
    step_tolerance: float = 1e-3
    dual_tolerance: float = 1e-5
    cap: float = 1.0
    first_sigma: float = 1e-6
    linear_solver: Literal["auto", "elimination", "cyclic_reduction"] = "auto"
    c_max: float = 0.1
    plateau: int = 20
    plateau_change: float = 1e-4
    settled: float = 5e-3
    acceptance: Acceptance | None = None
    heuristics: tuple[str, ...] = HEURISTICS
    penalty: float = 10.0
    goal: Literal["optimal", "feasible"] = "optimal"

    def __post_init__(self) -> None:
        for name, values in CHOICES.items():
            one_of(name, getattr(self, name), values)
        for name in (*TOLERANCES, "cap", "first_sigma", "c_max", "penalty"):
            positive(name, getattr(self, name))
        for name in TOLERANCES:
            if (value := getattr(self, name)) > LOOSEST:
                most = f"must be at most {LOOSEST:g}: everything would converge"
                raise ValueRangeError(f"{name} is {said(value)}, {most}")
        if not (isinstance(self.time_limit, (float, np.floating)) and self.time_limit == np.inf):
            positive("time_limit", self.time_limit, "s")
        for name in ("plateau_change", "settled"):
            if not 0.0 <= number(name, getattr(self, name)) < 1.0:
                raise ValueRangeError(
                    f"{name} is {said(getattr(self, name))}, must be from 0 to less than 1"
                )
        for name, least in (("max_iterations", 1), ("plateau", 1), ("gauss_newton_first", 0)):
            whole(name, getattr(self, name), least)
        if self.acceptance is not None:
            instance("acceptance", self.acceptance, Acceptance, "an octo.Acceptance or None")
        if self.soft and self.goal != "optimal":
            told = f"goal is {self.goal!r}, must be 'optimal'"
            raise ValueRangeError(f"{told}: with step={self.step!r} no constraint is ever met")
        names = self.heuristics
        if isinstance(names, str) or not isinstance(names, (tuple, list, set, frozenset)):
            raise ValueRangeError(
                f"heuristics is {said(names)}, must be a tuple or a set of {', '.join(HEURISTICS)}"
            )
        for name in names:
            one_of("heuristics", name, HEURISTICS)

    @property
    def soft(self) -> bool:
        """Whether C = 0 is a term of the objective."""
        return self.step in SOFT

    @classmethod
    def feasible(cls, **changes: Any) -> SqpOptions:
        """A motion that satisfies all constraints, not the best one: it ends, "acceptable", once
        they are met and E changed by less than 3 % in three iterations. Of transitions of a second
        between two walks 24 of 24 end so after 36 iterations (median), 46 with bounds; of E to the
        end 2 of 12 within 300 (docs/transitions.md)."""
        return cls(**{**FEASIBLE, **changes})

    @classmethod
    def paper(cls, **changes: Any) -> SqpOptions:
        """§6.1 verbatim: JᵀJ, Φ = μ/2‖C‖² + E, Eq. 11, radius ∞ then ‖Δ‖, × 1.2 or 0.8‖Δ‖, C_max
        0.1, ε_E 1e-3, ε_C 1e-5.

        E is normalised as §8 says: E_obj is 1 at the start, E_reg is 1e-4‖u‖².
        """
        verbatim = cls(hessian="gauss_newton", step="trust_region", tolerance=1e-5)
        return replace(verbatim, **changes)
