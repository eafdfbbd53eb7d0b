"""A body at rest on the ground: where it lies and how it sags."""

from __future__ import annotations

import numpy as np

from octo.checks import Array
from octo.dynamics.evaluate import Dynamics
from octo.dynamics.simulate import Stepper
from octo.errors import StaticPoseError

FALLING, SETTLING = 0.05, 4.0  # s of a step: inertia and friction hold it back less and less
STEPS = 60
FORCE = 1e-8  # relative to the weight, what is left


def at_rest(dynamics: Dynamics, p: Array, x: Array, name: str) -> Array:
    """The configuration (n,) without a motor's force that the body comes to from ``x`` (n,), which
    is on the ground: steps of growing length, each begun without speed.

    Raises
    ------
    StaticPoseError: it rolls or slides on, or its modes give way.
    """
    own, place, dt = p.copy(), dynamics.layout.index("dt"), FALLING
    left = np.inf
    for _ in range(STEPS):
        own[place] = dt
        x, missed = Stepper(dynamics, own)(x, x)
        left = _force(dynamics, p, x)
        if left <= FORCE * dynamics.weight:
            return x
        dt = min(SETTLING, 1.5 * dt) if np.isfinite(missed) else FALLING
    raise StaticPoseError(
        f"{name} comes to no rest: {left:.2g} N are left of {dynamics.weight:.3g} N after {STEPS} "
        "steps: give x0"
    )


def _force(dynamics: Dynamics, p: Array, x: Array) -> float:
    """The largest entry of FD where nothing moves."""
    return float(np.abs(dynamics.evaluate(np.repeat(x[None, None], 3, axis=1), p[None])[0]).max())
