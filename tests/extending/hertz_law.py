"""Hertz's law for a sphere, f_n = stiffness·d^(3/2), with a rounded onset and viscous friction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class Hertz:
    stiffness: float = 3e4  # N/m^1.5
    width: float = 5e-3  # m, of the onset
    drag: float = 2.0  # s/m, of the normal force

    @property
    def parameters(self) -> Mapping[str, float]:
        return {"stiffness": self.stiffness, "width": self.width, "drag": self.drag}

    def reach(self, p: Mapping[str, ca.SX]) -> ca.SX:
        return 20.0 * p["width"]

    def force(self, depth: ca.SX, normal: ca.SX, velocity: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        d = 0.5 * (depth + ca.sqrt(depth**2 + p["width"] ** 2))
        load = p["stiffness"] * d**1.5
        slip = velocity - normal * ca.dot(normal, velocity)
        return load * (normal - p["drag"] * slip)
