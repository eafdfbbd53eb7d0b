"""A robot in MuJoCo, with friction, payload and bumps that a plan does not know of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from octo.checks import instance, number, numbers, positive
from octo.errors import ShapeError, ValueRangeError
from octo.model.character import Character
from octo.model.convention import from_chart, to_chart
from octo.model.export_mjcf import mjcf_text
from octo.model.quantities import GRAVITY, Array
from octo.model.quaternions import rotation_of
from octo.model.robot_file import import_mujoco
from octo.model.terrain import Plane, distance_and_normal
from octo.world.world import World

BUMPS_WITHIN = 5.0  # m, from the origin of the ground in x and y
BUMPS_CLEAR = 0.5  # m, around the origin: where a robot starts
BUMPS_EACH = 0.4  # m, one bump in every square of this side
BUMPS_HALF = (0.05, 0.15)  # m, half of a bump's sides
STICKIEST = 1e6  # of friction: wrenches inside the cone are still numbers


class MujocoPlant:
    """``character`` under MuJoCo's physics.

    Parameters
    ----------
    terrain: the ground, a Plane or a World. friction: sliding coefficient of feet and ground.
    timestep: s. gravity: (3,) m/s².
    payload: mass added to the base body, relative to its mass; its inertia grows alike.
    bumps: m, greatest height of boxes strewn over the ground (none within half a metre of its
        origin); ``seed`` places them.

    Torques act until the next ``step``; the model's motors clip them to the robot's limits. State:
    ``q`` (nq,), ``v`` (nv,) in MuJoCo's form and the order of the character's tree (see
    :mod:`octo.model.convention`), ``x``, ``rate`` (nx,) in octo's chart. ``model`` and ``data`` are
    MuJoCo's own.
    """

    def __init__(
        self,
        character: Character,
        *,
        terrain: Plane | World | None = None,
        friction: float = 0.8,
        timestep: float = 0.002,
        gravity: Iterable[float] = (0.0, 0.0, -GRAVITY),
        payload: float = 0.0,
        bumps: float = 0.0,
        seed: int = 0,
    ):
        mujoco = import_mujoco("a plant in MuJoCo")
        self.character = character
        words = "a Plane or a World: MuJoCo has no other ground here"
        self.terrain: Plane | World = instance("terrain", terrain or Plane(), (Plane, World), words)
        if not 0.0 <= number("friction", friction) <= STICKIEST:
            must = f"must not be negative, and at most {STICKIEST:g}"
            raise ValueRangeError(f"friction is {friction}, {must}")
        if number("bumps", bumps) < 0.0:
            raise ValueRangeError(f"bumps is {bumps} m, must not be negative")
        shapes = self.terrain if isinstance(self.terrain, World) else None
        if bumps > 0.0 and shapes is not None:
            raise ValueRangeError(f"bumps is {bumps} m, must be 0: they lie on a plane")
        self.timestep = positive("timestep", timestep, "s")
        text = mjcf_text(
            loaded(character, payload),
            terrain=self.terrain if isinstance(self.terrain, Plane) else None,
            world=shapes,
            friction=friction,
            timestep=timestep,
            gravity=numbers("gravity", gravity, (3,)),
            bumps=strewn(bumps, seed) if bumps > 0.0 else (),
        )
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self._mujoco = mujoco
        self._set_places()
        self.push = np.zeros(3)  # (3,) N, world axes, on the centre of mass of the base body
        start = character.start_pose
        self._near = start  # the last x that was looked at
        self.reset(*from_chart(character, start))

    def _set_places(self) -> None:
        """Where the entries of q and v are in MuJoCo's arrays, which number bodies depth first."""
        model, character = self.model, self.character
        q: list[int] = []
        v: list[int] = []
        for b, body in enumerate(character.bodies):
            joints = body.joints
            if character.base == "floating" and b == character.base_body:
                free = model.joint(f"{body.name}_free")
                q += range(free.qposadr[0], free.qposadr[0] + 7)
                v += range(free.dofadr[0], free.dofadr[0] + 6)
                joints = joints[6:]
            q += [int(model.joint(joint.name).qposadr[0]) for joint in joints]
            v += [int(model.joint(joint.name).dofadr[0]) for joint in joints]
        self._q, self._v = np.array(q, dtype=np.intp), np.array(v, dtype=np.intp)
        base = character.bodies[character.base_body].name
        self._first = character.base_coordinate  # of q and v of a floating base
        self._base = int(model.body(base if base != "world" else "_world").id)
        self._gear = np.array([character.joints[j].gear or 1.0 for j in character.actuated])
        self._contacts = {
            int(model.geom(character.contacts[k].name).id): c
            for c, k in enumerate(character.terrain_contacts)
        }

    # -- state -------------------------------------------------------------------------------------

    @property
    def nq(self) -> int:
        return len(self._q)

    @property
    def nv(self) -> int:
        return len(self._v)

    @property
    def time(self) -> float:
        """s, since the last reset."""
        return float(self.data.time)

    @property
    def q(self) -> Array:
        return np.asarray(self.data.qpos[self._q])

    @property
    def v(self) -> Array:
        return np.asarray(self.data.qvel[self._v])

    @property
    def x(self) -> Array:
        """(nx,) rad and m; the base's angles are unwrapped from one look at them to the next."""
        return self.chart()[0]

    @property
    def rate(self) -> Array:
        """(nx,) rad/s and m/s, of x."""
        return self.chart()[1]

    def chart(self) -> tuple[Array, Array]:
        """x and its rate at once."""
        x, rate = to_chart(self.character, self.q, self.v, self._near)
        self._near = x
        return x, rate

    def reset(self, q: Array, v: Array | None = None) -> None:
        """Time 0 at q (nq,) and v (nv,), at rest by default."""
        q = numbers("q", q)
        if q.shape != (self.nq,):
            raise ShapeError("q", q.shape, (self.nq,))
        rest = np.zeros(self.nv) if v is None else numbers("v", v, (self.nv,))
        self._mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._q], self.data.qvel[self._v] = q, rest
        self._near = to_chart(self.character, q, rest, self.character.default_pose)[0]
        self.push = np.zeros(3)
        self._mujoco.mj_forward(self.model, self.data)

    def reset_chart(self, x: Array, rate: Array | None = None) -> None:
        """Time 0 at x (nx,) and its rate (nx,)."""
        self.reset(*from_chart(self.character, x, rate))
        self._near = np.array(x, dtype=float)

    # -- motion ------------------------------------------------------------------------------------

    def step(self, u: Array, seconds: float | None = None) -> None:
        """Hold the torques u (nu,) N m or N for ``seconds`` (a whole number of time steps; by
        default one)."""
        self.data.ctrl[:] = numbers("u", u, (self.character.nu,)) / self._gear
        self.data.xfrc_applied[self._base, :3] = self.push
        count = 1 if seconds is None else max(1, round(seconds / self.timestep))
        self._mujoco.mj_step(self.model, self.data, count)

    @property
    def torque(self) -> Array:
        """(nu,) N m or N, what the motors gave in the last time step."""
        return np.asarray(self.data.actuator_force * self._gear)

    # -- what it is like ---------------------------------------------------------------------------

    @property
    def base_place(self) -> Array:
        """(3,) m, of the base body's origin."""
        free, first = self.character.base == "floating", self._first
        return np.array(self.q[first : first + 3] if free else self.data.xpos[self._base])

    @property
    def base_rotation(self) -> Array:
        """(3, 3)."""
        if self.character.base == "floating":
            return rotation_of(self.q[self._first + 3 : self._first + 7])
        return np.array(self.data.xmat[self._base].reshape(3, 3))

    @property
    def height(self) -> float:
        """m, of the base body's origin over the ground's plane, or over what of a world is straight
        below it."""
        if isinstance(self.terrain, World):
            place = self.base_place[None]
            return float((place[:, 2] - self.terrain.below(place))[0])
        return float(self.ground(self.base_place[None])[0][0])

    def ground(self, points: Array) -> tuple[Array, Array]:
        """Signed distance (k,) m and outward normal (k, 3) of the ground at points (k, 3) m."""
        if isinstance(self.terrain, World):
            return distance_and_normal(self.terrain, points)
        p, (x, y, z) = self.terrain.parameters, points.T
        normal = np.array([p[f"normal_{c}"] for c in "xyz"])
        distance = normal[0] * x + normal[1] * y + normal[2] * (z - p["height"])
        return distance, np.tile(normal, (len(points), 1))

    def feet(self, contacts: NDArray[np.intp]) -> tuple[Array, Array]:
        """Lowest points (k, 3) m of spheres (indices among those that touch the terrain), their
        Jacobians (k, 3, nv)."""
        mujoco, model, data = self._mujoco, self.model, self.data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        geoms = [geom for geom, _ in sorted(self._contacts.items(), key=lambda pair: pair[1])]
        chosen = [geoms[c] for c in contacts]
        centers = np.array(data.geom_xpos[chosen])
        points = centers - model.geom_size[chosen, :1] * self.ground(centers)[1]
        jacobians = np.empty((len(contacts), 3, model.nv))
        for k, geom in enumerate(chosen):
            mujoco.mj_jac(model, data, jacobians[k], None, points[k], int(model.geom_bodyid[geom]))
        return points, jacobians[..., self._v]

    def contacts(self) -> tuple[Array, Array]:
        """Force of the ground (c, 3) N on each sphere that touches the terrain, and where (c, 3) m;
        world axes."""
        count = len(self._contacts)
        force, point = np.zeros((count, 3)), np.zeros((count, 3))
        for geom, c in self._contacts.items():
            point[c] = self.data.geom_xpos[geom] - [0.0, 0.0, self.model.geom_size[geom, 0]]
        six = np.zeros(6)
        for k in range(self.data.ncon):
            contact = self.data.contact[k]
            geoms = (contact.geom1, contact.geom2)
            first, second = (self._contacts.get(int(geom)) for geom in geoms)
            if (first is None) == (second is None):
                continue
            if self.model.geom_bodyid[geoms[0 if first is None else 1]] != 0:
                continue  # the solid of a body, and not the ground
            self._mujoco.mj_contactForce(self.model, self.data, k, six)
            # the force acts on the second geom
            sphere, sign = (first, -1.0) if second is None else (second, 1.0)
            force[sphere] += sign * contact.frame.reshape(3, 3).T @ six[:3]
            point[sphere] = contact.pos
        return force, point


