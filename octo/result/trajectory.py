"""A motion and how far it is from the laws of physics, whoever found it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from octo.model.character import Character
from octo.model.feet import LOADED, stances
from octo.model.kinematics import body_poses, center_of_mass
from octo.problem.asked import Asked
from octo.result.stride import Stride

Array = NDArray[np.float64]
VECTORS = ("contact_force", "contact_point", "contact_velocity", "contact_normal")  # (N, c, 3)
# what cuts a motion, or carries it on, gives back the kind it was given
AnyTrajectory = TypeVar("AnyTrajectory", bound="Trajectory")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Trajectory:
    """What is measured of a motion: the part of a :class:`~octo.result.solution.Solution` that does
    not say how it was found. The attributes, their shapes and units are described there."""

    name: str
    character: Character | None
    dt: float  # s
    basis: str
    x: Array  # (N+2, nx)
    u: Array  # (N, nu)
    unknowns: Array  # (K, nc)
    terms: dict[str, float]
    violation: float  # N
    pointwise_residual: float  # N
    weight: float  # N
    length: float  # m, ℓ
    torque_limit: Array  # (nu,)
    contact_names: tuple[str, ...]
    contact_force: Array  # (N, c, 3) N
    contact_point: Array  # (N, c, 3) m
    contact_velocity: Array  # (N, c, 3) m/s
    contact_normal: Array  # (N, c, 3)
    contact_depth: Array  # (N, c) m
    ground: dict[str, Array]
    parameters: dict[str, float]  # of the dynamics, of the last pass
    cycle: Stride | None = None
    asked: tuple[Asked, ...] = ()

    # -- the motion --------------------------------------------------------------------------------

    @property
    def steps(self) -> int:
        return len(self.x) - 2

    @property
    def times(self) -> Array:
        """(N+1,) s, of x_0 … x_N."""
        return np.asarray(self.dt * np.arange(self.steps + 1), dtype=float)

    @property
    def v(self) -> Array:
        """(N+1, nx) rad/s and m/s, (x_i − x_{i-1})/dt of x_0 … x_N: of the chart's coordinates, as
        x."""
        return np.diff(self.x, axis=0) / self.dt

    @property
    def energy(self) -> float:
        return float(sum(self.terms.values()))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the coordinates in the order of x."""
        if self.character is None:
            return tuple(f"x{j}" for j in range(self.x.shape[1]))
        return tuple(joint.name for joint in self.character.joints)

    @property
    def actuated_names(self) -> tuple[str, ...]:
        """Names of the coordinates that u drives, in its order."""
        if self.character is None:
            return tuple(f"u{j}" for j in range(self.u.shape[1]))
        return tuple(self.character.joints[j].name for j in self.character.actuated)

    @property
    def com(self) -> Array:
        """(N+1, 3) m, centre of mass at x_0 … x_N; zeros for user-written dynamics."""
        if self.character is None:
            return np.zeros((self.steps + 1, 3))
        return center_of_mass(self.character, self.x[1:])

    @property
    def yaw(self) -> Array:
        """(N+1,) rad, unwrapped heading of the base at x_0 … x_N."""
        if self.character is None:
            return np.zeros(self.steps + 1)
        rotation = body_poses(self.character, self.x[1:])[0][:, self.character.base_body]
        return np.unwrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))

    # -- what the feet do --------------------------------------------------------------------------

    @property
    def normal_force(self) -> Array:
        """(N, c) N."""
        return np.sum(self.contact_force * self.contact_normal, axis=-1)

    @property
    def loaded(self) -> NDArray[np.bool_]:
        """(N, c) contacts that carry at least 1 % of the weight."""
        return self.normal_force >= LOADED * self.weight

    @property
    def stance(self) -> NDArray[np.bool_]:
        """(N, c) contacts that stand at x_1 … x_N, without the flicker of a threshold: what
        ``gait`` counts."""
        return stances(self.normal_force, self.weight)

    def _loaded(self, values: Array) -> Array:
        chosen = values[self.loaded]
        return chosen if chosen.size else np.zeros(1)

    @property
    def penetration(self) -> float:
        """m, mean over loaded contact-steps."""
        return float(self._loaded(np.maximum(self.contact_depth, 0.0)).mean())

    @property
    def penetration_max(self) -> float:
        return float(self._loaded(np.maximum(self.contact_depth, 0.0)).max())

    @property
    def slip(self) -> float:
        """m/s, root mean square of the tangential velocity over loaded contact-steps."""
        normal = self.contact_normal
        into = np.sum(normal * self.contact_velocity, axis=-1, keepdims=True)
        along = self.contact_velocity - normal * into
        return float(np.sqrt(np.mean(self._loaded(np.sum(along**2, axis=-1)))))

    def _friction_use(self) -> Array:
        force = self.normal_force
        sideways = self.contact_force - self.contact_normal * force[..., None]
        tangential = np.linalg.norm(sideways, axis=-1)
        return self._loaded(tangential / np.where(self.loaded, force, 1.0))

    @property
    def friction_use(self) -> float:
        """Largest |f_t|/f_n of a loaded contact."""
        return float(self._friction_use().max())

    @property
    def friction_use_95(self) -> float:
        """95 % quantile of |f_t|/f_n over loaded contact-steps."""
        return float(np.quantile(self._friction_use(), 0.95))

    @property
    def torque_excess(self) -> float:
        """Largest |u|/limit over the joints that have a limit; 0 where none has."""
        limited = np.isfinite(self.torque_limit) & (self.torque_limit > 0)
        if not limited.any() or not self.steps:
            return 0.0
        return float(np.max(np.abs(self.u[:, limited]) / self.torque_limit[limited]))

    @property
    def power(self) -> float:
        """W, mean of Σ|u dq/dt| over the motion: work done by the joints and on them; 0 for
        user-written dynamics."""
        if self.character is None:
            return 0.0
        turned = np.diff(self.x[1:], axis=0)[:, self.character.actuated]  # (N, nu) rad and m
        return float(np.abs(self.u * turned).sum(axis=1).mean()) / self.dt
