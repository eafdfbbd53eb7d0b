"""How good a motion is: what its feet, its joints and its torques do, as a dozen numbers.

Row i of forces, torques and joint speeds belongs to the step from x_i to x_{i+1}. Loads are
compared with the weight mg.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.errors import ValueRangeError
from octo.model.character import Character
from octo.model.feet import CARRYING, TOUCHDOWN, feet_of, runs, stances
from octo.result.even import even
from octo.result.gathered import gathered
from octo.result.trajectory import ROWS, Trajectory

SHORT = 0.1  # s: a stance or a swing that is shorter is a tap or a stumble
TAPS = 2.5  # 1/s, touchdowns of a foot: more is tapping
SHAKY = 0.25  # of the torques' power above 5 Hz: more is shaking
# m, and part of ℓ: the smaller of the two is the least clearance of a foot that is not dragged
LOW, LOW_PART = 0.015, 0.06
ONE_SIDED = 0.3  # of the time: mammals that paced for more fell over in MuJoCo at 0.5 m/s
FOUR = 4  # feet, with fewer of which standing on one side is walking
HIGH = 5.0  # Hz: what a step needs of a torque is slower
LAGS = (0.2, 2.0)  # s, of the autocorrelation: no stride is shorter or longer
STEADY = 1e-3  # of mg, rms: loads that vary by less have no rhythm
ROUNDING = 1e-9  # of a step
STRIDES = 4  # a foot has a whole stance and a whole swing in the two in the middle


@dataclass(frozen=True)
class Gait:
    """Figures of a motion; None where there is nothing to measure.

    A stance begins when the normal force of a foot reaches 5 % of mg and ends when it falls below
    1 %; a foot is a contact that carries at least 2 % of mg in the mean. Stances and swings count
    when they begin and end inside the motion.

    Attributes
    ----------
    touchdowns: 1/s, begun stances of the foot that has most of them.
    shortest_stance, shortest_swing, median_swing: s, over all feet.
    clearance: m, median over the swings of the largest height of the foot over the ground.
    joint_speed: rad/s, largest |dq/dt| of an actuated hinge.
    joint_speed_use: largest |dq/dt| over its limit, of the joints that have one.
    torque_high: share of the power of u (its mean removed) above 5 Hz.
    rhythm: largest autocorrelation of the feet's loads over lags of 0.2 to 2 s, and of half the
        motion at most; 1 where they repeat exactly.
    one_sided: share of the time in which the feet that stand are all on one side of the centre of
        mass; None with fewer than four feet. A pace has most of it, a trot none.
    limit_excess: rad or m, by which a joint limit is passed at most.
    friction_use: largest |f_t|/f_n of a loaded contact.
    torque_use: largest |u| over its limit.
    """

    touchdowns: float | None
    shortest_stance: float | None
    shortest_swing: float | None
    median_swing: float | None
    clearance: float | None
    joint_speed: float | None
    joint_speed_use: float | None
    torque_high: float | None
    rhythm: float | None
    one_sided: float | None
    limit_excess: float | None
    friction_use: float | None
    torque_use: float | None

    def report(self) -> dict[str, float | None]:
        """The figures by name; what is not finite is None."""
        values = dataclasses.asdict(self)
        return {k: v if v is not None and math.isfinite(v) else None for k, v in values.items()}

    def __str__(self) -> str:
        """One line of plain words; what is not there is not said."""
        feet = ["no foot carries load"]
        if self.touchdowns is not None:
            feet = [f"feet: {self.touchdowns:.1f} touchdowns a second"]
        if self.shortest_stance is not None:
            feet.append(f"stance ≥ {self.shortest_stance:.2g} s")
        if self.median_swing is not None:
            feet.append(f"swing {self.median_swing:.2g} s (≥ {self.shortest_swing:.2g} s)")
        if self.clearance is not None:
            feet.append(f"clearance {1e3 * self.clearance:.0f} mm")
        parts = [", ".join(feet)]
        if self.joint_speed is not None:
            use = self.joint_speed_use
            limit = "" if use is None else f" ({use:.2g} of the limit)"
            parts.append(f"joints ≤ {self.joint_speed:.1f} rad/s{limit}")
        if self.rhythm is not None:
            parts.append(f"rhythm {self.rhythm:.2f}")
        return "; ".join(parts)


def measure_gait(motion: Trajectory, first: float = 0.0, last: float | None = None) -> Gait | None:
    """The figures of the motion between two times; None for user-written dynamics.

    What was before and what comes after is looked at only to know whether a foot stands.

    Parameters
    ----------
    first, last : s, from the start of the motion; by default all of it.

    Raises
    ------
    ValueRangeError: no step of the motion is between the two.
    """
    motion = gathered(even(motion))
    robot = motion.character
    if robot is None:
        return None
    begin, end = _window(motion, first, last)
    part = _cut(motion, begin, end)
    force = part.normal_force
    feet = np.flatnonzero((force.mean(axis=0) >= CARRYING * motion.weight) & motion.own_contacts)
    standing = stances(motion.normal_force[:, feet], motion.weight)
    stance, swing, heights, begun = [], [], [], []
    for foot, on in zip(feet, standing.T, strict=True):
        touched = on[1:] & ~on[:-1]  # of the rows 1 … N−1
        begun.append(int(touched[max(begin - 1, 0) : end - 1].sum()))
        stance += [b - a for a, b in runs(on, begin, end)]
        for a, b in runs(~on, begin, end):
            swing.append(b - a)
            heights.append(-float(motion.contact_depth[a:b, foot].min()))
    dt = motion.dt
    return Gait(
        touchdowns=max(begun) / (dt * (end - begin)) if begun else None,
        shortest_stance=dt * min(stance) if stance else None,
        shortest_swing=dt * min(swing) if swing else None,
        median_swing=dt * float(np.median(swing)) if swing else None,
        clearance=float(np.median(heights)) if heights else None,
        **_joints(robot, part.x[1:], dt),
        torque_high=high_share(part.u, dt),
        rhythm=rhythm(force[:, feet], dt, STEADY * motion.weight),
        one_sided=_one_sided(robot, part, feet),
        friction_use=part.friction_use,
        torque_use=part.torque_excess,
    )


def measure_cycle(motion: Trajectory) -> Gait | None:
    """The figures of a cycle carried on: of the whole strides in the middle of STRIDES or more."""
    period = motion.cycle.period if motion.cycle is not None else math.inf
    strides = max(1, round(motion.steps * motion.dt / period))
    several = motion if strides >= STRIDES else motion.tile(-(-STRIDES // strides))
    return measure_gait(several, period, several.steps * several.dt - period)


def flaws(gait: Gait | None, length: float) -> int:
    """How many things about a stride's gait nobody would keep: taps, stumbles, shaking, dragged
    feet, one side at a time; of a robot of ``length`` ℓ m."""
    if gait is None or gait.touchdowns is None:
        return 5
    shortest = (gait.shortest_stance, gait.shortest_swing)
    brief = sum(t is None or t < SHORT - ROUNDING for t in shortest)
    shaky = gait.torque_high is not None and gait.torque_high > SHAKY
    drags = gait.clearance is not None and gait.clearance < min(LOW, LOW_PART * length)
    return brief + (gait.touchdowns > TAPS) + shaky + drags + ((gait.one_sided or 0.0) > ONE_SIDED)


def _one_sided(robot: Character, part: Trajectory, feet: NDArray[np.intp]) -> float | None:
    """Share of the steps with a foot on the ground in which no foot of the other side is."""
    contacts = robot.terrain_contacts
    if len(feet) < FOUR or len(feet_of(robot, (contacts[k] for k in feet))) < FOUR:
        return None
    yaw, place = part.yaw[1:, None], part.contact_point[:, feet] - part.com[1:, None]
    left = np.cos(yaw) * place[..., 1] - np.sin(yaw) * place[..., 0] > 0.0
    on = part.normal_force[:, feet] >= TOUCHDOWN * part.weight
    both = (on & left).any(axis=1) & (on & ~left).any(axis=1)
    some = on.any(axis=1)
    return float((some & ~both).sum() / some.sum()) if some.any() else None


def high_share(u: Array, dt: float) -> float | None:
    """Share of the power of u (N, nu) above 5 Hz, means removed; 0 where u is constant.

    None where steps of dt s are too long, or the motion too short, to have anything above 5 Hz.
    """
    frequency = np.fft.rfftfreq(len(u), dt)
    if u.size == 0 or frequency[-1] <= HIGH:
        return None
    power = np.sum(np.abs(np.fft.rfft(u - u.mean(axis=0), axis=0)) ** 2, axis=1)
    twice = np.full(len(power), 2.0)  # every frequency has a negative one but 0 and Nyquist's
    twice[0] = 1.0
    if len(u) % 2 == 0:
        twice[-1] = 1.0
    total = float(twice @ power)
    rounding = (1e-12 * len(u)) ** 2 * float(np.max(u**2)) * u.shape[1]
    if total <= rounding:
        return 0.0
    return float((twice * power)[frequency > HIGH].sum()) / total


def rhythm(loads: Array, dt: float, steady: float) -> float | None:
    """Largest autocorrelation of loads (N, feet) N over the lags of LAGS, means removed.

    Each lag is divided by the size of the two parts that overlap, so that loads which repeat
    exactly have 1. No lag is longer than half the motion. None where that is too short, and where
    the loads vary by less than ``steady`` N.
    """
    varying = loads - loads.mean(axis=0)
    if loads.size == 0 or not np.sqrt(np.mean(np.sum(varying**2, axis=1))) > steady:
        return None
    shortest = math.ceil(LAGS[0] / dt - ROUNDING)
    longest = math.floor(min(LAGS[1] / dt, 0.5 * len(loads)) + ROUNDING)
    found = []
    for lag in range(max(shortest, 1), longest + 1):
        late, early = varying[lag:], varying[:-lag]
        size = math.sqrt(float(np.sum(late**2)) * float(np.sum(early**2)))
        found.append(float(np.sum(late * early)) / size if size > 0.0 else 0.0)
    return max(found) if found else None


def _window(motion: Trajectory, first: float, last: float | None) -> tuple[int, int]:
    """The steps begin … end−1 that lie between two times."""
    duration = motion.steps * motion.dt
    until = duration if last is None else last
    if not (math.isfinite(first) and math.isfinite(until)):
        raise ValueRangeError(f"first is {first} s and last is {until} s, both must be finite")
    begin = max(0, math.ceil(first / motion.dt - ROUNDING))
    end = min(motion.steps, math.floor(until / motion.dt + ROUNDING))
    if begin >= end:
        raise ValueRangeError(
            f"first is {first} s and last is {until} s, at least one step of {motion.dt} s of the "
            f"motion of {duration:g} s must be between them"
        )
    return begin, end


def _cut(motion: Trajectory, begin: int, end: int) -> Trajectory:
    """The steps begin … end−1 alone."""
    rows = {name: getattr(motion, name)[begin:end] for name in ROWS}
    return dataclasses.replace(motion, x=motion.x[begin : end + 2], **rows)


def _joints(robot: Character, x: Array, dt: float) -> dict[str, float | None]:
    """What the joints do at the configurations x (M+1, nx) and between them."""
    speed = np.abs(np.diff(x, axis=0)).max(axis=0) / dt  # (nx,)
    turning = [j for j in robot.actuated if robot.joints[j].kind == "hinge"]
    limited = np.isfinite(robot.velocity_limit)
    use = speed[limited] / robot.velocity_limit[limited]
    excess = np.maximum(x - robot.upper, robot.lower - x).max(initial=0.0)
    return {
        "joint_speed": float(speed[turning].max()) if turning else None,
        "joint_speed_use": float(use.max()) if use.size else None,
        "limit_excess": float(excess),
    }
