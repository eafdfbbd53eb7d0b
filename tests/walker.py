"""A small robot with everything a cost can look at, its start in the ground, and a motion close to
it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from octo.model.character import Body, Character, ContactSphere, Joint, floating_base
from octo.problem.basis import Hermite
from octo.problem.compiled import CompiledProblem

BASES = {"nodes": "nodes", "hermite": Hermite(3)}
# front and foot in the ground, back above
START = np.array([0.02, -0.01, 0.44, 0.1, 0.05, -0.04, 0.3, -0.4, 0.01])


@lru_cache
def walker() -> Character:
    """A base with a leg of two links and a slide on top; its first sphere does not touch the
    terrain."""
    y, z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    inertia = np.diag([0.02, 0.03, 0.025])
    hip = Joint("hip", "hinge", y, lower=-1.0, upper=1.0, torque_limit=8.0)
    knee = Joint("knee", "hinge", y, lower=-1.5, upper=0.2, torque_limit=6.0, armature=0.01)
    mast = Joint("mast", "slide", z, lower=-0.1, upper=0.1, damping=0.5)
    bodies = (
        Body(
            "base", -1, floating_base(), mass=2.0, inertia=inertia, com=np.array([0.02, 0.0, 0.01])
        ),
        Body(
            "thigh",
            0,
            (hip,),
            np.array([0.0, 0.1, -0.05]),
            mass=0.5,
            inertia=0.2 * inertia,
            com=np.array([0, 0, -0.1]),
        ),
        Body(
            "shank",
            1,
            (knee,),
            np.array([0.0, 0.0, -0.2]),
            mass=0.3,
            inertia=0.1 * inertia,
            com=np.array([0, 0, -0.1]),
        ),
        Body("mast", 0, (mast,), np.array([0.0, 0.0, 0.1]), mass=0.2, inertia=0.1 * inertia),
    )
    places = (
        ("top", 3, (0.0, 0.0, 0.1)),
        ("foot", 2, (0.0, 0.0, -0.2)),
        ("front", 0, (0.2, 0.0, -0.42)),
        ("back", 0, (-0.2, 0.1, -0.39)),
    )
    spheres = tuple(
        ContactSphere(n, b, np.array(at), 0.03, touches_terrain=n != "top") for n, b, at in places
    )
    return Character("walker", bodies, spheres, pairs=((0, 1),))


def wiggle_near_ground(problem: CompiledProblem, seed: int = 0) -> np.ndarray:
    """(batch, K, nc) unknowns of a motion close to the ground that starts at the start."""
    random = np.random.default_rng(seed)
    times = np.linspace(0.0, 1.0, problem.steps + 2)[:, None]
    waves = sum(
        np.sin((k + 1) * times) * random.uniform(-0.06, 0.06, (problem.batch, 1, problem.n))
        for k in range(4)
    )
    return problem.unknowns(problem.start[:, None] + waves)
