"""Nothing raises in the loop, commands stay inside the limits, and the status says what
happened."""

from __future__ import annotations

import numpy as np
import pytest

from octo.errors import ValueRangeError
from octo.mpc import CommandStatus
from tests.mpc.conftest import inside


@pytest.fixture
def running(controller, plant, stand):
    stand(20)
    return controller


def kept(controller, plan):
    return controller.plan is plan


@pytest.mark.parametrize("where", ["q", "v", "both", "t"])
def test_not_finite(running, plant, robot, where):
    q, v, t, plan = plant.q.copy(), plant.v.copy(), 0.2, running.plan
    if where in ("q", "both"):
        q[9] = np.nan
    if where in ("v", "both"):
        v[0] = np.inf
    command = running.step(np.nan if where == "t" else t, q, v)
    assert command.status is CommandStatus.INVALID and command.iterations == 0
    assert kept(running, plan) and inside(command.u, robot.torque_limit)
    assert inside(running.command(0.2, q, v), robot.torque_limit)
    assert running.step(0.21, plant.q, plant.v).status is CommandStatus.SOLVED


def test_wrong_shape_or_no_orientation(running, plant, robot):
    plan = running.plan
    assert running.step(0.2, plant.q[:-1], plant.v).status is CommandStatus.INVALID
    q = plant.q.copy()
    q[3:7] = 0.0
    assert running.step(0.2, q, plant.v).status is CommandStatus.INVALID
    assert kept(running, plan)
    assert inside(running.command(0.2, plant.q[:-1], plant.v), robot.torque_limit)


def test_stale(running, plant):
    plan = running.plan
    # the time of the last one
    assert running.step(0.19, plant.q, plant.v).status is CommandStatus.STALE
    assert running.step(0.1, plant.q, plant.v).status is CommandStatus.STALE
    assert kept(running, plan)
    q, v = plant.q.copy(), plant.v.copy()
    assert running.step(0.2, q, v).status is CommandStatus.SOLVED
    assert running.step(0.21, q, v).status is CommandStatus.STALE  # a sensor that is frozen
    assert running.step(0.22, plant.q + 1e-9, v).status is CommandStatus.SOLVED


def test_the_plan_before_continues_shifted(running, plant):
    plan = running.plan
    bad = np.full_like(plant.q, np.nan)
    for k in range(30):
        t = 0.2 + 0.01 * k
        command = running.step(t, bad, plant.v)
        np.testing.assert_allclose(
            command.u, np.clip(plan.at(t)[2], -running.limit, running.limit), atol=1e-12
        )
    # long after its end: the last torques, joints at rest
    beyond = running.step(plan.end + 10.0, bad, plant.v)
    np.testing.assert_allclose(beyond.v[6:], 0.0, atol=0.2)


def test_a_call_after_the_plan_s_end_is_late_and_planned_anew(running, plant):
    late = running.step(running.plan.end + 0.5, plant.q, plant.v)
    assert late.status is CommandStatus.LATE
    assert running.plan.time == pytest.approx(late.valid_until - 20 * 0.04)


def test_a_budget_that_no_iteration_meets(running, plant, robot):
    plan = running.plan
    running.budget = 1e-6
    command = running.step(0.2, plant.q, plant.v)
    assert command.status is CommandStatus.BUDGET and kept(running, plan)
    assert inside(command.u, robot.torque_limit)


def test_a_budget_of_a_millisecond_returns_what_is_ready(running, plant, robot):
    running.budget, running.iterations = 1e-3, 50
    try:
        commands = [running.step(0.2 + 0.01 * k, plant.q + 1e-9 * k, plant.v) for k in range(30)]
    finally:
        running.iterations = 1
    assert all(inside(command.u, robot.torque_limit) for command in commands)
    assert max(command.iterations for command in commands) < 50
    assert {command.status for command in commands} <= {CommandStatus.SOLVED, CommandStatus.BUDGET}
    for command in commands:
        assert (command.iterations == 0) == (command.status is CommandStatus.BUDGET)


def test_more_iterations_never_return_a_worse_plan(running, plant):
    one = running.step(0.2, plant.q, plant.v)
    running.iterations = 6
    try:
        many = running.step(0.21, plant.q + 1e-9, plant.v)
    finally:
        running.iterations = 1
    assert 1 <= many.iterations <= 6
    assert many.violation <= one.violation + 1e-2


def test_a_plan_that_cannot_converge(running, plant, robot):
    """A measurement ten metres under the ground at 1,000 m/s: whatever is answered is finite,
    limited and says so."""
    q, v = plant.q.copy(), plant.v.copy()
    q[2] -= 10.0
    v[:3] = 1e3
    plan = running.plan
    command = running.step(0.2, q, v)
    assert command.status in (CommandStatus.DIVERGED, CommandStatus.FAILED)
    assert kept(running, plan) and inside(command.u, robot.torque_limit)
    assert running.step(0.21, plant.q, plant.v).status is CommandStatus.SOLVED


