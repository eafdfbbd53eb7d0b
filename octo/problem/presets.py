"""Lists of terms that go together: plans a robot can follow, and control of locomotion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from octo.checks import floats, number, numbers, positive, shares
from octo.errors import ShapeError, ValueRangeError
from octo.model.character import Array
from octo.model.kinematics import body_poses
from octo.model.mass_matrix import joint_twists
from octo.model.quantities import GRAVITY
from octo.problem.asked import Asked, Motion
from octo.problem.body_costs import (
    BaseAngularVelocity,
    BaseHeight,
    BaseOrientation,
    CenterOfMassVelocity,
    PointPosition,
    Upright,
)
from octo.problem.contact_costs import (
    BodyLoad,
    Clearance,
    FootLift,
    ForceRate,
    FrictionCone,
    LoadSharing,
    Slip,
    SlipPower,
    SwingClearance,
)
from octo.problem.costs import Cost, SizedCost
from octo.problem.joint_costs import (
    Effort,
    JointAcceleration,
    JointLimit,
    JointSpeedLimit,
    JointVelocity,
    Posture,
    TorqueLimit,
)

if TYPE_CHECKING:
    from octo.problem.symbols import Setting


TRACKING = 1.5  # of the squared error of the velocity, in parts of the velocity wanted
SLOW = 0.03  # of g·ℓ, squared speed below which it is counted in these parts instead
BEGIN = 0.5  # s
STILL = 0.1**2  # (rad/s)², what the squared rate of a base that is to stay still is in parts of
FASTEST = 12.0  # rad/s, of joints whose file says no limit


def along(speed: float | Sequence[float]) -> Array:
    """(3,) m/s: a speed along x, or a velocity as it is.

    Raises
    ------
    ShapeError: another number of numbers.
    """
    found = numbers("speed", speed)
    if found.shape not in ((), (3,)):
        raise ShapeError("speed", found.shape, "() or (3,)")
    return np.array([float(found), 0.0, 0.0]) if found.ndim == 0 else found


def _reasonable(length: float) -> float:
    """m, of a body whose weights are numbers: its powers are."""
    found = positive("length", length, "m")
    if not 1e-6 <= found <= 1e6:
        raise ValueRangeError(f"length is {found:g} m, must be from 1e-6 to 1e6")
    return found


def paper(velocity: Sequence[float] = (0.5, 0.0, 0.0)) -> list[Cost]:
    """§8: ``velocity`` (3,) m/s of the centre of mass (Eq. 17) and effort, nothing else."""
    return [CenterOfMassVelocity(velocity=tuple(numbers("velocity", velocity, (3,)))), Effort()]


def natural(
    speed: float | Sequence[float] | None = None,
    yaw_rate: float | None = None,
    *,
    length: float | None = None,
    feet: tuple[str, ...] | Literal["feet"] = "feet",
    pose: Array | None = None,
) -> list[Cost]:
    """Terms for a motion that one would run on a robot or keep in a film: what a body minds, in its
    own units.

    Effort, jerky joints, a tilted trunk, a stance given up, one foot that carries all, a knee on
    the ground, a loaded foot that slides or pulls sideways, a fast foot that is low, force that
    jumps, and limits. Lengths are in ℓ, speeds in √(gℓ), forces in mg. Which weights were tried on
    which robots is in docs/notes/cycles.md.

    Parameters
    ----------
    speed: m/s along x, or a velocity (3,), wanted of the centre of mass; None where a cycle or
        fixed ends say how far.
    yaw_rate: rad/s, wanted of the base; None where nothing is asked.
    length: m, ℓ, height of the base over the feet; by default that of the problem that gets the
        terms.
    feet: names of the contacts that are feet; by default those that touch the ground at the start.
    pose: (nx,) how the body stands; by default the start.
    """
    if length is None:
        return _sized(partial(_natural, speed, yaw_rate, feet, pose))
    length = _reasonable(length)
    fast = GRAVITY * length  # m²/s²
    terms: list[Cost] = [
        Effort(weight=0.02),
        JointAcceleration(weight=1e-3 * (length / GRAVITY) ** 2),
        Upright(weight=0.5, pose=pose),
        LegPosture(weight=0.02, reference=pose, name="Posture"),
        LoadSharing(weight=0.9, contacts=feet),
        BodyLoad(weight=100.0, contacts=feet),
        SlipPower(weight=50.0 / fast, contacts=feet),
        SwingClearance(weight=5.0 / fast, height=0.1 * length, contacts=feet),
        ForceRate(weight=0.02, contacts=feet),
        FrictionCone(weight=3.0, mu=0.6, contacts=feet),
        TorqueLimit(weight=5.0, margin=0.9),
        JointSpeedLimit(weight=1.0, margin=0.9, otherwise=FASTEST),
        JointLimit(weight=20.0),
    ]
    if speed is not None:
        terms.insert(0, CenterOfMassVelocity(velocity=tuple(along(speed))))
    if yaw_rate is not None:
        terms.insert(
            0,
            BaseAngularVelocity(
                velocity=(0.0, 0.0, number("yaw_rate", yaw_rate)), axes=(0.0, 0.0, 1.0)
            ),
        )
    return terms


def contact_rich(*, length: float | None = None, gravity: float = GRAVITY) -> list[Cost]:
    """Terms for a motion in which any part of the body may touch: crawling, rolling, getting up.

    Effort, speed and acceleration of the joints, the turning of the base, sliding, force that jumps
    and pulls sideways, at all contacts, and limits: nothing about feet, a level trunk or a pose.
    Where to go is the problem's: fixed ends, or further terms.

    Parameters
    ----------
    length: m, ℓ, height of the base over the lowest contact; by default that of the problem that
        gets the terms.
    gravity: m/s².
    """
    if length is None:
        return _sized(partial(_contact_rich, gravity))
    length, gravity = _reasonable(length), positive("gravity", gravity, "m/s²")
    time = length / gravity  # s²
    return [
        Effort(weight=0.02),
        JointVelocity(weight=0.01 * time),
        BaseAngularVelocity(weight=0.02 * STILL * time),
        JointAcceleration(weight=1e-3 * time**2),
        SlipPower(weight=5.0 / (gravity * length)),
        ForceRate(weight=0.005),
        FrictionCone(weight=1.0, mu=0.6),
        TorqueLimit(weight=5.0, margin=0.9),
        JointSpeedLimit(weight=1.0, margin=0.9, otherwise=FASTEST),
        JointLimit(weight=20.0),
    ]


def robot(
    speed: float | Sequence[float] = 0.5,
    yaw_rate: float = 0.0,
    *,
    length: float | None = None,
    times: Sequence[float] | Array | None = None,
) -> list[Cost]:
    """Terms for a plan that a plant should follow: the base held level, and feet that share the
    load, hold and swing softly.

    Weights are in units of the robot's length and of gravity: the same walk at another size has the
    same E. What each is good for is in docs/replay.md, what they were tuned on in
    docs/notes/replay.md.

    Parameters
    ----------
    speed: m/s along x, or a velocity (3,).
    yaw_rate: rad/s.
    length: m, ℓ, height of the base over the feet; by default that of the problem that gets the
        terms.
    times: (N,) s, of x_1 … x_N; where given, the walk starts from rest: the velocity grows over
        half a second. By default those of the problem that gets the terms, if it begins at rest;
        none where ``length`` is given.
    """
    if length is None:
        return _sized(partial(_robot, speed, yaw_rate, times))
    velocity, yaw_rate = along(speed), number("yaw_rate", yaw_rate)
    length = _reasonable(length)
    fast = GRAVITY * length  # m²/s²
    # slow walks are not held harder
    floor = max(1.0, SLOW * fast / max(float(velocity @ velocity), 0.1**2))
    begun = np.ones(1)
    if times is not None:
        begun = np.clip(floats("times", times).reshape(-1) / BEGIN, 0.0, 1.0)
    level = (1.0, 1.0, 0.5 if yaw_rate == 0.0 else 0.0)  # a turning base has no fixed heading
    terms: list[Cost] = [
        CenterOfMassVelocity(
            velocity=np.squeeze(begun[:, None] * velocity), weight=TRACKING / floor
        ),
        Effort(),
        BaseOrientation(weight=1.0, axes=level),
        BaseHeight(weight=0.2 / length**2),
        LegPosture(weight=0.15, name="Posture"),
        FootLift(weight=0.9 / length**2, height=0.067 * length),
        Clearance(weight=0.09 / fast, length=0.067 * length),
        FrictionCone(weight=3.0, mu=0.4),
        LoadSharing(weight=1.2),
        ForceRate(weight=0.0075),
        JointAcceleration(weight=7.5e-4 * (length / GRAVITY) ** 2),
        TorqueLimit(weight=1.0),
    ]
    if yaw_rate != 0.0:
        turning, weight = (0.0, 0.0, yaw_rate), 4.0 * max(yaw_rate**2, 0.1**2)
        terms.append(BaseAngularVelocity(velocity=turning, axes=(0.0, 0.0, 1.0), weight=weight))
    return terms


def _sized(make: Callable[[float, Array], list[Cost]]) -> list[Cost]:
    """The terms that ``make`` makes, as soon as a Problem says its length and its times."""

    own = enumerate(make(1.0, np.ones(1)))
    return [SizedCost(name=term.label, make=partial(_one, make, k)) for k, term in own]


# Not lambdas: a problem with such terms is pickled, as another process or a copy of it needs.
def _one(make: Callable[[float, Array], list[Cost]], k: int, length: float, times: Array) -> Cost:
    return make(length, times)[k]


def _natural(
    speed: Any, yaw_rate: Any, feet: Any, pose: Any, length: float, times: Array
) -> list[Cost]:
    del times
    return natural(speed, yaw_rate, length=length, feet=feet, pose=pose)


def _contact_rich(gravity: float, length: float, times: Array) -> list[Cost]:
    del times
    return contact_rich(length=length, gravity=gravity)


def _robot(speed: Any, yaw_rate: Any, given: Any, length: float, times: Array) -> list[Cost]:
    return robot(speed, yaw_rate, length=length, times=times if given is None else given)


@dataclass(frozen=True, eq=False)
class LegPosture(Posture):
    """Posture that holds the joints which bend a leg fore and aft (axis along the base's y) nine
    tenths less than the others."""

    def references(self, setting: Setting) -> Mapping[str, Any]:
        robot = setting.character
        if robot is None:
            return super().references(setting)
        pose = (
            setting.x0
            if self.reference is None
            else np.atleast_2d(numbers(f"{self.label}.reference", self.reference))[-1]
        )
        heading = body_poses(robot, pose)[0][robot.base_body]
        sideways = np.abs(joint_twists(robot, pose)[robot.actuated, :3] @ heading[:, 1])
        weights = shares(f"{self.label}.joints", self.joints, robot.nu) * np.where(
            sideways > 0.7, 0.09, 1.0
        )
        return {**super().references(setting), "joints": np.sqrt(weights)}


@dataclass(frozen=True, eq=False)
class Leash(PointPosition):
    """PointPosition that pulls towards its target and does not ask to get there."""

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        return None


def locomotion(
    velocity: Sequence[float] = (0.0, 0.0, 0.0), yaw_rate: float = 0.0, *, length: float = 0.33
) -> list[Cost]:
    """Terms for one-iteration control of walking: command tracked, body level, feet that do not
    slip.

    The residuals are in lengths ℓ, speeds √(gℓ), rates √(g/ℓ) and moments mgℓ, so that one list
    serves robots of all sizes.

    Parameters
    ----------
    velocity: (3,) m/s, world. yaw_rate: rad/s. length: ℓ, m, height of the base over the ground.
    """
    command, yaw_rate = numbers("velocity", velocity, (3,)), number("yaw_rate", yaw_rate)
    length = _reasonable(length)
    speed, rate = GRAVITY * length, GRAVITY / length  # (m/s)², (rad/s)²
    # what the two terms divide by
    slow, still = max(float(command @ command), 0.1**2), max(yaw_rate**2, 0.1**2)
    return [
        CenterOfMassVelocity(velocity=tuple(command), weight=58.0 * slow / speed),
        BaseAngularVelocity(
            velocity=(0.0, 0.0, yaw_rate),
            axes=(1.0 / 9.0, 1.0 / 9.0, 1.0),
            weight=135.0 * still / rate,
        ),
        BaseHeight(weight=5.5 / length**2),
        BaseOrientation(weight=12.5, axes=(1.0, 1.0, 0.36)),
        Leash(name="Position", weight=0.22 * 0.1**2 / length**2, axes=(1.0, 1.0, 0.0), at="all"),
        LegPosture(name="Posture", weight=0.5),
        JointVelocity(weight=0.0135 / rate),
        Effort(weight=0.04),
        TorqueLimit(weight=20.0),
        Slip(weight=5.0 / speed, contacts="feet"),
    ]
