"""Reduced deformable bodies (§3.3): an elastic body by its lowest modes, and its dynamics."""

from __future__ import annotations

from octo.soft.body import Body as Body
from octo.soft.dynamics import SoftDynamics as SoftDynamics

__all__ = ["Body", "SoftDynamics"]
