"""A sensor that has stopped is found out; one that counts in steps is believed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from octo.model.gallery import mammal
from octo.mpc import CommandStatus, Controller, walking_problem

STALE = CommandStatus.STALE
ROBOT = mammal()
TICK = 0.01  # s


@pytest.fixture
def controller() -> Controller:
    return Controller(walking_problem(ROBOT, steps=12))


def standing(controller: Controller) -> tuple[np.ndarray, np.ndarray]:
    """q (nq,) and v (nv,) of the start at rest."""
    return controller.convention.from_octo(controller.problem.start, np.zeros(ROBOT.nx))


def statuses(controller: Controller, readings) -> list[CommandStatus]:
    return [controller.step(TICK * k, q, v).status for k, (q, v) in enumerate(readings)]


def counted(values: np.ndarray, step: float) -> np.ndarray:
    return np.round(values / step) * step


@pytest.mark.parametrize("step", [1e-4, 1e-3, 2 * np.pi / 4096])
def test_a_slow_robot_read_in_steps_is_controlled_at_every_tick(controller, step):
    """It sways by a millirad: most readings are the ones before, bit by bit."""
    q, v = standing(controller)
    readings = []
    for k in range(60):
        angle, rate = 1e-3 * np.sin(2.0 * TICK * k), 2e-3 * np.cos(2.0 * TICK * k)
        place, speed = q.copy(), v.copy()
        place[7:], speed[6:] = counted(q[7:] + angle, step), counted(v[6:] + rate, 1e-3)
        readings.append((place, speed))
    equal = sum((a[0] == b[0]).all() and (a[1] == b[1]).all() for a, b in pairwise(readings))
    assert equal > 10
    assert STALE not in statuses(controller, readings)


def test_one_step_of_velocity_that_stays_is_no_fault_for_a_while(controller):
    q, v = standing(controller)
    v[8] = 0.01  # rad/s
    found = statuses(controller, [(q, v)] * 100)
    assert STALE not in found


def test_a_frozen_reading_of_a_moving_robot_is_stale_after_20_milliradians(controller):
    q, v = standing(controller)
    v[8] = 1.0
    found = statuses(controller, [(q, v)] * 30)
    assert STALE not in found[:2] and set(found[4:]) == {STALE}


def test_readings_that_never_repeat_are_frozen_at_the_first_repetition(controller):
    q, v = standing(controller)
    moving = [(q, v + 1e-3 + 1e-5 * k) for k in range(5)]
    found = statuses(controller, [*moving, moving[-1]])
    assert STALE not in found[:5] and found[5] is STALE


def test_a_frozen_sensor_that_moves_again_is_believed(controller):
    q, v = standing(controller)
    moving = [(q, v + 0.5 + 1e-3 * k) for k in range(5)]
    found = statuses(controller, [*moving, moving[-1], moving[-1], (q, v + 0.6)])
    assert found[5:7] == [STALE] * 2 and found[7] is not STALE


def test_a_robot_at_rest_reads_the_same_for_ever(controller):
    assert set(statuses(controller, [standing(controller)] * 200)) == {CommandStatus.SOLVED}
