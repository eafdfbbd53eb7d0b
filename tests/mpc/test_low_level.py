"""The low level against its formula, and while plans change under it."""

from __future__ import annotations

import sys
import threading

import numpy as np
import pytest

from benchmarks.held import held
from octo.mpc.low_level import LowLevel
from octo.mpc.plan import Grid, Plan


@pytest.fixture(params=[False, True], ids=["compiled", "interpreted"])
def interpreted(request, monkeypatch):
    if request.param:
        monkeypatch.setattr("octo.native.load", lambda text: None)  # as without a compiler
    return request.param


@pytest.fixture
def made(interpreted):
    """A low level of six joints in twelve coordinates, two of them before the base's, and a plan of
    five steps."""
    rng = np.random.default_rng(0)
    grid = Grid(5, 0.04, np.array([0, 1, 8, 9, 10, 11]), 12)
    plan = Plan(grid, 2.0, rng.standard_normal((7, 12)), rng.standard_normal((5, 6)))
    q_at = np.array([0, 1, 9, 10, 11, 12])
    limit = np.array([3.0, 3.0, 0.5, np.inf, 3.0, 3.0])
    return (
        grid,
        plan,
        q_at,
        LowLevel(grid, q_at, rng.uniform(1.0, 2.0, 6), rng.uniform(0.1, 0.2, 6), limit),
    )


@pytest.mark.parametrize("t", [-1.0, 2.0, 2.013, 2.1, 2.1999, 2.2, 2.27, 2.41, 3.0, 1e300])
def test_it_follows_the_plan_with_springs_and_dampers(made, interpreted, t):
    """Also before the plan's start and after its end, where the base goes on and the joints come to
    rest."""
    grid, plan, q_at, low = made
    rng = np.random.default_rng(1)
    q, v = 0.1 * rng.standard_normal(13), 0.1 * rng.standard_normal(12)
    x, rate, u = plan.at(t)
    wanted = (
        u
        + low.kp * (x[grid.actuated] - q[q_at])
        + low.kd * (rate[grid.actuated] - v[grid.actuated])
    )
    np.testing.assert_allclose(
        low(plan, t, q, v), np.clip(wanted, -low.limit, low.limit), rtol=1e-12, atol=1e-12
    )
    assert (low._entry is None) == interpreted


def test_a_joint_that_is_not_measured_follows_the_plan_s_torque(made):
    _, plan, q_at, low = made
    whole = low(plan, 2.05, np.zeros(13), np.zeros(12))
    for value in (np.nan, np.inf, -1.79e308):
        q = np.zeros(13)
        q[q_at[1]], q[q_at[3]] = value, value
        u = low(plan, 2.05, q, np.zeros(12))
        np.testing.assert_allclose(u[[1, 3]], plan.at(2.05)[2][[1, 3]], atol=1e-12)
        np.testing.assert_array_equal(u[[0, 2, 4, 5]], whole[[0, 2, 4, 5]])
        assert np.isfinite(u).all()
    for t in (np.nan, np.inf, -np.inf):
        np.testing.assert_array_equal(
            low(plan, t, np.zeros(13), np.zeros(12)), low(plan, 2.0, np.zeros(13), np.zeros(12))
        )


def test_a_plan_is_never_changed(made):
    plan = made[1]
    with pytest.raises(ValueError, match="read-only"):
        plan.x[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        plan.u[0] = 0.0


def test_every_command_is_of_one_whole_plan(controller, plant, robot):
    """A thread reads commands while plans are made and forgotten: each is what one of the plans
    says, whole."""
    plans, answers, over = [controller.plan], [], threading.Event()
    take, q, v, t = controller._take, plant.q, plant.v, 0.05
    controller._take = lambda *args, **named: (take(*args, **named), plans.append(controller.plan))

    def hammer():
        while not over.is_set():
            answers.append(controller.command(t, q, v))

    thread, interval = threading.Thread(target=hammer), sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    thread.start()
    try:
        for k in range(6):
            moved = q.copy()
            moved[7:] += 0.3 * np.sin(k + np.arange(robot.nu))
            controller.reset(moved, v, 0.0)
            for j in range(5):
                controller.step(0.01 * (j + 1), moved + 1e-9 * j, v)
    finally:
        over.set()
        thread.join()
        sys.setswitchinterval(interval)
        del controller._take
    said = []
    for plan in plans:
        x, rate, u = plan.at(t)
        wanted = u + controller.kp * (x[6:] - q[7:]) + controller.kd * (rate[6:] - v[6:])
        said.append(np.clip(wanted, -robot.torque_limit, robot.torque_limit))
    different = np.unique(np.array(answers), axis=0)
    assert len(different) > 6
    for u in different:
        assert np.abs(np.array(said) - u).max(axis=1).min() < 1e-9


def test_a_loop_that_runs_holds_no_more_memory(controller, plant):
    """Six hundred calls: octo's Python holds at the end what it held before, but for a few
    numbers."""
    assert held(controller, plant, 100, 600)[0] < 200