def loaded(character: Character, payload: float) -> Character:
    """The character with ``payload`` times the base body's mass added to it, its inertia in
    proportion."""
    instance("character", character, Character, "a Character: what octo.load gives")
    share = 1.0 + number("payload", payload)
    if share <= 0.0:
        raise ValueRangeError(f"payload is {payload} of the trunk's mass, must be over -1")
    base = character.bodies[character.base_body]
    heavier = replace(base, mass=share * base.mass, inertia=share * base.inertia)
    bodies = tuple(heavier if body is base else body for body in character.bodies)
    return replace(character, bodies=bodies)


def strewn(height: float, seed: int) -> list[tuple[Array, Array]]:
    """Boxes up to ``height`` m: centres (3,) and half sides (3,) m in the axes of the ground's
    plane."""
    rng = np.random.default_rng(seed)
    boxes = []
    for x in np.arange(-BUMPS_WITHIN, BUMPS_WITHIN, BUMPS_EACH):
        for y in np.arange(-BUMPS_WITHIN, BUMPS_WITHIN, BUMPS_EACH):
            top, half = rng.uniform(0.2, 1.0) * height, rng.uniform(*BUMPS_HALF, 2)
            center = np.array([x, y]) + rng.uniform(0.0, BUMPS_EACH, 2)
            if np.max(np.abs(center) - half) > BUMPS_CLEAR:
                box = [*center, 0.5 * top - 0.01], [*half, 0.5 * top + 0.01]
                boxes.append((np.array(box[0]), np.array(box[1])))
    return boxes
