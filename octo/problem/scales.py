"""What a robot's numbers are measured in: lengths, forces and torques of its own, and penalties in
proportion to them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from octo.checks import Array
from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.model.character import Character
from octo.model.kinematics import body_poses
from octo.model.quantities import GRAVITY


def weight(robot: Character | None) -> float:
    """N, mg with g = 9.81; 1 without a robot."""
    return 1.0 if robot is None else robot.mass * GRAVITY


def gravity(values: Mapping[str, float]) -> float:
    """m/s², of the run-time parameters by name; 9.81 where there are none."""
    names = [name for name in ("gravity_x", "gravity_y", "gravity_z") if name in values]
    return float(np.linalg.norm([values[name] for name in names])) if names else GRAVITY


def size(robot: Character | None) -> float:
    """m, a length of the robot before its start is known: the reach of its default pose, at least
    5 cm."""
    if robot is None:
        return 1.0
    carried = (b for b, own in zip(robot.bodies, ~robot.of_objects, strict=True) if own)
    spans = [float(np.linalg.norm(body.position)) for body in carried if body.parent >= 0]
    return max(0.05, max(spans, default=0.3))


def length(robot: Character, start: Array) -> float:
    """m, ℓ: the base's height over the lowest contact at ``start`` (nx,), at least 5 cm."""
    rotations, positions = body_poses(robot, start)
    spheres = [robot.contacts[k] for k in robot.own_contacts]
    base = float(positions[robot.base_body][2])
    bottoms = (
        float((rotations[s.body] @ s.position + positions[s.body])[2]) - s.radius for s in spheres
    )
    return max(base - min(bottoms, default=0.0), 0.05)


def torque(robot: Character, length: float) -> float:
    """N m, u_ref of the effort: 0.4·mg·ℓ, and 0.4 times what the motors' own inertia and damping
    need to swing at √(g/ℓ)."""
    motors = [robot.joints[j] for j in robot.actuated]
    rate = np.sqrt(GRAVITY / length)  # rad/s
    inertia, damping = (
        np.mean([getattr(m, name) for m in motors] or [0.0]) for name in ("armature", "damping")
    )
    return float(0.4 * (weight(robot) * length + inertia * rate**2 + damping * rate))


def power(robot: Character, length: float) -> float:
    """W, mg·√(gℓ): that of lifting the weight as fast as it falls over about ℓ."""
    return float(weight(robot) * np.sqrt(GRAVITY * length))


def rows(robot: Character, length: float) -> Array:
    """(m,) of C's rows: 1/mg for forces, 1/(mg·ℓ) for moments."""
    kinds = [robot.joints[j].kind for j in robot.unactuated]
    own = weight(robot)
    return np.array([1.0 / own / (length if kind == "hinge" else 1.0) for kind in kinds])


def parameters(dynamics: Dynamics, law: ContactLaw | None) -> dict[str, float]:
    """Penalties in proportion to the robot: a limit passed by 0.1 rad gives 2 mg·ℓ, a contact sinks
    2 cm. A law that was given keeps its own."""
    if not isinstance(dynamics, RobotDynamics):
        return {}
    names, own = dynamics.layout.names, weight(dynamics.character)
    reach = size(dynamics.character)
    values = {"w_joint": 67.0 * own * reach, "w_self": 300.0 * own / reach**2}
    if "contact.w_perp" in names and law is None:
        values["contact.w_perp"] = own / 1.6e-3
        values["contact.w_par"] = 10.0 * values["contact.w_perp"]
        values["contact.onset"] = 0.01
    return {name: value for name, value in values.items() if name in names}
