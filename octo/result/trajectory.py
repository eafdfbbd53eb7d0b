"""A motion and how far it is from the laws of physics, whoever found it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array, whole
from octo.dynamics.crowd import crowd_columns
from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.feet import LOADED, stances
from octo.model.figure import size
from octo.model.kinematics import body_poses, center_of_mass
from octo.problem.asked import Asked
from octo.problem.bounds import SAME
from octo.result.bounds import Bound
from octo.result.residuals import Residual
from octo.result.stride import Stride, plane_around
from octo.soft.coordinates import Coordinates
from octo.world.world import World

VECTORS = ("contact_force", "contact_point", "contact_velocity", "contact_normal")  # (N, c, 3)
TOUCHES = ("touch_force", "touch_point")  # (N, m, 3), of contacts between bodies
ROWS = ("u", "contact_depth", *VECTORS, *TOUCHES)  # one a step
NONE: Array = np.zeros((0, 0, 3))  # of a motion whose contacts between bodies nobody measured
# rad or m, that a coordinate may change in a step: one that changes by more may have gone round the
# other way, or through the ground, at no cost, for a residual sees nothing between two nodes
LEAP = 1.0
GRAVITY = 9.81  # m/s²


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Trajectory:
    """What is measured of a motion: the part of a :class:`~octo.result.solution.Solution` that does
    not say how it was found. The attributes, their shapes and units are described there."""

    name: str
    character: Character | None
    dt: float  # s; of phases the mean
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
    touch_force: Array = field(default_factory=NONE.copy)  # (N, m, 3) N
    touch_point: Array = field(default_factory=NONE.copy)  # (N, m, 3) m
    world: World | None = None
    soft: Coordinates | None = None
    cycle: Stride | None = None
    asked: tuple[Asked, ...] = ()
    bounds: tuple[Bound, ...] = ()
    residuals: tuple[Residual, ...] = ()
    phases: tuple[Trajectory, ...] = ()

    def __post_init__(self) -> None:
        for name in TOUCHES:
            if not getattr(self, name).size:
                object.__setattr__(self, name, np.zeros((self.steps, 0, 3)))

    # -- the motion --------------------------------------------------------------------------------

    @property
    def steps(self) -> int:
        return len(self.x) - 2

    @property
    def intervals(self) -> Array:
        """(N,) s, of each step."""
        if not self.phases:
            return np.full(self.steps, self.dt)
        return np.concatenate([np.full(phase.steps, phase.dt) for phase in self.phases])

    @property
    def row_intervals(self) -> Array:
        """(N+1,) s, from each row of x to the next: x_{-1} is as far behind x_0 as x_1 is ahead."""
        return np.append(self.intervals[:1], self.intervals)

    @property
    def times(self) -> Array:
        """(N+1,) s, of x_0 … x_N."""
        if self.phases:
            return np.append(0.0, np.cumsum(self.intervals))
        return np.asarray(self.dt * np.arange(self.steps + 1), dtype=float)

    @property
    def v(self) -> Array:
        """(N+1, nx) rad/s and m/s, (x_i − x_{i-1})/dt of x_0 … x_N: of the chart's coordinates, as
        x."""
        return np.diff(self.x, axis=0) / self.row_intervals[:, None]

    @property
    def sampling(self) -> str:
        """How many steps of how many seconds, in words."""
        seconds = sorted({phase.dt for phase in self.phases} or {self.dt})
        each = " to ".join(dict.fromkeys(f"{dt:.6g}" for dt in (seconds[0], seconds[-1])))
        said = f"{self.steps} steps of {each} s"
        count = len(self.phases)
        return f"{said} in {count} phase{'s' if count > 1 else ''}" if count else said

    @property
    def energy(self) -> float:
        return float(sum(self.terms.values()))

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the coordinates in the order of x."""
        if self.soft is not None:
            return self.soft.names
        if self.character is None:
            return tuple(f"x{j}" for j in range(self.x.shape[1]))
        return tuple(joint.name for joint in self.character.joints)

    @property
    def actuated_names(self) -> tuple[str, ...]:
        """Names of the coordinates that u drives, in its order."""
        if self.soft is not None:
            return tuple(self.soft.names[j] for j in self.soft.driven)
        if self.character is None:
            return tuple(f"u{j}" for j in range(self.u.shape[1]))
        return tuple(self.character.joints[j].name for j in self.character.actuated)

    @property
    def units(self) -> tuple[str, ...]:
        """(nx,) of the coordinates; "" of user-written dynamics."""
        if self.soft is not None:
            return ("m",) * 3 + ("rad",) * 3 + ("kg^½ m",) * (self.soft.count - 6)
        if self.character is None:
            return ("",) * self.x.shape[1]
        return tuple("rad" if joint.kind == "hinge" else "m" for joint in self.character.joints)

    @property
    def effort_units(self) -> tuple[str, ...]:
        """(nu,) of what drives the actuated ones; "" of user-written dynamics."""
        if self.soft is not None:
            return ("N kg^-½",) * self.u.shape[1]
        if self.character is None:
            return ("",) * self.u.shape[1]
        units = self.units
        return tuple("N m" if units[j] == "rad" else "N" for j in self.character.actuated)

    @property
    def com(self) -> Array:
        """(N+1, 3) m, centre of mass at x_0 … x_N; zeros for user-written dynamics."""
        if self.soft is not None:
            return np.array(self.x[1:, :3])
        if self.character is None:
            return np.zeros((self.steps + 1, 3))
        return center_of_mass(self.character, self.x[1:])

    @property
    def yaw(self) -> Array:
        """(N+1,) rad, unwrapped heading of the base at x_0 … x_N."""
        if self.soft is not None:
            return np.array(self.x[1:, 3])  # the outermost angle: a ball that rolls does not turn
        if self.character is None:
            return np.zeros(self.steps + 1)
        rotation = body_poses(self.character, self.x[1:])[0][:, self.character.base_body]
        return np.unwrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))

    @property
    def extent(self) -> float | None:
        """m, the largest side of the robot in its default pose, or of the soft body at rest; None
        for user-written dynamics, which cannot be drawn."""
        if self.soft is not None:
            return float(self.soft.body.size.max())
        return None if self.character is None else size(self.character)

    @property
    def bends(self) -> float:
        """m, how far any point of a soft body's surface is from its place at rest, at most; 0 of
        what has none."""
        if self.soft is None:
            return 0.0
        return float(np.linalg.norm(self.soft.body.moved(self.x[1:, 6:]), axis=2).max())

    # -- what the feet do --------------------------------------------------------------------------

    @property
    def normal_force(self) -> Array:
        """(N, c) N."""
        return np.sum(self.contact_force * self.contact_normal, axis=-1)

    @property
    def touch_names(self) -> tuple[tuple[str, str], ...]:
        """(m,) what touches what: the sphere of one body and the solid of another."""
        robot = self.character
        if robot is None or not self.touch_force.shape[1]:
            return ()
        return tuple((robot.contacts[c].name, robot.solids[s].name) for c, s in robot.touches)

    @property
    def touched(self) -> NDArray[np.bool_]:
        """(N, m) the contacts between bodies that carry at least 1 % of the weight."""
        return np.linalg.norm(self.touch_force, axis=-1) >= LOADED * self.weight

    @property
    def own_contacts(self) -> NDArray[np.bool_]:
        """(c,) whether a contact is the robot's, and not that of one of a scene's objects."""
        own, robot = np.ones(self.contact_force.shape[1], dtype=bool), self.character
        if robot is not None:
            kept = set(robot.own_contacts)
            own[[c for c, k in enumerate(robot.terrain_contacts) if k not in kept]] = False
        return own

    @property
    def loaded(self) -> NDArray[np.bool_]:
        """(N, c) the contacts of the robot, or of a soft body's surface, that carry at least 1 % of
        the weight; of the many of a body that carry as much together, those that carry anything."""
        crowds = [list(range(self.contact_force.shape[1]))]
        if self.soft is None:
            crowds = crowd_columns(self.character)
        return carrying(self.normal_force, self.weight, crowds) & self.own_contacts

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
        user-written dynamics and soft bodies."""
        if self.character is None:
            return 0.0
        turned = np.diff(self.x[1:], axis=0)[:, self.character.actuated]  # (N, nu) rad and m
        return float(np.abs(self.u * turned).sum(axis=1).mean()) / self.dt

    # -- carried on --------------------------------------------------------------------------------

    def tile(self, strides: int) -> Self:
        """Whole strides of a cycle one after the other, without ``unknowns``: a mirrored one has
        two pieces a stride, and its ``violation`` and ``pointwise_residual`` are those of the image
        too, larger where the robot is not exactly its own mirror image. Contacts between bodies are
        not carried on.

        Raises
        ------
        ProblemError: the motion is no cycle. ValueRangeError: fewer than one stride.
        """
        stride = self.cycle
        if stride is None:
            how = "solve a Problem with cycle=octo.Cycle(…)"
            raise ProblemError(f"this motion is no cycle, it cannot be tiled: {how}")
        pieces = whole("strides", strides) * (2 if stride.mirrored else 1)
        kept = [name for name in ROWS if name not in TOUCHES]
        made: dict[str, list[Array]] = {name: [getattr(self, name)] for name in kept}
        made["x"] = [self.x[2:]]
        for _ in range(pieces - 1):
            last = {name: blocks[-1] for name, blocks in made.items()}
            made["x"].append(stride.on(last["x"]))
            made["u"].append(last["u"] @ stride.torque.T)
            made["contact_depth"].append(last["contact_depth"][:, stride.contacts])
            for name in VECTORS:
                turned = last[name][:, stride.contacts] @ stride.rotation.T
                made[name].append(turned + stride.shift if name == "contact_point" else turned)
        joined: dict[str, Any] = {name: np.concatenate(blocks) for name, blocks in made.items()}
        joined |= dict.fromkeys(TOUCHES, NONE) | {"x": np.concatenate([self.x[:2], joined["x"]])}
        for name in ("violation", "pointwise_residual"):
            joined[name] = max(getattr(self, name), stride.asymmetry)
        return replace(
            self,
            **joined,
            ground=plane_around(self.ground, joined["contact_point"]),
            cycle=stride.times(pieces),
            unknowns=self.unknowns[:0],
        )

    # -- what to know before it is used ------------------------------------------------------------

    @property
    def largest_step(self) -> dict[str, Any] | None:
        """The largest change of a coordinate from one node to the next.

        None of a motion without steps, or of one that is not finite.
        """
        change = np.abs(np.diff(self.x[1:], axis=0))  # (N, nx) rad and m
        if not change.size or not np.isfinite(change).all():
            return None
        step, coordinate = np.unravel_index(int(np.argmax(change)), change.shape)
        unit = self.units[int(coordinate)] or "rad or m"
        leaps = int((change > LEAP * (1.0 + SAME)).any(axis=1).sum())
        return {
            "change": float(change[step, coordinate]),
            "unit": unit,
            "coordinate": self.joint_names[int(coordinate)],
            "step": int(step),
            "time": float(self.times[step]),  # s, at its beginning
            "leaps": leaps,  # steps in which a coordinate changes by more than LEAP
        }

    def _why_leaps(self) -> str:
        """Behind a warning, why nothing limits the steps, if anybody knows."""
        return ""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before the motion is used, whatever its status: leaps from one node to the
        next, a dt too long."""
        said, largest = list[str](), self.largest_step
        if largest is not None and largest["leaps"]:
            leaps, which = largest["leaps"], "{coordinate} by {change:.3g} {unit} at {time:.3g} s"
            many = f"{leaps} steps change" if leaps > 1 else "one step changes"
            said.append(
                f"{many} a coordinate by more than {LEAP:g} rad or m ({which.format(**largest)}): "
                "between two nodes no law of physics is looked at, take a smaller dt or forbid it "
                f"with octo.StepLimit(){self._why_leaps()}"
            )
        fall = float(np.sqrt(self.length / GRAVITY))
        longest = float(self.intervals.max())
        if self.character is not None and longest > fall:
            said.append(
                f"dt is {longest:g} s, and in {fall:.2g} s this robot falls by half its height: "
                "take a smaller dt"
            )
        if self.world is not None and self.contact_point.size:
            there = self.world.covers(self.contact_point.reshape(-1, 3))
            whole = there.reshape(self.contact_point.shape[:2]).all(axis=1)  # (N,) steps
            if not whole.all():
                said.append(
                    f"from {float(self.times[np.argmin(whole)]):.3g} s on feet are where the world "
                    "has no shape below them: a map goes on as it is at its edge"
                )
        return tuple(said)


def carrying(
    normal_force: Array, weight: float, crowds: Sequence[Sequence[int]]
) -> NDArray[np.bool_]:
    """(N, c) contacts with normal forces (N, c) N of at least 1 % of the weight; of the many of a
    body (``crowds``, which of the c) that carry as much together, those that carry anything."""
    found = np.asarray(normal_force >= LOADED * weight)
    for columns in crowds:
        carries = normal_force[:, columns].sum(axis=1) >= LOADED * weight
        found[:, columns] = (normal_force[:, columns] > 0.0) & carries[:, None]
    return found
