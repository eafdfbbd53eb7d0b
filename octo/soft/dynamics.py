"""The dynamics of a reduced deformable body on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.dynamics.evaluate import Dynamics, check_surroundings
from octo.dynamics.laws import ContactLaw, Smooth, Viscous
from octo.dynamics.parameters import Layout, bound, section, unbound
from octo.errors import ModelError, StaticPoseError
from octo.model.chart import Chart
from octo.model.quantities import GRAVITY
from octo.model.terrain import Ground, Plane, World, own_parameters, signed_distance
from octo.soft import codegen, inertia, stages
from octo.soft.body import Body
from octo.soft.contact import Contacts, Surface
from octo.soft.coordinates import Coordinates
from octo.soft.elastic import Elastic
from octo.soft.moments import Moments
from octo.soft.nodes import Nodes, Turns
from octo.soft.rest import at_rest
from octo.soft.symbolic import forward_dynamics

MOST_LOWERED, NEAR = 60, 1e-9  # times; of its size, off the ground
MOST_WRITTEN = 40  # vertices in one expression


class SoftDynamics(Dynamics):
    """A body that bends by its modes, with all its surface vertices in contact with the ground.

    Coordinates: x, y, z of the body's frame (m), three angles of the chart (rad), outermost first,
    then z_1 … z_r of the modes (kg^½ m). The modes are actuated, the frame is not.

    Parameters
    ----------
    body: what deforms.
    law: the contact law; by default an octo.laws.Smooth in proportion to the body: lying on one
        vertex in 25 it sinks by 2.5 % of its size.
    terrain: an octo.Plane (the default), an octo.Terrain or an octo.World.
    actuated: which modes have motors, counted from 0; all by default.
    chart: "zyx" or "zxy".

    Raises
    ------
    ProblemError: naming the argument and what is allowed.
    """

    curvature_blocks = codegen.CURVATURE
    generated = Dynamics.generated | {"symbolic", "_stages"}

    def __init__(
        self,
        body: Body,
        law: ContactLaw | None = None,
        terrain: Ground | None = None,
        *,
        actuated: Sequence[int] | None = None,
        chart: Chart = "zyx",
    ):
        check_surroundings(terrain, law)
        self.coordinates = Coordinates(body, chart, actuated)
        self.body, self.chart, self.name = body, chart, body.name
        self.names = self.coordinates.names
        self.law: ContactLaw = usual_law(body) if law is None else law
        self.terrain: Ground = Plane() if terrain is None else terrain
        self.moments = Moments.of(body)
        self.nx = self.coordinates.count
        self.layout = Layout.of(_parameters(body, self.law, self.terrain))
        self.actuated = self.coordinates.driven
        self.unactuated = np.setdiff1d(np.arange(self.nx), self.actuated).astype(np.intp)

    @cached_property
    def symbolic(self) -> ca.Function:
        """FD(x_next, x, x_prev, p), of a body with few vertices: what other solvers are given.

        Raises
        ------
        ModelError: the body has more than MOST_WRITTEN vertices, or lies on a world.
        """
        if isinstance(self.terrain, World):
            raise ModelError(
                f"{self.body.name}: an octo.World has no expression for another solver: terrain "
                "must be an octo.Plane or an octo.Terrain"
            )
        count = len(self.body.points)
        if count > MOST_WRITTEN:
            raise ModelError(
                f"{self.body.name}: {count} vertices, at most {MOST_WRITTEN} in one expression for "
                "another solver: solve with octo.solve"
            )
        return forward_dynamics(self.body, self.law, self.terrain, self.layout, self.chart)

    def bound(self, p: Array) -> Array:
        return bound(self.layout, self.terrain, p)

    def unbound(self, p: Array) -> Array:
        return unbound(self.layout, self.terrain, p)

    @property
    def curvature_pattern(self) -> NDArray[np.bool_]:  # type: ignore[override]
        """(3n, 3n) where the curvature may not be zero: contacts know x_next and x, and of x_prev
        only T(x_prev) is known, which the frame's place enters linearly."""
        made = np.zeros((3, self.nx, 3, self.nx), dtype=bool)
        made[:2, :, :2] = True
        made[0, 3:, 2] = made[2, :, 0, 3:] = True
        made[2, 3:6, 2, 3:] = made[2, 3:, 2, 3:6] = True
        return made.reshape(3 * self.nx, 3 * self.nx)

    @property
    def weight(self) -> float:  # type: ignore[override]
        """N, mg with g = 9.81."""
        return self.body.mass * GRAVITY

    def rest(self, p: Array) -> Array:
        """(n,) the body lying on the ground, without a motor's force.

        Parameters
        ----------
        p: (NP,).

        Raises
        ------
        StaticPoseError: it rolls or slides on, or its modes give way.
        """
        return at_rest(self, p, self.on_ground(p, np.zeros(self.nx)), self.body.name)

    def on_ground(self, p: Array, x: Array) -> Array:
        """(n,) x moved up or down until its lowest vertex is on the ground.

        Parameters
        ----------
        p: (NP,). x: (n,).

        Raises
        ------
        StaticPoseError: no ground is found there, as beside a map.
        """
        made, values = np.array(x), section(self.layout.named(p), "terrain.")
        size, last = float(self.body.size.max()), np.inf
        for _ in range(MOST_LOWERED):  # once on level ground, where a distance is a height
            points = self.coordinates.surface(made[None])[0]
            gap = float(signed_distance(self.terrain, points, values).min())
            made[2] -= gap
            if abs(gap) < NEAR * size:
                return made
            if not abs(gap) < last:
                break
            last = abs(gap)
        where = f"x = {made[0]:.3g} m, y = {made[1]:.3g} m"
        raise StaticPoseError(f"{self.body.name}: there is no ground to lie on at {where}")

    def contact_numbers(self, p: Array, x: Array) -> tuple[tuple[str, ...], list[Array], Array]:
        """Names of the vertices that come near the ground, and of each and every step what a
        robot's contacts have: force, point, velocity and normal (N, c, 3), and depth (N, c).

        Parameters
        ----------
        p: (NP,). x: (N+2, n), x_{-1}, x_0 … x_N.
        """
        turn, _, surface = self._stages
        at = Nodes.of(self.moments, turn, x)
        return surface.states(at[2:], at[1:-1], p, self.bound(p), self.layout, self.law)

    def length(self, start: Array) -> float:
        """m, how high the frame is above the lowest vertex at ``start`` (n,); at least 1 % of the
        body's size."""
        at = Nodes.of(self.moments, self._stages[0], start[None])
        size = float(self.body.size.max())
        return max(float(start[2] - self._stages[2].places(at)[..., 2].min()), 0.01 * size)

    def row_scale(self, length: float) -> Array:
        """(m,) of the unactuated rows: 1/mg, of angles 1/(mg·length), of modes 1/(g√m)."""
        modal = np.full(self.nx - 6, 1.0 / self.effort(length))
        own = np.concatenate([np.ones(3), np.full(3, 1.0 / length)]) / self.weight
        return np.asarray(np.concatenate([own, modal])[self.unactuated], dtype=float)

    def effort(self, length: float) -> float:
        """N kg^-½, g√m: what moves all mass as fast as its weight does."""
        return GRAVITY * float(np.sqrt(self.body.mass))

    def _written(self, lanes: bool) -> str:
        given = (self.body, self.law, self.terrain, self.layout, self.chart)
        return codegen.body_text(*given, lanes)

    @cached_property
    def _stages(self) -> tuple[ca.Function, ca.Function, Surface]:
        surface = Surface.of(self.body, self.law, self.terrain, self.layout)
        return stages.turn(self.chart), stages.bend(self.chart), surface

    def _interpret(
        self,
        nodes: Array,
        p: Array,
        lam: Array | None,
        fd: Array,
        jac: Array | None,
        hess: Array | None,
    ) -> None:
        for k in range(len(nodes)):
            bending = None if hess is None or lam is None else lam[k]
            step = _Steps(self, nodes[k], p[k], 0 if jac is None else 1, bending)
            fd[k] = step.value()
            if jac is not None:
                jac[k] = step.jacobian()
            if hess is not None:
                hess[k] = step.curvature()


