"""What a term of E is (§5): one small class per term; it says its residual, CasADi says its
derivative.

    E = Σ_terms weight/scale · mean over its steps of |residual|²

(at="all": all steps). Terms over bodies, joints and contacts have a file each.

Weights and references are run-time numbers, constant or one row per step: changing them recompiles
nothing. A new term is a subclass of :class:`Cost` with a residual, its references and, if its size
is physical, a scale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca
import numpy as np

from octo.checks import Array, instance
from octo.errors import ProblemError
from octo.problem.asked import Asked, Motion
from octo.problem.at import Steps, always, check_at
from octo.problem.constraints import Constraint, Equality
from octo.problem.losses import Loss
from octo.problem.terms import Term

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols

LOSS = "loss."  # how the names of a loss's references begin
FLOOR = 0.1**2  # of every scale, so that a target of zero stays defined


@dataclass(frozen=True, eq=False, kw_only=True)
class Cost(Term):
    """A term of E.

    Parameters
    ----------
    weight: a number, or one per step (N,).
    at: when it acts: "all" steps, the "last" one, a list of steps from 0 (from the end where they
        are negative), a mask of one truth for each, or times as ``octo.At(seconds)``. E has its
        mean over these steps.
    steps: the old name of ``at``, which takes it over where it is given; None afterwards.
    name: what reports and ``Controller.update`` call it; by default the class's name.
    loss: what is put around each number of its residual; by default its square counts.
    curvature: what the solver's model of E has of the term once E has settled: Gauss and
        Newton's, which leaves out how its residual bends, or the exact second derivative. Of terms
        over contacts, and of a residual's way through the torques, it is exact either way.
    """

    weighed_by: ClassVar[str] = ""  # the reference whose entries weigh a row each, if any

    weight: float | Array = 1.0
    steps: Steps | None = None
    loss: Loss | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.steps is not None:
            check_at(f"{self.label}.steps", self.steps)
            object.__setattr__(self, "at", self.steps)
            object.__setattr__(self, "steps", None)
        if self.loss is not None:
            instance(f"{self.label}.loss", self.loss, Loss, "an octo.Loss")

    def scale(self, setting: Setting) -> float:
        """The fixed number E's term is divided by."""
        del setting
        return 1.0

    def shaped(self, residual: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        """(rows,) what E has the squares of: the residual, with the loss around it.

        Parameters
        ----------
        residual: of this term. p: its references by name.
        """
        r = super().shaped(residual, p)
        if self.loss is None:
            return r
        own = {name.removeprefix(LOSS): p[name] for name in p if name.startswith(LOSS)}
        return ca.densify(self.loss.root(r, own))

    def hard(self) -> Constraint:
        """The constraint that the term means in a problem's ``constraints``: its residual is zero.

        Raises
        ------
        ProblemError: it has none.
        """
        self.check_square("has no hard form")
        return Equality(self, self.weighed_by, **self._kept())

    def _kept(self) -> dict[str, Any]:
        """What a hard form takes over.

        Raises
        ------
        ProblemError: the term has a loss, which no hard form has.
        """
        if self.loss is not None:
            raise ProblemError(
                f"{self.label} has a loss and is a constraint: a loss has no hard form, leave it "
                "out"
            )
        return {"name": self.label, "at": self.at}

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        """What the term asks of a motion as a whole, and what came of it; None of a term that asks
        for nothing special."""
        del motion, setting
        return None


@dataclass(frozen=True, eq=False, kw_only=True)
class SizedCost(Cost):
    """A term of a list that no length was given to: the Problem that gets it puts ``make(length,
    times)`` in its place.

    ``weight`` is over the weight that the term has there.
    """

    make: Callable[[float, Array], Cost]

    def hard(self) -> Constraint:
        raise ProblemError(
            f"{self.label} of a list without length=… has no hard form: give the term itself"
        )

    def sized(self, length: float, times: Array) -> Cost:
        """The term of a robot of ``length`` ℓ (m), at ``times`` (N,) s."""
        made = self.make(length, times)
        weight = (
            made.weight
            if np.all(np.equal(self.weight, 1.0))
            else np.multiply(made.weight, self.weight)
        )
        return replace(
            made,
            weight=weight,
            name=made.name if self.name == made.label else self.name,
            at=made.at if always(self.at) else self.at,
            loss=made.loss if self.loss is None else self.loss,
            curvature=made.curvature if self.curvature == "gauss_newton" else self.curvature,
        )


def last_row(values: Any) -> Array:
    return np.atleast_2d(np.asarray(values, dtype=float))[-1]


def mean_square(values: Any) -> float:
    """The mean of |row|² over rows (N, size), or of one row (size,), at least ``FLOOR``: a
    scale."""
    rows = np.atleast_2d(np.asarray(values, dtype=float))
    return max(float(np.mean(np.sum(rows**2, axis=-1))), FLOOR)


@dataclass(frozen=True, eq=False)
class FunctionCost(Cost):
    """A term whose residual is a function that the user gives, with its references by name."""

    function: Callable[..., ca.SX] | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    fixed_scale: float = 1.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return self.values

    def scale(self, setting: Setting) -> float:
        return self.fixed_scale

    def _given(self, arguments: str) -> Callable[..., ca.SX]:
        """The function, whose ``arguments`` a message names."""
        if self.function is None:
            raise ProblemError(
                f"{self.label}.function is missing: give function({arguments}) -> casadi.SX"
            )
        return self.function


@dataclass(frozen=True, eq=False)
class CustomCost(FunctionCost):
    """Any residual over (x_next, x, x_prev, u, p) written in CasADi.

    ``function(step, p) -> SX`` gets a :class:`~octo.problem.symbols.StepSymbols` and the references
    below by name.
    """

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return self._given("step, p")(step, p)


@dataclass(frozen=True, eq=False)
class NeighbourCost(FunctionCost):
    """A residual over neighbouring controls, ``function(c, c_next, p) -> SX`` (DESIGN: the pattern
    does not change).

    In the nodes basis c_i = (x_i, x_i − x_{i−1}); in the Hermite basis c_k = (x_k, τ ẋ_k), c_0
    included.
    """

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        """In the nodes basis the two controls are made of one step's three configurations."""
        before = ca.vertcat(step.x, step.x - step.x_prev)
        return self.between(before, ca.vertcat(step.x_next, step.x_next - step.x), p)

    def hard(self) -> Constraint:
        raise ProblemError(
            f"{self.label} is over neighbouring controls and has no hard form: use a "
            "CustomConstraint over x_next, x, x_prev, u"
        )

    def between(self, control: ca.SX, control_next: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        return self._given("c, c_next, p")(control, control_next, p)


@dataclass(frozen=True, eq=False)
class StepPairCost(Cost):
    """A term over two steps in a row, i and i−1, such as the rate of a torque.

    Step 0 has none before it and no residual; in a cycle the last step, carried back by a stride,
    comes before it.
    """

    def hard(self) -> Constraint:
        raise ProblemError(
            f"{self.label} is over two steps in a row and has no hard form, must be a term over a "
            "step"
        )

    def pair_residual(
        self, step: StepSymbols, before: StepSymbols, p: Mapping[str, ca.SX]
    ) -> ca.SX:
        """The residual of a step and the one before it, from their symbols and this term's
        references."""
        raise ProblemError(
            f"{self.label}.pair_residual is missing: write pair_residual(self, step, before, p)"
        )
