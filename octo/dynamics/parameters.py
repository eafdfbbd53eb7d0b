"""The run-time parameters p of the dynamics: names, defaults and places in one flat vector.

Changing a value of p (time step, gravity, contact weights, terrain) never recompiles anything.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import casadi as ca
import numpy as np

from octo.checks import number
from octo.errors import ProblemError, UnknownNameError
from octo.model.quantities import GRAVITY, Array
from octo.model.terrain import ADDRESS, Ground, World, address_of, world_at

T = TypeVar("T")

COMMON: Mapping[str, float] = {
    "dt": 0.025,  # s
    "gravity_x": 0.0,  # m/s²
    "gravity_y": 0.0,
    "gravity_z": -GRAVITY,
    "w_joint": 1e3,  # N m/rad² (N/m² of a slide), penalty of joint limits
    "w_self": 1e5,  # N/m², penalty of sphere pairs
    "pair_epsilon": 1e-3,  # m, pair distance is sqrt(d² + ε²)
}


@dataclass(frozen=True, eq=False)
class Layout:
    """Names and default values of p (NP,), in order."""

    names: tuple[str, ...]
    defaults: Array  # (NP,)

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.names):
            raise ProblemError(f"parameter names must differ: {', '.join(self.names)}")

    @classmethod
    def of(cls, values: Mapping[str, float]) -> Layout:
        defaults = [number(f"parameter {name}", value) for name, value in values.items()]
        return cls(tuple(values), np.array(defaults))

    @property
    def size(self) -> int:
        return len(self.names)

    @property
    def given(self) -> tuple[str, ...]:
        """The names that a user may give: all but where a world's numbers are, which is filled in
        where code reads it."""
        return tuple(name for name in self.names if name != ADDRESS)

    def named(self, p: Array) -> dict[str, float]:
        """Those entries of p (NP,) by name."""
        values = dict(zip(self.names, p.tolist(), strict=True))
        return {name: values[name] for name in self.given}

    def index(self, name: str) -> int:
        if name not in self.names:
            raise UnknownNameError("parameter", name, self.names)
        return self.names.index(name)

    def pack(self, **values: float) -> Array:
        """p (NP,) with the defaults where nothing is given; dotted names go in as
        ``pack(**{"contact.w_perp": 1e5})``."""
        p = self.defaults.copy()
        for name, value in values.items():
            p[self.index(name)] = value
        return p

    def view(self, p: ca.SX) -> dict[str, ca.SX]:
        """The entries of a symbolic p (NP,) by name."""
        return {name: p[k] for k, name in enumerate(self.names)}


def bound(layout: Layout, terrain: Ground, p: Array) -> Array:
    """p (..., NP) with the address of the world's numbers in this process, where the ground is a
    world; that of another member of a batch stays."""
    if not isinstance(terrain, World):
        return p
    place, own = layout.index(ADDRESS), np.array(p, dtype=float)
    known = np.array([world_at(a) is not None for a in own[..., place].ravel().tolist()])
    known = known.reshape(own.shape[:-1])
    own[..., place] = np.where(known, own[..., place], address_of(terrain))
    return own


def unbound(layout: Layout, terrain: Ground, p: Array) -> Array:
    """The same p without that."""
    own = np.array(p, dtype=float)
    if isinstance(terrain, World):
        own[..., layout.index(ADDRESS)] = 0.0
    return own


def section(view: Mapping[str, T], prefix: str) -> dict[str, T]:
    """The entries whose names start with ``prefix``, without it: a law's or a terrain's own
    parameters."""
    return {k.removeprefix(prefix): value for k, value in view.items() if k.startswith(prefix)}


def robot_layout(
    law: Mapping[str, float],
    terrain: Mapping[str, float],
    elements: Mapping[str, float] | None = None,
) -> Layout:
    """p of a robot: the common entries, the contact law's, the terrain's, those of its elements."""
    values = dict(COMMON)
    values.update({f"contact.{name}": value for name, value in law.items()})
    values.update({f"terrain.{name}": value for name, value in terrain.items()})
    values.update(elements or {})
    return Layout.of(values)