class _Steps:
    """All steps of one trajectory (N+2, n), in NumPy: FD and its derivatives."""

    def __init__(self, dynamics: SoftDynamics, x: Array, p: Array, order: int, lam: Array | None):
        turn, bend, surface = dynamics._stages
        self.moments, own = dynamics.moments, dynamics.layout.named(p)
        self.elastic = Elastic.of(dynamics.body, self.moments, own)
        self.dt, self.x, self.lam = own["dt"], x, lam
        made = Nodes.of(self.moments, turn, x)
        self.window = made[2:], made[1:-1], made[:-2]
        g = np.array([own[f"gravity_{axis}"] for axis in "xyz"])
        self.forces = inertia.forces(self.moments, self.window, self.dt, g)
        self.along: Turns | None = None
        if lam is not None:
            self.along = Turns.of(bend, x[2:, 3:6], lam[:, 3:6])
        given = (surface, self.window[:2], p, order + (lam is not None))
        self.contacts = Contacts(*given, self.along, lam)
        self.contacts.add_to(self.forces)

    def value(self) -> Array:
        """FD (N, n)."""
        rows = self.forces.rows(self.window[0])
        rows[:, 6:] += self.elastic.force(self.x[2:, 6:], self.x[1:-1, 6:])
        return rows

    def jacobian(self) -> Array:
        """(N, n, 3n)."""
        next_ = self.window[0]
        blocks = []
        for factor, node in zip(inertia.SECOND, self.window, strict=True):
            given = (self.moments, next_.turns, next_.weights, next_.turns.value, node)
            own = inertia.coupled(*given)
            own[:, :3] = inertia.moved(self.moments, node)
            blocks.append(factor / self.dt**2 * own)
        blocks[0] += next_.bent(self.forces.blocks)
        blocks[0][:, 6:, 6:] += self.elastic.tangent(self.x[2:, 6:]) + self.elastic.damping
        blocks[1][:, 6:, 6:] -= self.elastic.damping
        for block, own in zip(blocks, self.contacts.jacobian(), strict=False):
            block += own
        return np.concatenate(blocks, axis=2)

    def curvature(self) -> Array:
        """(N, 3n, 3n)."""
        next_, now, old = self.window
        lam, along = self.lam, self.along
        assert lam is not None and along is not None
        rate, n = 1.0 / self.dt**2, self.x.shape[1]
        pull = rate * inertia.pulled(self.moments, next_, along, lam)
        modal = np.concatenate([np.zeros((len(lam), 1)), lam[:, 6:]], axis=1)
        zero = np.zeros_like(next_.turns.value)
        mixed = []
        for factor, node in zip(inertia.SECOND, self.window, strict=True):
            own = inertia.coupled(self.moments, along, next_.weights, along.value, node)
            own += inertia.coupled(self.moments, next_.turns, modal, zero, node)
            mixed.append(rate * factor * own)
        at_next, at_now = self.contacts.pulls()
        touch = self.contacts.curvature()
        made = np.zeros((len(lam), 3, n, 3, n))
        made[:, 0, :, 0] = mixed[0] + mixed[0].swapaxes(1, 2) + touch[0]
        made[:, 0, :, 0] += next_.bent(pull + at_next)
        made[:, 0, :, 0] += inertia.curved(next_, along, lam, self.forces.blocks)
        made[:, 0, 6:, 0, 6:] += self.elastic.curvature(self.x[2:, 6:], lam[:, 6:])
        made[:, 0, :, 1], made[:, 0, :, 2] = mixed[1] + touch[1], mixed[2]
        made[:, 1, :, 0], made[:, 2, :, 0] = (made[:, 0, :, k].swapaxes(1, 2) for k in (1, 2))
        made[:, 1, :, 1] = now.bent(-2.0 * pull + at_now) + touch[2]
        made[:, 2, :, 2] = old.bent(pull)
        return made.reshape(len(lam), 3 * n, 3 * n)


SUNK = 0.025  # of the body's size: 1 cm of a ball of 40 cm
CARRYING = 25  # one vertex in so many carries a body that lies on a plane, about
SLIDING = 10.0  # s/m, w_par/w_perp


def usual_law(body: Body) -> Smooth:
    """Eq. 6 in proportion to the body."""
    depth = SUNK * float(body.size.max())
    carrying = max(4.0, len(body.points) / CARRYING)
    w = body.mass * GRAVITY / depth**2 / carrying
    return Smooth(w, depth, Viscous(SLIDING * w))


def _parameters(body: Body, law: ContactLaw, terrain: Ground) -> dict[str, float]:
    """Run-time parameters by name, with their defaults."""
    values: dict[str, Any] = {
        "dt": 0.025,  # s
        "gravity_x": 0.0,  # m/s²
        "gravity_y": 0.0,
        "gravity_z": -GRAVITY,
        "elastic.stiffness": 1.0,  # a factor of the body's own
        "elastic.alpha": body.damping[0],  # 1/s
        "elastic.beta": body.damping[1],  # s
    }
    values |= {f"contact.{name}": value for name, value in law.parameters.items()}
    return values | {f"terrain.{name}": v for name, v in own_parameters(terrain).items()}
