"""The ground as a signed distance φ(P), positive above it: a plane, any CasADi expression, or a
world of shapes.

The outward normal of Eq. 6 is ∇φ, normalised. Terrain parameters are run-time parameters: changing
them recompiles nothing. A world is looked up by code (octo/world): φ is an expression of its jet,
the value and the derivatives that the look-up gave.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from weakref import WeakValueDictionary

import casadi as ca
import numpy as np

from octo.checks import Array, instance, number, positive
from octo.errors import ProblemError, ValueRangeError, said
from octo.interrupts import postponed
from octo.world.jet import polynomial
from octo.world.world import World

# names of a plane's numbers among the run-time parameters of the dynamics
OF_PLANE = tuple(f"terrain.{name}" for name in ("normal_x", "normal_y", "normal_z", "height"))
# where a world's numbers are in the memory of this process or device (octo_world in world/query.c);
# filled in where p is handed over (RobotDynamics.bound), for it means nothing elsewhere
ADDRESS = "terrain.address"


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

    @property
    def steepest(self) -> float:
        return 1.0

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
    steepest: an upper bound of the gradient's length, also away from the surface: contacts of a
        body with many are looked for within that (octo/dynamics/crowd.py). The default is enough
        for heights z − h(x, y) whose slopes are below 48°.
    """

    expression: Callable[[ca.SX, Mapping[str, ca.SX]], ca.SX]
    parameters: Mapping[str, float] = field(default_factory=dict)
    steepest: float = 1.5

    def __post_init__(self) -> None:
        if not callable(self.expression):
            raise ProblemError(
                f"terrain is {said(self.expression)}, must be a function (point, p) of CasADi "
                "symbols"
            )
        positive("terrain steepest", self.steepest)
        given = instance("terrain parameters", self.parameters, Mapping, "numbers by name")
        values = {name: number(f"terrain {name}", value) for name, value in given.items()}
        object.__setattr__(self, "parameters", values)

    def distance(self, point: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        return self.expression(point, p)


Ground = Plane | Terrain | World


def own_parameters(terrain: Ground) -> Mapping[str, float]:
    """The run-time parameters of a ground by name, with their defaults."""
    return {"address": 0.0} if isinstance(terrain, World) else terrain.parameters


def looked(view: Mapping[str, ca.SX], jet: ca.SX, at: ca.SX) -> dict[str, ca.SX]:
    """Parameters of the dynamics and what a world says (20,) at a place ``at`` (3,) m: φ is known
    near it, so it must be the point that is asked about, and its derivatives are zero."""
    return {**view, "terrain.jet": jet, "terrain.at": at}


def distance(terrain: Ground, point: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
    """φ (m) at ``point`` (3,) m, with the ground's parameters by name, and of a world its jet
    (:func:`looked`)."""
    if isinstance(terrain, World):
        return polynomial(p["jet"], point - p["at"])
    return ca.SX(terrain.distance(point, p))


@postponed()
def distances(terrain: Ground, values: Mapping[str, float]) -> Callable[[Array], Array]:
    """φ (k,) m of points (k, 3) m, with the terrain's parameters by name."""
    if isinstance(terrain, World):
        return terrain.distance
    point, p = ca.SX.sym("point", 3), {name: ca.SX(value) for name, value in values.items()}
    phi = ca.Function("phi", [point], [ca.SX(terrain.distance(point, p))])
    return lambda points: np.asarray(phi(points.T), dtype=float).reshape(len(points))


def signed_distance(terrain: Ground, points: Array, values: Mapping[str, float]) -> Array:
    """φ (k,) m at points (k, 3) m, with the terrain's parameters by name."""
    return distances(terrain, values)(points)


def distance_and_normal(world: World, points: Array) -> tuple[Array, Array]:
    """φ (k,) m and the outward unit normal (k, 3) of a world at points (k, 3) m."""
    jets = world.jets(points, 1)
    return jets[:, 0], jets[:, 1:] / np.linalg.norm(jets[:, 1:], axis=1, keepdims=True)


# by the address of their data, those that are in use
_worlds: WeakValueDictionary[float, World] = WeakValueDictionary()


def address_of(world: World) -> float:
    """Where a world's numbers are in this process, as a number of p: exact, for an address has
    fewer than 53 bits."""
    address = float(world.data.ctypes.data)
    _worlds[address] = world
    return address


def world_at(address: float) -> World | None:
    """The world that :func:`address_of` gave an address of, while it is in use."""
    return _worlds.get(address)


@postponed()
def normal(terrain: Ground, point: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
    """Outward unit normal ∇φ/|∇φ| (3,) at ``point``."""
    if isinstance(terrain, Plane):
        return ca.vertcat(p["normal_x"], p["normal_y"], p["normal_z"])
    # the point itself may be an expression, which CasADi cannot differentiate by
    free = ca.SX.sym("point", 3)
    gradient = ca.substitute(ca.gradient(distance(terrain, free, p), free), free, point)
    return gradient / ca.norm_2(gradient)
