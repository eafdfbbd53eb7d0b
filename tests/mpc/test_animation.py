"""A long motion by short horizons."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.errors import ProblemError
from octo.mpc import animate


@pytest.fixture(scope="module")
def horizon():
    costs = [octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()]
    return octo.Problem(octo.gallery.chain(), steps=24, dt=0.025, costs=costs)


@pytest.fixture(scope="module")
def motion(horizon):
    return animate(horizon, 1.5, advance=6)


def test_the_motion_is_as_long_as_asked_and_obeys_physics(motion, horizon):
    assert motion.steps == 60 and len(motion.history["energy"]) == 10
    np.testing.assert_array_equal(motion.x[1], horizon.start)
    assert motion.converged
    residual = horizon.dynamics.evaluate(motion.x[None], horizon.p[None])[0][0][
        :, horizon.dynamics.unactuated
    ]
    # of the weight, at every step of all plans
    assert np.abs(residual * horizon.row_scale).max() < 1e-2
    assert motion.com[-1, 0] - motion.com[0, 0] > 0.3


def test_its_kept_steps_are_those_of_the_plans(motion):
    """No jump where one plan takes over from another: joint rates change no faster there than
    elsewhere."""
    rate = np.diff(motion.x, axis=0) / motion.dt
    change = np.abs(np.diff(rate, axis=0)).max(axis=1)
    seams = np.arange(6, 60, 6)
    assert np.median(change[seams]) < 3.0 * np.median(change)


def test_refused(horizon):
    with pytest.raises(ProblemError, match="nodes"):
        animate(horizon.replace(basis="hermite", steps=20), 1.0)
    cycle = octo.Cycle(speed=0.4, period=0.6)
    stride = octo.Problem(octo.gallery.mammal(), steps=12, costs=[octo.Effort()], cycle=cycle)
    for wants in (lambda: animate(stride, 1.0), lambda: octo.mpc.Controller(stride)):
        with pytest.raises(ProblemError, match="cycle is given"):
            wants()
