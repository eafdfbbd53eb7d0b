"""A new element, in this file alone: a rubber band between two bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

import octo


@dataclass(frozen=True)
class RubberBand(octo.Element):
    """It pulls where it is longer than ``length``, with the cube of what it is longer, and slack it
    does nothing. It loses energy along the line and across it."""

    stiffness: float = 2e3  # N/m³
    loss: float = 0.3  # s/m
    length: float = 0.1  # m

    prefix: ClassVar[str] = "band"

    def force(
        self, p_a: ca.SX, v_a: ca.SX, p_b: ca.SX, v_b: ca.SX, p: Mapping[str, ca.SX]
    ) -> ca.SX:
        apart, slide = p_b - p_a, v_b - v_a
        length = ca.sqrt(ca.dot(apart, apart) + 1e-8)
        stretch = ca.if_else(length > p["length"], length - p["length"], 0.0)
        tension = p["stiffness"] * stretch**3
        return -tension * (apart / length + p["loss"] * slide)
