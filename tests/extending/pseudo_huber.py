"""A smooth relative of Huber's loss: 2·width²·(√(1 + (r/width)²) − 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

import octo


@dataclass(frozen=True)
class PseudoHuber(octo.Loss):
    width: float = 0.1

    def references(self) -> Mapping[str, np.ndarray]:
        return {"width": np.array([self.width])}

    def root(self, r: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        return r * ca.sqrt(2.0 / (1.0 + ca.sqrt(1.0 + (r / p["width"]) ** 2)))
