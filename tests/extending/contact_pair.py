"""A term over a pair of contacts: two feet carry the same load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

import octo


@dataclass(frozen=True, eq=False)
class EqualLoads(octo.Cost):
    """The difference of the normal forces of two contacts (mg), and of their heights (m)."""

    pair: tuple[str, str] = ("", "")

    def residual(self, step: octo.costs.StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        one, other = (step.contact(name) for name in self.pair)
        return ca.vertcat(one.normal_force - other.normal_force, one.height - other.height)
