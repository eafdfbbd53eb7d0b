"""The ground as a signed distance φ(P), positive above it: a plane, or any CasADi expression.

The outward normal of Eq. 6 is ∇φ, normalised. Terrain parameters are run-time parameters: changing
them recompiles nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from octo.checks import Array, instance, number
from octo.errors import ProblemError, ValueRangeError, said
from octo.interrupts import postponed

# names of a plane's numbers among the run-time parameters of the dynamics
OF_PLANE = tuple(f"terrain.{name}" for name in ("normal_x", "normal_y", "normal_z", "height"))


@dataclass(frozen=True)
class Plane:
    """A plane through (0, 0, height) whose outward normal is tilted by ``slope`` rad.

    ``direction`` (rad from the x axis) is the horizontal direction in which the plane rises.
    """

    slope: float = 0.0  # rad
    direction: float = 0.0  # rad
    height: float = 0.0  # m

    def __post_init__(self) -> None:
        for name in ("slope", "direction", "height"):
            number(f"terrain {name}", getattr(self, name))
        if not abs(self.slope) < np.pi / 2:
            raise ValueRangeError(
                f"terrain slope is {self.slope} rad, must be between -π/2 and π/2"
            )

    @property
    def parameters(self) -> Mapping[str, float]:
        level = -np.sin(self.slope)
        normal = {"normal_x": level * np.cos(self.direction)}
        normal |= {"normal_y": level * np.sin(self.direction), "normal_z": np.cos(self.slope)}
        return {**normal, "height": self.height}

    @staticmethod
    def distance(point: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        """Signed distance of ``point`` (3,) m."""
        level = p["normal_x"] * point[0] + p["normal_y"] * point[1]
        return level + p["normal_z"] * (point[2] - p["height"])


def plane_of(parameters: Mapping[str, float]) -> tuple[Array, float] | None:
    """Normal (3,) and height (m) of the ground that run-time parameters of the dynamics describe;
    None where it is no plane."""
    if not all(name in parameters for name in OF_PLANE):
        return None
    *axes, height = (float(parameters[name]) for name in OF_PLANE)
    return np.array(axes), height


@dataclass(frozen=True, eq=False)
class Terrain:
    """A user-written signed distance.

    Parameters
    ----------
    expression: ``expression(point, p) -> SX``, with ``point`` (3,) in metres and ``p`` the named
        parameters below. It must be twice continuously differentiable with a gradient of length
        near one close to the surface.
    parameters: names and default values of the run-time parameters.
    """

    expression: Callable[[ca.SX, Mapping[str, ca.SX]], ca.SX]
    parameters: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not callable(self.expression):
            raise ProblemError(
                f"terrain is {said(self.expression)}, must be a function (point, p) of CasADi "
                "symbols"
            )
        given = instance("terrain parameters", self.parameters, Mapping, "numbers by name")
        values = {name: number(f"terrain {name}", value) for name, value in given.items()}
        object.__setattr__(self, "parameters", values)

    def distance(self, point: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        return self.expression(point, p)


@postponed()
def signed_distance(terrain: Plane | Terrain, points: Array, values: Mapping[str, float]) -> Array:
    """φ (k,) m at points (k, 3) m, with the terrain's parameters by name."""
    point, p = ca.SX.sym("point", 3), {name: ca.SX(value) for name, value in values.items()}
    phi = ca.Function("phi", [point], [ca.SX(terrain.distance(point, p))])
    return np.asarray(phi(points.T), dtype=float).reshape(len(points))


@postponed()
def normal(terrain: Plane | Terrain, point: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
    """Outward unit normal ∇φ/|∇φ| (3,) at ``point``."""
    if isinstance(terrain, Plane):
        return ca.vertcat(p["normal_x"], p["normal_y"], p["normal_z"])
    # the point itself may be an expression, which CasADi cannot differentiate by
    free = ca.SX.sym("point", 3)
    gradient = ca.substitute(ca.gradient(terrain.distance(free, p), free), free, point)
    return gradient / ca.norm_2(gradient)
