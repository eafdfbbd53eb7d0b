"""Motions that nobody solved: smooth, with feet that carry load in turns, every field of a Solution
filled."""

from __future__ import annotations

import numpy as np

import octo
from octo.model.character import Character
from octo.model.kinematics import sphere_centers
from octo.result.solution import Solution
from octo.solver.status import HISTORY, Status


def wandering(
    character: Character, steps: int = 40, dt: float = 0.025, seed: int = 0, hills: float = 0.0
) -> Solution:
    """The character swings its joints about the default pose while its base travels at 0.5 m/s,
    over waves ``hills`` m high."""
    random = np.random.default_rng(seed)
    times = dt * np.arange(-1, steps + 1)
    pose = character.default_pose if character.default_pose is not None else np.zeros(character.nx)
    swing = random.uniform(0.05, 0.25, character.nx) * np.sin(
        4.0 * times[:, None] + random.uniform(0.0, 6.0, character.nx)
    )
    x = pose + np.where([joint.actuated for joint in character.joints], swing, 0.0)
    if character.base == "floating":
        x[:, 0] += 0.5 * times
    touching = [character.contacts[k] for k in character.terrain_contacts]
    radius = np.array([contact.radius for contact in touching])
    center = sphere_centers(character, x[2:])[:, list(character.terrain_contacts)]
    weight = 9.81 * character.mass
    carried = weight * np.maximum(np.sin(6.0 * times[2:, None] + np.arange(len(touching))), 0.0)
    up = np.broadcast_to([0.0, 0.0, 1.0], center.shape).copy()
    gx, gy = np.arange(-1.5, 2.5, 0.1), np.arange(-1.5, 1.5, 0.1)
    return Solution(
        **plain(steps, dt, x, random.normal(size=(steps, character.nu)), weight),
        name=character.name,
        character=character,
        torque_limit=character.torque_limit,
        contact_names=tuple(contact.name for contact in touching),
        contact_force=carried[..., None] * up,
        contact_point=center - radius[:, None] * up,
        contact_velocity=np.zeros_like(center),
        contact_normal=up,
        contact_depth=np.zeros(center.shape[:2]),
        ground={"x": gx, "y": gy, "z": hills * np.sin(3.0 * gx)[:, None] * np.ones(len(gy))},
    )


def custom(nx: int = 2, nu: int = 1, steps: int = 30) -> Solution:
    """Of user-written dynamics: no character, no contacts."""
    x = np.sin(0.1 * np.arange(steps + 2)[:, None] + np.arange(nx))
    vectors = ("contact_force", "contact_point", "contact_velocity", "contact_normal")
    return Solution(
        **plain(steps, 0.05, x, np.cos(x[2:, :1]) * np.ones(nu), 0.0),
        **{name: np.zeros((steps, 0, 3)) for name in vectors},
        name="custom",
        character=None,
        torque_limit=np.full(nu, np.inf),
        contact_names=(),
        contact_depth=np.zeros((steps, 0)),
        ground={},
    )


def plain(steps: int, dt: float, x: np.ndarray, u: np.ndarray, weight: float) -> dict[str, object]:
    """What does not depend on the kind of dynamics: two passes of 30 iterations."""
    history = {name: np.zeros(60) for name in HISTORY}
    history["pass"] = np.repeat([1.0, 2.0], 30)
    history["energy"] = np.geomspace(1.0, 1e-3, 60)
    history["violation"] = np.geomspace(1e2, 1e-6, 60)
    return {
        "dt": dt,
        "basis": "nodes",
        "x": x,
        "u": u,
        "unknowns": x[2:],
        "multipliers": np.zeros((steps, 6)),
        "status": Status.CONVERGED,
        "iterations": 60,
        "factorizations": 90,
        "terms": {"Effort": 1e-3},
        "violation": 1e-6,
        "pointwise_residual": 1e-6,
        "weight": weight,
        "length": 0.3,
        "history": history,
        "parameters": {},
        "seconds": 1.0,
        "setup_seconds": 1.0,
    }


def swinging(steps: int = 20, dt: float = 0.05) -> Solution:
    """A soft ball of coarse elements that swings in its first mode while it rolls along x."""
    body = octo.soft.ball(divisions=2, modes=4)
    soft = octo.soft.Coordinates(body, "zxy")
    times = dt * np.arange(-1, steps + 1)
    x = np.zeros((steps + 2, soft.count))
    x[:, 0], x[:, 2], x[:, 5] = 0.4 * times, 0.2, 2.0 * times
    x[:, 6] = 0.1 * np.sin(2.0 * np.pi * times)
    lowest = np.argmin(soft.surface(x)[..., 2], axis=1)
    place = soft.surface(x)[np.arange(len(x)), lowest][2:, None]
    up = np.broadcast_to([0.0, 0.0, 1.0], place.shape).copy()
    weight, random = 9.81 * body.mass, np.random.default_rng(0)
    return Solution(
        **plain(steps, dt, x, random.normal(size=(steps, 4)), weight),
        name=body.name,
        character=None,
        soft=soft,
        torque_limit=np.full(4, np.inf),
        contact_names=("vertex_0",),
        contact_force=weight * up,
        contact_point=place,
        contact_velocity=np.zeros_like(place),
        contact_normal=up,
        contact_depth=np.zeros(place.shape[:2]),
        ground={"x": np.array([-1.0, 2.0]), "y": np.array([-1.0, 1.0]), "z": np.zeros((2, 2))},
    )
