"""A robot in octo's own simulation, with the interface of octo.plant.MujocoPlant."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from octo.checks import numbers, positive
from octo.dynamics.contact_numbers import contact_function, contact_numbers, many
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.dynamics.parameters import section
from octo.dynamics.simulate import Stepper, parameters_of
from octo.interrupts import postponed
from octo.model.character import Character
from octo.model.convention import from_chart, to_chart
from octo.model.kinematics import body_poses
from octo.model.quantities import Array
from octo.model.terrain import Ground, distances
from octo.plant.mujoco_plant import loaded


class SimulatorPlant:
    """``character`` under FD = Uᵀu, step by step.

    Parameters
    ----------
    law, terrain: of the contact; octo's defaults. parameters: of the dynamics by name.
    timestep: s. payload: mass added to the base body, relative to its mass.

    Torques act until the next ``step`` and are clipped to the robot's limits. ``unsolved`` counts
    the steps in which no
    solution was found: the best configuration is taken.
    """

    @postponed()
    def __init__(
        self,
        character: Character,
        *,
        law: ContactLaw | None = None,
        terrain: Ground | None = None,
        parameters: Mapping[str, float] | None = None,
        timestep: float = 0.005,
        payload: float = 0.0,
    ):
        self.dynamics = RobotDynamics(loaded(character, payload), law, terrain)
        self.character, self.timestep = character, positive("timestep", timestep, "s")
        self._p = parameters_of(
            self.dynamics, self.timestep, {} if parameters is None else parameters
        )
        self._stepper = Stepper(self.dynamics, self._p)
        self._limit = character.torque_limit
        self.terrain = self.dynamics.terrain
        self.push = np.zeros(3)  # (3,) N, world axes, at the origin of the base body
        self.unsolved, self.time = 0, 0.0
        self._ground = None if many(self.dynamics) else contact_function(self.dynamics)
        values = self.dynamics.layout.named(self._p)
        self._height = distances(self.dynamics.terrain, section(values, "terrain."))
        self.x = character.start_pose
        self._before = self.x.copy()

    @property
    def rate(self) -> Array:
        """(nx,) rad/s and m/s, of x."""
        return np.asarray((self.x - self._before) / self.timestep)

    @property
    def q(self) -> Array:
        return from_chart(self.character, self.x)[0]

    @property
    def v(self) -> Array:
        return from_chart(self.character, self.x, self.rate)[1]

    @property
    def base_rotation(self) -> Array:
        """(3, 3)."""
        return np.asarray(body_poses(self.character, self.x)[0][self.character.base_body])

    @property
    def base_place(self) -> Array:
        """(3,) m."""
        return np.asarray(body_poses(self.character, self.x)[1][self.character.base_body])

    @property
    def height(self) -> float:
        """m, of the base body's origin over the terrain: the signed distance from it."""
        return float(self._height(np.asarray(self.base_place)[None])[0])

    def reset(self, q: Array, v: Array | None = None) -> None:
        """Time 0 at q (nq,) and v (nv,), at rest by default."""
        rest = np.zeros(self.character.nx) if v is None else numbers("v", v, (self.character.nx,))
        self.reset_chart(*to_chart(self.character, np.asarray(q, dtype=float), rest, self.x))

    def reset_chart(self, x: Array, rate: Array | None = None) -> None:
        """Time 0 at x (nx,) and its rate (nx,)."""
        self.x = numbers("x", x, (self.character.nx,)).copy()
        speed = np.zeros_like(self.x) if rate is None else np.asarray(rate, dtype=float)
        self._before = self.x - self.timestep * speed
        self.push, self.time = np.zeros(3), 0.0

    def step(self, u: Array, seconds: float | None = None) -> None:
        """Hold the torques u (nu,) N m or N for ``seconds`` (a whole number of time steps; by
        default one)."""
        u = numbers("u", u, (self.character.nu,))
        load = np.zeros(self.character.nx)
        load[self.character.actuated] = np.clip(u, -self._limit, self._limit)
        if self.character.base == "floating":
            first, body = self.character.base_coordinate, self.character.base_body
            load[first : first + 3] = self.character.bodies[body].rotation.T @ self.push
        for _ in range(1 if seconds is None else max(1, round(seconds / self.timestep))):
            x_next, left = self._stepper(self.x, self._before, load)
            self._before, self.x = self.x, x_next
            self.unsolved += int(left > 1e-6)
            self.time += self.timestep

    def contacts(self) -> tuple[Array, Array]:
        """Force of the ground (c, 3) N on each sphere that touches the terrain, and where (c, 3) m;
        world axes."""
        if self._ground is None:
            nodes = self.x[None], self._before[None]
            vectors, _ = contact_numbers(self.dynamics, self._p, *nodes)
            return vectors[0][0], vectors[1][0]
        seen = self.dynamics.seen(self._p, self.x[None])
        force, point, *_ = self._ground(self.x, self._before, seen)
        return np.asarray(force).T, np.asarray(point).T
