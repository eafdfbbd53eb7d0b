"""Contact laws: force on the body from penetration depth and velocity, as small CasADi functions.

A law has ``parameters`` (names and defaults of its run-time parameters), ``reach(p)`` (it is active
where depth > -reach) and ``force(depth, normal, velocity, p)``, its force where it is active: the
caller cuts it off elsewhere, by a branch where there is one. A new law is a class with these three.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import casadi as ca

View = Mapping[str, ca.SX]


class Friction(Protocol):
    """Tangential force (3,) N for a normal force, opposite to the tangential velocity."""

    @property
    def parameters(self) -> Mapping[str, float]: ...

    def force(
        self, normal_force: ca.SX, squared_depth: ca.SX, velocity: ca.SX, p: View
    ) -> ca.SX: ...


class ContactLaw(Protocol):
    """Force on the body (3,) N, world axes."""

    @property
    def parameters(self) -> Mapping[str, float]: ...

    def reach(self, p: View) -> ca.SX: ...

    def force(self, depth: ca.SX, normal: ca.SX, velocity: ca.SX, p: View) -> ca.SX: ...


@dataclass(frozen=True)
class Viscous:
    """Eq. 6: f_t = -w_par d² v_t."""

    w_par: float = 3e5  # N s/m³; w_par/w_perp is 10 s/m

    @property
    def parameters(self) -> Mapping[str, float]:
        return {"w_par": self.w_par}

    def force(self, normal_force: ca.SX, squared_depth: ca.SX, velocity: ca.SX, p: View) -> ca.SX:
        return -p["w_par"] * squared_depth * velocity


@dataclass(frozen=True)
class Coulomb:
    """Regularised Coulomb: f_t = -mu f_n v_t / sqrt(|v_t|² + creep²), ``mu`` the coefficient of
    friction."""

    mu: float = 0.8
    creep: float = 0.2  # m/s, sliding speed at which f_t is 0.7 mu f_n

    @property
    def parameters(self) -> Mapping[str, float]:
        return {"mu": self.mu, "creep": self.creep}

    def force(self, normal_force: ca.SX, squared_depth: ca.SX, velocity: ca.SX, p: View) -> ca.SX:
        speed = ca.sqrt(ca.dot(velocity, velocity) + p["creep"] ** 2)
        return -p["mu"] * normal_force * velocity / speed


def _tangential(velocity: ca.SX, normal: ca.SX) -> ca.SX:
    return velocity - normal * ca.dot(normal, velocity)


@dataclass(frozen=True)
class Smooth:
    """Eq. 6: f = [w_perp n - w_par (I - nnᵀ) v] d², with a smoothable onset.

    d is 0 below -onset, (depth + onset)²/(4 onset) up to +onset, depth above: the positive part
    when onset is 0. ``friction``: the law of the tangential force.
    """

    w_perp: float = 3e4  # N/m²
    onset: float = 0.0  # m
    friction: Friction = field(default_factory=Viscous)

    @property
    def parameters(self) -> Mapping[str, float]:
        return {"w_perp": self.w_perp, "onset": self.onset, **self.friction.parameters}

    def reach(self, p: View) -> ca.SX:
        return p["onset"]

    def force(self, depth: ca.SX, normal: ca.SX, velocity: ca.SX, p: View) -> ca.SX:
        onset = p["onset"]
        rise = (depth + onset) ** 2 / (4.0 * ca.fmax(onset, 1e-12))
        d = ca.if_else(depth < onset, rise, depth)
        normal_force = p["w_perp"] * d**2
        own = (normal_force, d**2, _tangential(velocity, normal), p)
        return normal_force * normal + self.friction.force(*own)


@dataclass(frozen=True)
class Compliant:
    """f_n = stiffness·sigma·log(1 + e^(depth/sigma))·h(v_n/v_d), a soft foot for control.

    h is the Hunt-Crossley damping of Castro et al. (IDTO): with s = v_n/v_d (positive when leaving)
    it is 1 - s for s < 0, (s - 2)²/4 up to s = 2, and 0 beyond: continuously differentiable and
    never negative. ``offset`` is added to the depth: where the plan's foot is soft and the
    machine's is hard, what the soft one sinks under its load. ``friction``: the law of the
    tangential force.
    """

    stiffness: float = 2000.0  # N/m
    sigma: float = 0.01  # m, width of the onset
    dissipation_velocity: float = 0.2  # m/s
    offset: float = 0.0  # m
    friction: Friction = field(default_factory=Coulomb)

    @property
    def parameters(self) -> Mapping[str, float]:
        names = ("stiffness", "sigma", "dissipation_velocity", "offset")
        return {**{name: getattr(self, name) for name in names}, **self.friction.parameters}

    def reach(self, p: View) -> ca.SX:
        # log(1 + e^-16) is 1e-7: the step at the cut is 1e-7 of a load
        return p["offset"] + 16.0 * p["sigma"]

    def force(self, depth: ca.SX, normal: ca.SX, velocity: ca.SX, p: View) -> ca.SX:
        z = (depth + p["offset"]) / p["sigma"]
        soft_depth = p["sigma"] * (ca.fmax(z, 0.0) + ca.log1p(ca.exp(-ca.fabs(z))))
        s = ca.dot(normal, velocity) / p["dissipation_velocity"]
        damping = ca.if_else(s < 0.0, 1.0 - s, ca.if_else(s < 2.0, (s - 2.0) ** 2 / 4.0, 0.0))
        normal_force = p["stiffness"] * soft_depth * damping
        own = (normal_force, soft_depth**2, _tangential(velocity, normal), p)
        return normal_force * normal + self.friction.force(*own)
