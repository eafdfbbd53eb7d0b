"""Which base pose balances a robot whose joints are held: FD's unactuated rows vanish (§5).

On level ground nothing moves. On a slope Eq. 6 lets every foot creep: there the pose is the one
that creeps at a steady velocity v, FD(x, x - dt v, x - 2 dt v) = 0, with v along the ground. Where
friction cannot stop it either, it is the one that slides with an acceleration along the ground and
keeps its height and tilt.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.parameters import section
from octo.dynamics.simulate import Stepper
from octo.errors import StaticPoseError
from octo.interrupts import postponed
from octo.model.chart import chart_angles
from octo.model.kinematics import axis_rotation, body_poses, sphere_centers
from octo.model.quantities import GRAVITY, Array
from octo.model.terrain import World, distance, distance_and_normal, normal

TOLERANCE = 1e-6  # of mg and mg·ℓ
UPRIGHT = 0.2  # rad of tilt up to which a pose is taken at once
MOST_TILT = np.deg2rad(60.0)  # of the base against the pose that was asked for
KEPT = 0.1  # of the steps of joints are those of a base that they balance
NEWTON_ITERATIONS = 60
SETTLING_STEPS = 150


@dataclass(eq=False)
class Balance:
    """The search for one pose: which coordinates are free, which rows vanish, in which scale."""

    dynamics: RobotDynamics
    p: Array  # (NP,)
    start: Array  # (nx,)

    def __post_init__(self) -> None:
        robot = self.dynamics.character
        self.free = np.setdiff1d(robot.unactuated, robot.loose)  # objects stay where they are
        self.dt = float(self.p[self.dynamics.layout.index("dt")])
        self.weight = robot.mass * GRAVITY  # N
        self.root, self.lift = self._vertical_slide()
        self.start = self._touching(self._along_the_ground(self.start))
        self.length = self._length()
        # (nx,) rad, m
        self.step_scale = np.array(
            [1.0 if joint.kind == "hinge" else self.length for joint in robot.joints]
        )
        self.row_scale = self.step_scale[self.free] / self.weight / self.length
        self.still, self.drift = self._directions()
        self.clearance = self._base_clearance(self.start)

    # --- the ground -------------------------------------------------------------------------------

    @cached_property
    @postponed()
    def _ground(self) -> ca.Function:
        """Signed distance (m) and outward normal (3,) of the terrain at a point (3,) m."""
        point, p = ca.SX.sym("point", 3), ca.SX.sym("p", self.dynamics.layout.size)
        view, terrain = section(self.dynamics.layout.view(p), "terrain."), self.dynamics.terrain
        found = [distance(terrain, point, view), normal(terrain, point, view)]
        return ca.Function("ground", [point, p], found)

    def ground(self, points: Array) -> tuple[Array, Array]:
        """Distance (k,) m and normal (k, 3) at points (k, 3) m."""
        k = len(points)
        if isinstance(self.dynamics.terrain, World):
            return distance_and_normal(self.dynamics.terrain, points)
        phi, outward = self._ground.map(k)(points.T, ca.repmat(ca.DM(self.p), 1, k))
        return np.asarray(phi).reshape(k), np.asarray(outward).T

    def gaps(self, x: Array) -> Array:
        """Distance (contacts,) m of the robot's contacts from the ground at x, negative inside."""
        robot = self.dynamics.character
        chosen = list(robot.own_contacts)
        radius = np.array([robot.contacts[k].radius for k in chosen])
        return self.ground(sphere_centers(robot, x)[chosen])[0] - radius

    def _vertical_slide(self) -> tuple[int, int | None]:
        """The body that an unactuated, steep slide lifts, and that slide; else the base, None."""
        robot = self.dynamics.character
        for b, body in enumerate(robot.bodies):
            if robot.of_objects[b]:
                continue
            for j, joint in enumerate(body.joints, start=int(robot.first_joint[b])):
                steep = abs(float((body.rotation @ joint.axis)[2])) > 0.7
                if body.parent == -1 and joint.kind == "slide" and not joint.actuated and steep:
                    return b, j
        return robot.base_body, None

    def _lifting_axis(self) -> Array:
        """(3,) world direction in which the lifting slide moves the robot."""
        body = self.dynamics.character.bodies[self.root]
        first = int(self.dynamics.character.first_joint[self.root])
        return body.rotation @ body.joints[0 if self.lift is None else self.lift - first].axis

    def _along_the_ground(self, x: Array) -> Array:
        """x with a floating base turned as the slope is: feet in one plane stay in it."""
        robot = self.dynamics.character
        if robot.base != "floating":
            return x
        rotation, origin = body_poses(robot, x)
        outward = self.ground(origin[None, self.root])[1][0]
        axis = np.cross([0.0, 0.0, 1.0], outward)
        if np.linalg.norm(axis) < 1e-12:
            return x
        sine = np.linalg.norm(axis)
        turn = axis_rotation(axis / sine, np.arctan2(sine, outward[2]))
        x, first = x.copy(), int(robot.first_joint[self.root]) + 3
        R = robot.bodies[self.root].rotation.T @ turn @ rotation[self.root]
        reference = np.array([robot.joints[first + k].reference for k in range(3)])
        turns = np.asarray(chart_angles(R, robot.chart)) + reference
        whole = np.round((x[first : first + 3] - turns) / (2.0 * np.pi))
        x[first : first + 3] = turns + 2.0 * np.pi * whole
        return x

    def _touching(self, x: Array) -> Array:
        """x with the robot raised or lowered until its lowest contacts carry mg."""
        robot, j = self.dynamics.character, self.lift
        if j is None or not robot.own_contacts:
            return x
        x = x.copy()
        up = float(self._lifting_axis()[2])
        for _ in range(50):
            gap = float(np.min(self.gaps(x)))
            # a fixed point on a slope: the distance shrinks by its cosine each time
            x[j] -= gap / up
            if abs(gap) < 1e-10:
                break
        depths = np.concatenate([[0.0], np.geomspace(1e-5, 0.3, 46)])
        nodes = np.repeat(x[None], len(depths), axis=0)
        nodes[:, j] -= depths / up
        at = np.repeat(nodes[:, None], 3, axis=1)
        fd = self.dynamics.evaluate(at, np.repeat(self.p[None], len(depths), axis=0))[0]
        force = fd[:, 0, j] * np.sign(up)
        carried = np.flatnonzero(force <= 0.0)
        return nodes[int(carried[0])] if len(carried) else nodes[0]

    def _length(self) -> float:
        """ℓ (m): height of the centre of the base over the lowest contact."""
        robot = self.dynamics.character
        if not robot.own_contacts:
            return 1.0
        _, origin = body_poses(robot, self.start)
        height = self.ground(origin[None, self.root])[0][0] - np.min(self.gaps(self.start))
        return max(float(height), 0.05)

    # --- unknowns ---------------------------------------------------------------------------------

    def _directions(self) -> tuple[NDArray[np.intp], Array]:
        """Places in ``free`` that the pose is searched over, and directions (free, k) in which only
        a drift is.

        A robot that can be lifted drifts along the ground with its other slides, which the lifting
        slide compensates on a slope, and turns about the vertical; a robot hung on the world drifts
        along the slides that no force feels.
        """
        robot, m = self.dynamics.character, len(self.free)
        zero = np.zeros(m)
        force, stiffness, _, _ = self.linearised(self.start, zero, zero)
        felt = np.max(np.abs(stiffness[:, self.free] * self.row_scale[:, None]), axis=0)
        felt += np.abs(force * self.row_scale)
        place = {int(j): k for k, j in enumerate(self.free)}
        body = robot.bodies[self.root]
        _, origin = body_poses(robot, self.start)
        outward = self.ground(origin[None, self.root])[1][0]
        columns: dict[int, Array] = {}
        for j, joint in enumerate(body.joints, start=int(robot.first_joint[self.root])):
            if self.lift is None or j == self.lift or joint.actuated:
                continue
            axis = body.rotation @ joint.axis
            if joint.kind == "slide":
                columns[place[j]] = np.eye(m)[place[j]]
                rise = -(outward @ axis) / (outward @ self._lifting_axis())
                columns[place[j]][place[self.lift]] = rise
            elif abs(axis[2]) > 0.9:
                columns[place[j]] = np.eye(m)[place[j]]
        if self.lift is None:
            slides = [k for j, k in place.items() if robot.joints[j].kind == "slide"]
            columns = {k: np.eye(m)[k] for k in slides if felt[k] <= 1e-12}
        drift = np.array(list(columns.values())).reshape(-1, m).T
        return np.setdiff1d(np.arange(m), list(columns)).astype(np.intp), drift

    def linearised(self, x: Array, v: Array, a: Array) -> tuple[Array, Array, Array, Array]:
        """Rows (free,) of FD(x, x - dt v, x - 2 dt v + dt² a) and their derivatives to x (free, nx)
        and to v and a (free, free)."""
        n, free, dt = self.dynamics.nx, self.free, self.dt
        nodes = np.repeat(x[None, None], 3, axis=1)
        nodes[0, 1, free] -= dt * v
        nodes[0, 0, free] += dt**2 * a - 2.0 * dt * v
        fd, jac, _ = self.dynamics.evaluate(nodes, self.p[None], order=1)
        assert jac is not None
        newest, now, old = (jac[0, 0][free, k * n : (k + 1) * n] for k in range(3))
        to_v, to_a = -dt * (now + 2.0 * old), dt**2 * old
        return fd[0, 0, free], newest + now + old, to_v[:, free], to_a[:, free]

    # --- search -----------------------------------------------------------------------------------

    def solve(self) -> Array:
        """Newton from the start, then from where the robot settles with its joints held; a stable
        pose comes first.

        Where none is stable (a robot on two point feet) the joints have to balance the pose: the
        least tilted is taken.
        """
        unstable: list[Array] = []
        reason = ""
        for prepare in (lambda: self.start, self.settled):
            x = prepare()
            for sliding in (False, True)[: 1 if self.lift is None else 2]:
                found, residual = self.newton(x, sliding)
                objection = self.objection(found, residual)
                if not objection and self.stable(found):
                    return found
                if not objection:
                    unstable.append(found)
                    break
                reason = objection
        if unstable:
            return min(unstable, key=self.tilt)
        raise StaticPoseError(reason)

    def nearest(self, lean: float) -> Array:
        """The static pose nearest the start: that of the base alone where it is stable and tilted
        by ``lean`` rad at most, else one for which the joints move, as little as it takes.

        On soft ground a tall robot does not stand with its joints held, and where it begins to, the
        pose of the base alone changes without bound.
        """
        for prepare in (lambda: self.start, self.settled):
            found, residual = self.newton(prepare(), sliding=False)
            near = residual <= TOLERANCE and self.tilt(found) <= lean
            if near and self.stable(found):
                return found
        return self.by_joints()

    def by_joints(self) -> Array:
        """The static pose nearest the start for which the joints move too."""
        found, residual = self.newton(self.start, sliding=False, joints=True)
        if reason := self.objection(found, residual):
            raise StaticPoseError(reason)
        return found

    def newton(self, x: Array, sliding: bool, joints: bool = False) -> tuple[Array, float]:
        """Levenberg's method on the scaled rows, over pose and steady drift (or, sliding, its
        acceleration); with ``joints`` over the actuated ones too, within their limits, and the base
        turns only where these do not help."""
        robot, drift, k = self.dynamics.character, self.drift, self.drift.shape[1]
        sought = self.free[self.still]
        if joints:
            sought = np.concatenate([sought, robot.actuated])
        x, rate, damping = x.copy(), np.zeros(k), 0.0
        unit = np.concatenate([self.step_scale[sought], np.ones(k)])
        if joints:
            unit[: len(self.still)] *= KEPT

        def rows(x: Array, rate: Array) -> tuple[Array, Array]:
            moved = drift @ rate
            zero = np.zeros(len(self.free))
            force, stiffness, friction, inertia = self.linearised(
                x, *((zero, moved) if sliding else (moved, zero))
            )
            slopes = np.hstack([stiffness[:, sought], (inertia if sliding else friction) @ drift])
            return self.row_scale * force, self.row_scale[:, None] * slopes * unit

        force, jac = rows(x, rate)
        norm = float(np.linalg.norm(force))
        for _ in range(NEWTON_ITERATIONS):
            if norm <= 1e-3 * TOLERANCE or damping > 1e6:
                break
            change = _levenberg(jac, force, damping)
            largest = float(np.max(np.abs(change[: len(sought)]), initial=0.0))
            change *= min(1.0, 0.2 / max(largest, 1e-300))
            moved = unit * change
            trial = x.copy()
            trial[sought] += moved[: len(sought)]
            if joints:
                trial = np.clip(trial, robot.lower, robot.upper)
            tried, tried_jac = rows(trial, rate + moved[len(sought) :])
            tried_norm = float(np.linalg.norm(tried))
            if tried_norm < norm:
                x, rate = trial, rate + moved[len(sought) :]
                force, jac, norm = tried, tried_jac, tried_norm
                damping = 0.0 if damping < 1e-4 else 0.2 * damping
            else:
                damping = max(1e-3, 4.0 * damping)
        return x, float(np.max(np.abs(force), initial=0.0))

    def settled(self, falling: bool = False) -> Array:
        """Where the robot comes to rest with its joints held: implicit steps from rest, ever
        longer, then put back; ``falling``: also where it tips over.

        Starting each step at rest damps the fall; the solution of a step is then that of V(x) + ½|x
        - x_i|²_M/dt².
        """
        x, duration = self.start, 0.01
        kept = [j for k, j in enumerate(self.free) if k not in self.still]
        for _ in range(SETTLING_STEPS):
            p = self.p.copy()
            p[self.dynamics.layout.index("dt")] = duration
            moved, left = Stepper(self.dynamics, p, self.free)(x, x)
            if not left < 1e-6:
                duration *= 0.3
                if duration < 1e-4:
                    break
                continue
            change = ((moved - x) / self.step_scale)[self.free][self.still]
            x, duration = moved, min(1.5 * duration, 1.0)
            at_rest = duration >= 0.2 and float(np.max(np.abs(change), initial=0.0)) < 1e-4
            tips = self.lift is not None and self.tilt(x) > MOST_TILT
            if at_rest or (tips and not falling):
                break
        x = x.copy()
        x[kept] = self.start[kept]
        return self._touching(x)

    # --- does it stand? ---------------------------------------------------------------------------

    def tilt(self, x: Array) -> float:
        """rad between the vertical axis of the base now and at the start."""
        robot = self.dynamics.character
        ups = [body_poses(robot, pose)[0][self.root][2] for pose in (self.start, x)]
        return float(np.arccos(np.clip(ups[0] @ ups[1], -1.0, 1.0)))

    def stable(self, x: Array) -> bool:
        """Whether the potential has a minimum at x: with the joints held the robot comes back when
        pushed."""
        zero = np.zeros(len(self.free))
        place = self.free[self.still]
        scale = self.step_scale[place]
        square = self.linearised(x, zero, zero)[1][self.still][:, place] * scale * scale[:, None]
        values = np.linalg.eigvalsh(0.5 * (square + square.T))
        return bool(np.all(values >= -1e-9 * self.weight * self.length))

    def _base_clearance(self, x: Array) -> float:
        """m, lowest contact of the base body above the ground; infinite where it has none."""
        robot = self.dynamics.character
        bodies = [robot.contacts[c].body for c in robot.own_contacts]
        own = [k for k, body in enumerate(bodies) if body == self.root]
        return float(np.min(self.gaps(x)[own])) if own and self.lift is not None else np.inf

    def objection(self, x: Array, residual: float) -> str:
        """Why x is no static pose, or nothing."""
        robot = self.dynamics.character
        if self.lift is not None and self.tilt(x) > MOST_TILT:
            degrees = np.rad2deg(self.tilt(x))
            return f"{robot.bodies[self.root].name} tips over by {degrees:.0f} degrees"
        if not residual <= TOLERANCE:
            if self.lift is not None and not robot.own_contacts:
                return "it has no contact to stand on"
            return f"a residual of {residual:.1e} mg is left"
        if self.clearance > 0.1 * self.length and self._base_clearance(x) < 0.0:
            return f"{robot.bodies[self.root].name} comes down on the ground"
        return ""


def _levenberg(jac: Array, rows: Array, damping: float) -> Array:
    """Step (k,) of least |rows + jac·step|² + damping·|step|², the shortest of several."""
    k = jac.shape[1]
    if damping > 0.0:
        jac = np.vstack([jac, np.sqrt(damping) * np.eye(k)])
        rows = np.concatenate([rows, np.zeros(k)])
    try:
        return np.asarray(np.linalg.lstsq(jac, -rows, rcond=1e-10)[0], dtype=float)
    except np.linalg.LinAlgError:
        raise StaticPoseError(
            "no static pose was found: what a small motion changes is not finite"
        ) from None
