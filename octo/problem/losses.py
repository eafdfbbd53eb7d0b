"""Losses: what of a residual counts in E. Without one it is its square.

    E = weight/scale · mean of Σ ρ(r),   ρ(r) = root(r)²

A loss says its signed root, so that every part of the solver sees a residual whose square it is:
Gauss and Newton's model of E is that of the rooted residual, and stays positive definite for every
loss. A new loss is a subclass of :class:`Loss` in a file of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from octo.checks import positive
from octo.errors import ProblemError


@dataclass(frozen=True)
class Loss:
    """What is put around each number of a term's residual: ``octo.Slip(loss=octo.Huber(0.05))``."""

    def references(self) -> Mapping[str, Any]:
        """Run-time numbers by name, each (size,): changing them recompiles nothing."""
        return {}

    def root(self, r: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        """The signed root of ρ, of every number of ``r`` on its own; zero at zero.

        Parameters
        ----------
        r: a residual. p: the references by name.
        """
        raise ProblemError(f"{type(self).__name__}.root is missing: write root(self, r, p)")


@dataclass(frozen=True)
class Huber(Loss):
    """Squares up to ``width``, in the residual's own unit, and lines beyond: r² or 2·width·|r| −
    width².

    Few large residuals then count less: a step that the motion has to take is not spread over those
    around it.
    """

    width: float = 1.0

    def references(self) -> Mapping[str, Any]:
        return {"width": np.array([positive("Huber.width", self.width)])}

    def root(self, r: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        far = ca.fmax(ca.fabs(r), p["width"])
        line = ca.sign(r) * ca.sqrt(p["width"] * (2.0 * far - p["width"]))
        return ca.if_else(ca.fabs(r) <= p["width"], r, line)
