"""What a term of E is (§5): one small class per term; it says its residual, CasADi says its
derivative.

    E = Σ_terms weight/scale · mean over the steps of |residual|²

(steps="last": the last step alone). Terms over bodies, joints and contacts have a file each.

Weights and references are run-time numbers, constant or one row per step: changing them recompiles
nothing. A new term is a subclass of :class:`Cost` with a residual, its references and, if its size
is physical, a scale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

import casadi as ca
import numpy as np

from octo.checks import Array, instance, number, one_of, owned, positive, shares, vectors
from octo.errors import ProblemError
from octo.problem.asked import Asked, Motion
from octo.problem.losses import Loss

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols

LOSS = "loss."  # how the names of a loss's references begin
Steps = Literal["all", "last"]
Curvature = Literal["gauss_newton", "exact"]
FLOOR = 0.1**2  # of every scale, so that a target of zero stays defined


@dataclass(frozen=True, eq=False, kw_only=True)
class Cost:
    """A term of E.

    Parameters
    ----------
    weight: a number, or one per step (N,).
    steps: "all", or "last" for the last step alone.
    name: what reports and ``Controller.update`` call it; by default the class's name.
    loss: what is put around each number of its residual; by default its square counts.
    curvature: what the solver's model of E has of the term once E has settled: Gauss and
        Newton's, which leaves out how its residual bends, or the exact second derivative. Of terms
        over contacts, and of a residual's way through the torques, it is exact either way.
    """

    # "bounded": its rows are no squares of E; a solver gives each a weight and a shift of its own
    # at every iterate (CompiledProblem.set_row_weights)
    kind: ClassVar[Literal["square", "bounded"]] = "square"

    weight: float | Array = 1.0
    steps: Steps = "all"
    name: str = ""
    loss: Loss | None = None
    curvature: Curvature = "gauss_newton"

    def __post_init__(self) -> None:
        for each in fields(self):  # the caller's arrays, lists and dicts stay the caller's
            object.__setattr__(self, each.name, owned(getattr(self, each.name)))
        kind = type(self).__name__
        for name in ("name", *(("body",) if getattr(self, "body", None) is not None else ())):
            instance(f"{kind}.{name}", getattr(self, name), str, "a text")
        one_of(f"{self.label}.steps", self.steps, ("all", "last"))
        one_of(f"{self.label}.kind", self.kind, ("square", "bounded"))
        one_of(f"{self.label}.curvature", self.curvature, get_args(Curvature))
        if self.loss is not None:
            instance(f"{self.label}.loss", self.loss, Loss, "an octo.Loss")

    @property
    def label(self) -> str:
        """The name the term goes by in reports and in ``Controller.update``."""
        return self.name or type(self).__name__

    def references(self, setting: Setting) -> Mapping[str, Any]:
        """Run-time numbers by name, each (size,) or (N, size)."""
        del setting
        return {}

    def scale(self, setting: Setting) -> float:
        """The fixed number E's term is divided by."""
        del setting
        return 1.0

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        """The residual of one time step, from its symbols and this term's references."""
        raise ProblemError(f"{self.label}.residual is missing: write residual(self, step, p)")

    def shaped(self, residual: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        """(rows,) what E has the squares of: the residual, with the loss around it.

        Parameters
        ----------
        residual: of this term. p: its references by name.
        """
        r = ca.densify(ca.vec(ca.SX(residual)))
        if self.loss is None:
            return r
        own = {name.removeprefix(LOSS): p[name] for name in p if name.startswith(LOSS)}
        return ca.densify(self.loss.root(r, own))

    def check_square(self, why: str) -> None:
        """Refuse rows that a solver weights itself, where there are none because of ``why``.

        Raises
        ------
        ProblemError: the term's kind is not "square".
        """
        if self.kind != "square":
            raise ProblemError(f"{self.label} {why}: its kind is {self.kind!r}, must be 'square'")

    def _vector(self, name: str, size: int) -> Array:
        """A field as finite numbers, (size,) or (N, size)."""
        return vectors(f"{self.label}.{name}", getattr(self, name), size)

    def _roots(self, name: str, size: int) -> Array:
        """The square roots of a field of weights, (size,) or (N, size)."""
        return np.sqrt(shares(f"{self.label}.{name}", getattr(self, name), size))

    def _number(self, name: str) -> Array:
        """(1,) of a field that is a number."""
        return np.array([number(f"{self.label}.{name}", getattr(self, name))])

    def _inverse(self, name: str, unit: str = "") -> Array:
        """(1,) one over a field that is a positive number in ``unit``."""
        return np.array([1.0 / positive(f"{self.label}.{name}", getattr(self, name), unit)])

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

    def between(self, control: ca.SX, control_next: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        return self._given("c, c_next, p")(control, control_next, p)


@dataclass(frozen=True, eq=False)
class StepPairCost(Cost):
    """A term over two steps in a row, i and i−1, such as the rate of a torque.

    Step 0 has none before it and no residual; in a cycle the last step, carried back by a stride,
    comes before it.
    """

    def pair_residual(
        self, step: StepSymbols, before: StepSymbols, p: Mapping[str, ca.SX]
    ) -> ca.SX:
        """The residual of a step and the one before it, from their symbols and this term's
        references."""
        raise ProblemError(
            f"{self.label}.pair_residual is missing: write pair_residual(self, step, before, p)"
        )
