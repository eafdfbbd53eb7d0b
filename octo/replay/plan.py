"""A solution between its nodes: what a controller with shorter steps asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.feet import CARRYING
from octo.model.kinematics import body_poses
from octo.model.quantities import Array, interpolated
from octo.model.quaternions import quaternions, turning
from octo.model.terrain import Plane, plane_of
from octo.result.solution import Solution
from octo.world.world import World


@dataclass(frozen=True, eq=False)
class Plan:
    """A motion sampled every ``timestep`` s, in MuJoCo's form (octo.model.convention).

    Attributes
    ----------
    q (T+1, nq), v (T+1, nv): m, rad, m/s, rad/s.
    u (T+1, nu): N m or N.
    force: (T+1, c, 3) N, world axes, of the ground on each contact.
    stance (T+1, c): which of them carry.
    """

    character: Character
    timestep: float
    q: Array
    v: Array
    u: Array
    force: Array
    stance: NDArray[np.bool_]

    @staticmethod
    def of(solution: Solution, timestep: float) -> Plan:
        """Cubic through the nodes; torques and forces linear, as of the node around which their
        step's acceleration is.

        Raises
        ------
        ProblemError: user-written dynamics, which have no bodies.
        """
        character = solution.character
        if character is None:
            raise ProblemError(
                "replay needs a robot: a motion of user-written dynamics has no bodies"
            )
        duration = solution.steps * solution.dt
        times = np.asarray(timestep * np.arange(round(duration / timestep) + 1), dtype=float)
        path = CubicSpline(solution.times, solution.x[1:], axis=0)
        x = path(times)
        q, v = _moving(character, x, path(times, 1), timestep)
        place = times / solution.dt
        force = interpolated(solution.contact_force, place)
        normal = np.sum(force * interpolated(solution.contact_normal, place), axis=-1)
        stance = np.asarray(normal > CARRYING * solution.weight)
        u = interpolated(solution.u, place)
        return Plan(character, timestep, q, v, u, force, stance)

    @property
    def steps(self) -> int:
        return len(self.q) - 1


def _moving(character: Character, x: Array, rate: Array, timestep: float) -> tuple[Array, Array]:
    """q (T, nq) and v (T, nv) of x and its rate (T, nx), the base turned between the samples."""
    if character.base != "floating":
        return x, rate
    first = character.base_coordinate
    rotation, origin = (value[:, character.base_body] for value in body_poses(character, x))
    spin = turning(rotation) / timestep
    before, after = slice(0, first), slice(first + 6, None)
    q = np.concatenate([x[:, before], origin, quaternions(rotation), x[:, after]], axis=1)
    moved = rate[:, first : first + 3] @ character.bodies[character.base_body].rotation.T
    spun = np.append(spin, spin[-1:], axis=0)
    return q, np.concatenate([rate[:, before], moved, spun, rate[:, after]], axis=1)


def ground_of(solution: Solution) -> Plane | World:
    """The plane or the world that a solution was solved on.

    Raises
    ------
    ProblemError: its terrain is another one.
    """
    if solution.world is not None:
        return solution.world
    plane = plane_of(solution.parameters)
    if plane is None:
        raise ProblemError(
            "the plan's terrain is user-written, must be a plane or an octo.World: MuJoCo's plant "
            "has no other ground"
        )
    (x, y, z), height = plane
    return Plane(float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(-y, -x)), height)
