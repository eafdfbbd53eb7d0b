"""Lists of terms that go together: plans a robot can follow, and control of locomotion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from octo.problem.contact_costs import Clearance, FootLift, ForceRate, FrictionCone, LoadSharing, Slip
from octo.problem.costs import (
    BaseAngularVelocity,
    BaseHeight,
    BaseOrientation,
    CenterOfMassVelocity,
    Cost,
    Effort,
    JointAcceleration,
    JointVelocity,
    Posture,
    TorqueLimit,
)


def paper(velocity: Sequence[float] = (0.5, 0.0, 0.0)) -> list[Cost]:
    """§8: the velocity of the centre of mass (m/s, Eq. 17) and effort, nothing else."""
    return [CenterOfMassVelocity(velocity=tuple(velocity)), Effort()]


def robot(speed: float | Sequence[float] = 0.5, yaw_rate: float = 0.0) -> list[Cost]:
    """Terms for a plan that a plant should follow: base held level, feet that hold, lift little and share the load.

    Parameters
    ----------
    speed: m/s along x, or a velocity (3,).
    yaw_rate: rad/s.
    """
    velocity = np.array([speed, 0.0, 0.0]) if np.isscalar(speed) else np.asarray(speed, dtype=float)
    scale = max(float(velocity @ velocity), 0.1**2)  # CenterOfMassVelocity divides by it
    level = (1.0, 1.0, 0.5 if yaw_rate == 0.0 else 0.0)  # a turning base has no fixed heading
    terms: list[Cost] = [
        CenterOfMassVelocity(velocity=tuple(velocity), weight=4.0 * scale),
        Effort(),
        BaseOrientation(weight=1.0, axes=level),
        BaseHeight(weight=0.5),
        FootLift(weight=10.0),
        Clearance(weight=0.03),
        FrictionCone(weight=0.3),
        LoadSharing(weight=0.25),
        ForceRate(weight=0.0075),
        JointAcceleration(weight=7e-8),
        TorqueLimit(weight=1.0),
    ]
    if yaw_rate != 0.0:
        weight = 4.0 * max(yaw_rate**2, 0.1**2)
        terms.append(BaseAngularVelocity(velocity=(0.0, 0.0, yaw_rate), axes=(0.0, 0.0, 1.0), weight=weight))
    return terms


def locomotion(velocity: Sequence[float] = (0.3, 0.0, 0.0), yaw_rate: float = 0.0) -> list[Cost]:
    """Terms for one-iteration control of walking: command tracked, body level, feet that do not slip.

    The weights are squares of the residual weights that a closed loop was tuned with, over one half.
    """
    command = np.asarray(velocity, dtype=float)
    scale = max(float(command @ command), 0.1**2)
    turning = max(yaw_rate**2, 0.1**2)
    return [
        CenterOfMassVelocity(velocity=tuple(command), weight=18.0 * scale),
        BaseAngularVelocity(velocity=(0.0, 0.0, yaw_rate), axes=(1.0 / 9.0, 1.0 / 9.0, 1.0), weight=4.5 * turning),
        BaseHeight(weight=50.0),
        BaseOrientation(weight=12.5, axes=(1.0, 1.0, 0.0)),
        Posture(weight=0.5, joints=0.3),
        JointVelocity(weight=4.5e-4),
        Effort(weight=0.045),
        TorqueLimit(weight=0.5),
        Slip(weight=0.5),
    ]
