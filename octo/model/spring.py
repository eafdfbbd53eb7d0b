"""A spring and a damper between points of two bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from octo.errors import ModelError
from octo.model.element import Element

# m, added in squares to the length: the direction is singular where the points are one
SHORTEST = 1e-4


@dataclass(frozen=True)
class SpringDamper(Element):
    """f = -[stiffness·(l - rest_length) + damping·dl/dt] along the line from point a to point b.

    ``octo.SpringDamper("trunk", (0, 0, 0), None, (0, 0, 1), stiffness=200, damping=5)`` hangs the
    trunk's origin on a point 1 m above the ground. l is √(distance² + (0.1 mm)²).
    """

    stiffness: float = 0.0  # N/m
    damping: float = 0.0  # N s/m
    rest_length: float = 0.0  # m

    prefix: ClassVar[str] = "spring"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in self.parameters.items():
            if value < 0.0:
                raise ModelError(f"element SpringDamper: {name} is {value}, must not be negative")

    def force(
        self, p_a: ca.SX, v_a: ca.SX, p_b: ca.SX, v_b: ca.SX, p: Mapping[str, ca.SX]
    ) -> ca.SX:
        apart = p_b - p_a
        length = ca.sqrt(ca.dot(apart, apart) + SHORTEST**2)
        rate = ca.dot(apart, v_b - v_a) / length
        tension = p["stiffness"] * (length - p["rest_length"]) + p["damping"] * rate
        return -tension * apart / length

    @property
    def tendon(self) -> Mapping[str, float]:
        own = {"stiffness": self.stiffness, "damping": self.damping}
        return own | {"springlength": self.rest_length}