def test_weights_that_are_not_finite_are_no_plan(running, plant, robot):
    place = running.reference("BaseHeight", "height")
    held, plan = place.copy(), running.plan
    place[:] = np.nan
    command = running.step(0.2, plant.q, plant.v)
    place[:] = held
    assert command.status in (CommandStatus.DIVERGED, CommandStatus.FAILED)
    assert kept(running, plan) and inside(command.u, robot.torque_limit)
    assert running.step(0.21, plant.q + 1e-9, plant.v).status is CommandStatus.SOLVED


def test_a_plant_that_falls(running, plant, robot):
    """Thrown over: through roll 180° and beyond the controller answers every time, finite and
    inside the limits."""
    thrown = np.concatenate([[0.0, 0.0, 1.0, 9.0, 4.0, 2.0], np.zeros(robot.nu)])
    plant.reset(np.concatenate([plant.q[:2], [0.6], plant.q[3:]]), thrown)
    tilts = []
    for k in range(20, 120):
        command = running.step(0.01 * k, plant.q, plant.v)
        assert inside(command.u, robot.torque_limit) and np.isfinite(command.x).all()
        for j in range(5):
            u = running.command(0.01 * k + 0.002 * j, plant.q, plant.v)
            assert inside(u, robot.torque_limit)
            plant.step(u)
        tilts.append(plant.base_rotation[2, 2])
    assert min(tilts) < -0.5


def test_spin_or_orientation_that_nothing_has(running, plant, robot):
    for place, value in ((3, 1e200), (0, 1e5), (12, -1e308)):
        v = plant.v.copy()
        v[place] = value
        assert running.step(0.2, plant.q, v).status is CommandStatus.INVALID
        assert inside(running.command(0.2, plant.q, v), robot.torque_limit)
    for length in (1e-170, 1e-4, 1e4, 1e200):
        q = plant.q.copy()
        q[3:7] *= length
        assert running.step(0.2, q, plant.v).status is CommandStatus.INVALID
    q = plant.q.copy()
    q[3:7] *= 0.5  # the same orientation
    assert running.step(0.2, q, plant.v).status is CommandStatus.SOLVED


def test_what_is_no_measurement_at_all(running, plant, robot):
    q, v, plan = plant.q, plant.v, running.plan
    for wrong in (None, "q", [1.0, 2.0], {}, [[1.0], [1.0, 2.0]], 10**400):
        for call in ((0.2, wrong, v), (0.2, q, wrong), (wrong, q, v)):
            assert running.step(*call).status is CommandStatus.INVALID
            assert running.feedback(*call).status is CommandStatus.INVALID
            assert inside(running.command(*call), robot.torque_limit)
    for t in (np.nan, np.inf, -np.inf):
        assert inside(running.command(t, q, v), robot.torque_limit)
    assert kept(running, plan)


def test_prepare_at_no_time_is_for_the_next_tick(running, plant):
    for t in (np.nan, np.inf, None, "now"):
        running.prepare(t)
        assert running._prepared == pytest.approx(0.2)
    running.reset()
    running.prepare(np.nan)  # before any measurement
    assert running.step(0.0, plant.q, plant.v).status is CommandStatus.SOLVED


def test_lists_are_measurements(running, plant):
    q, v = plant.q.copy(), plant.v.copy()
    before = running.command(0.2, q, v)
    np.testing.assert_array_equal(running.command(0.2, q.tolist(), v.tolist()), before)
    assert running.step(0.2, q.tolist(), v.tolist()).status is CommandStatus.SOLVED


@pytest.mark.parametrize("glitch", [1e9, 1e300, -1e9])
def test_one_wrong_time_changes_nothing(running, plant, glitch):
    plan = running.plan
    assert running.step(glitch, plant.q, plant.v).status in (
        CommandStatus.INVALID,
        CommandStatus.STALE,
    )
    assert kept(running, plan)
    assert running.step(0.2, plant.q, plant.v).status is CommandStatus.SOLVED


@pytest.mark.parametrize("start", [1e6, -1e6])
def test_a_clock_that_was_set_anew_is_followed(running, plant, start):
    statuses = [
        running.step(start + 0.01 * k, plant.q + 1e-9 * k, plant.v).status for k in range(4)
    ]
    assert not statuses[0].fresh and all(status.fresh for status in statuses[1:])
    assert statuses[2] is CommandStatus.SOLVED and running.plan.time == pytest.approx(start + 0.03)


def test_a_first_measurement_may_have_any_time(running, plant):
    running.reset(plant.q, plant.v)
    assert running.step(1.7e9, plant.q, plant.v).status.fresh
    assert not running.step(0.2, plant.q + 1e-9, plant.v).status.fresh
    assert running.step(0.21, plant.q + 2e-9, plant.v).status.fresh


def test_a_reset_to_what_is_no_state(running, plant):
    q = plant.q.copy()
    q[3:7] = 0.0
    for place in (q, np.full_like(q, np.nan)):
        with pytest.raises(ValueRangeError, match="q and v must be finite"):
            running.reset(place)
