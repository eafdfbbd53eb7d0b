"""The loop: falls, pushes, noise and delay, two plants, real time, and what the log says of
them."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

import octo
from octo.errors import ValueRangeError
from octo.mpc import Controller, Push, VelocityCommand, run, walking_problem
from octo.mpc.loop import Sensors
from octo.plant import MujocoPlant, SimulatorPlant

REALTIME = pytest.mark.parametrize("realtime", [pytest.param(True, marks=pytest.mark.timed), False])


@pytest.fixture(scope="module")
def walked(problem, robot):
    """Four seconds at 0.3 m/s in MuJoCo, not stepped on by other tests."""
    plant = MujocoPlant(robot)
    plant.reset_chart(problem.start)
    return run(Controller(problem, guide=VelocityCommand((0.3, 0.0))), plant, 4.0)


def test_it_walks_without_a_gait(walked, robot):
    report = walked.report()
    assert report["falls"] == 0 and report["statuses"] == {"solved": 400}
    assert report["velocity"][0] == pytest.approx(0.3, abs=0.06)
    assert report["foot_lift"] > 0.02
    assert report["tracking_error"]["velocity"] < 0.06
    lifted = walked.force[150:, walked.feet, 2] < 1.0
    assert lifted.any(axis=0).all()  # every foot leaves the ground


def test_report_has_the_fields_of_the_file(walked):
    report = walked.report()
    assert set(report["latency"]) == {"p50", "p95", "p99", "max"}
    assert (
        report["latency"]["p50"]
        <= report["latency"]["p95"]
        <= report["latency"]["p99"]
        <= report["latency"]["max"]
    )
    assert set(report["tracking_error"]) == {"velocity", "yaw_rate"}
    names = {
        "rate",
        "missed_deadlines",
        "falls",
        "statuses",
        "torque_excess",
        "pushes",
        "memory_start",
        "memory_end",
    }
    assert names <= set(report) and report["rate"] == 100.0 and report["pushes"] == []


def test_slip_is_the_speed_of_what_touches(walked):
    """A foot that only rolls does not slip: the centres of the spheres move faster than the points
    under them."""
    assert walked.slip_speeds.mean() < 0.1
    assert walked.slip >= walked.slip_speeds.mean()


def test_the_motion_is_drawn_and_saved(walked, tmp_path):
    walked.save(tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz") as file:
        np.testing.assert_array_equal(file["x"], walked.x)
        assert len(file["statuses"]) == 400
    motion = walked.solution()
    assert motion.steps == 199 and motion.dt == pytest.approx(0.02)
    np.testing.assert_allclose(motion.com[-1][0], 1.1, atol=0.4)


def test_a_push_is_felt_and_counted(problem, robot):
    plant = MujocoPlant(robot)
    plant.reset_chart(problem.start)
    controller = Controller(problem, guide=VelocityCommand((0.0, 0.0)))
    log = run(controller, plant, 1.5, push=Push(15.0, 0.2, 90.0, start=0.5))
    assert log.report()["pushes"] == [pytest.approx(3.0)]
    left = log.v[:, 1]  # world y; the heading is x
    assert left[60:75].max() > 0.08 and abs(left[:49]).max() < 0.05
    assert log.report()["falls"] == 0


def test_push_turns_with_the_heading():
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        Push(2.0, 0.2, 90.0, 1.0).at(1.1, turned), [-2.0, 0.0, 0.0], atol=1e-12
    )
    assert not Push(2.0, 0.2, 90.0, 1.0).at(1.2, turned).any()


def test_falls_are_counted_once_and_the_plant_is_put_back_once(problem, robot):
    plant = MujocoPlant(robot)
    plant.reset_chart(problem.start)
    controller = Controller(problem, guide=VelocityCommand((0.0, 0.0)))
    controller.kp[:], controller.kd[:] = 0.0, 0.0
    controller.command = lambda t, q, v: np.zeros(robot.nu)  # motors off
    log = run(controller, plant, 2.0)
    assert len(log.falls) == 2 and log.falls[1] > log.falls[0]
    assert log.x[:, 2].min() < 0.5 * problem.start[2]


def test_noise_and_delay(problem, robot):
    plant = MujocoPlant(robot, payload=0.2)
    plant.reset_chart(problem.start)
    log = run(
        Controller(problem, guide=VelocityCommand((0.0, 0.0))),
        plant,
        1.5,
        noise=1.0,
        delay=1,
        seed=3,
    )
    assert log.report()["falls"] == 0
    assert log.statuses == ["nothing measured yet"] + ["solved"] * 149


def test_noise_has_the_size_it_says(robot):
    sensors = Sensors(robot, 2.0, seed=0)
    q, v = np.zeros(robot.nx + 1), np.zeros(robot.nx)
    q[3] = 1.0
    errors = []
    for _ in range(2000):
        sensors.draw()
        place, speed = sensors.read(q, v)
        errors.append(np.concatenate([place[:3], 2.0 * place[4:7], place[7:], speed]))
    size = np.std(errors, axis=0)
    np.testing.assert_allclose(size[:3], 3e-3, rtol=0.1)
    np.testing.assert_allclose(size[3 : 6 + robot.nu], 6e-3, rtol=0.1)
    np.testing.assert_allclose(size[-robot.nu :], 0.18, rtol=0.1)


def test_octo_s_own_simulation_is_a_plant(problem, robot):
    plant = SimulatorPlant(robot, law=problem.law)
    plant.reset_chart(problem.start)
    log = run(Controller(problem, guide=VelocityCommand((0.0, 0.0))), plant, 0.6)
    assert log.report()["falls"] == 0 and plant.unsolved == 0
    # later it starts to step, at a moment that rounding decides
    standing = log.force[len(log.force) // 2]
    assert np.sum(standing[:, 2]) == pytest.approx(9.81 * robot.mass, rel=0.2)


def test_both_plants_have_one_height_over_a_slope(robot, problem):
    slope = octo.Plane(slope=0.2, direction=0.5, height=0.1)
    x = problem.start.copy()
    x[:3] = 1.0, 2.0, 1.5
    heights = []
    for plant in (SimulatorPlant(robot, terrain=slope), MujocoPlant(robot, terrain=slope)):
        plant.reset_chart(x)
        heights.append(plant.height)
    normal = np.array([-np.sin(0.2) * np.cos(0.5), -np.sin(0.2) * np.sin(0.5), np.cos(0.2)])
    np.testing.assert_allclose(heights, normal @ (plant.base_place - [0.0, 0.0, 0.1]), atol=1e-12)


def test_simulator_plant_falls_freely(robot):
    plant = SimulatorPlant(robot)
    x = np.zeros(robot.nx)
    x[2] = 3.0
    plant.reset_chart(x)
    plant.step(np.zeros(robot.nu), 0.2)
    assert plant.v[2] == pytest.approx(-9.81 * 0.2, rel=0.02)
    plant.push[:] = (robot.mass * 2.0, 0.0, 0.0)
    plant.step(np.zeros(robot.nu), 0.2)
    assert octo.model.kinematics.center_of_mass(robot, plant.x)[0] == pytest.approx(
        0.5 * 2.0 * 0.2**2, rel=0.1
    )


@pytest.mark.timed
def test_real_time(problem, robot):
    plant = MujocoPlant(robot)
    plant.reset_chart(problem.start)
    log = run(Controller(problem, guide=VelocityCommand((0.0, 0.0))), plant, 1.0, realtime=True)
    assert len(log.t) == 100 and log.report()["falls"] == 0
    assert {"solved"} <= set(log.statuses)


class Slow(VelocityCommand):
    def __init__(self, velocity, seconds=0.04):
        super().__init__(velocity)
        self.seconds = seconds

    def __call__(self, controller, t, x):
        super().__call__(controller, t, x)
        time.sleep(self.seconds)


@pytest.mark.timed
def test_a_slow_controller_does_not_hold_up_the_plant(problem, robot):
    plant = MujocoPlant(robot)
    plant.reset_chart(problem.start)
    controller = Controller(problem, guide=Slow((0.0, 0.0)))
    began = time.perf_counter()
    log = run(controller, plant, 1.0, realtime=True)
    assert 1.0 <= time.perf_counter() - began < 2.5  # 5 if each call held up a period
    calls = int(np.isfinite(log.seconds).sum())
    assert (
        len(log.t) == 100
        and 10 <= calls <= 26
        and len(set(log.seconds[np.isfinite(log.seconds)])) == calls
    )
    report = log.report()
    assert report["statuses"]["no new command"] == report["missed_deadlines"] == 100 - calls
    assert report["latency"]["p50"] >= 0.04 and np.isfinite(report["torque_excess"])
    assert log.solution().steps == 49 and np.isfinite(log.solution().seconds)


@pytest.mark.timed
def test_real_time_falls_and_goes_on(problem, robot):
    plant = MujocoPlant(robot)
    plant.reset_chart(problem.start)
    controller = Controller(problem, guide=VelocityCommand((0.0, 0.0)))
    resets, threads, reset = [], [], controller.reset
    controller.reset = lambda *args: (
        resets.append(args),
        threads.append(threading.get_ident()),
        reset(*args),
    )
    log = run(controller, plant, 2.5, realtime=True, push=Push(400.0, 0.2, 90.0, start=0.2))
    # at the start, and after the fall
    assert len(log.falls) >= 1 and len(resets) == 2 and threads[0] != threads[1]
    # on a slow machine some ticks come without a command
    assert "solved" in log.statuses[int(100 * log.falls[0]) + 1 :]
    assert log.x[int(100 * log.falls[0]) + 3, 2] > 0.8 * problem.start[2]  # put back


@REALTIME
def test_what_each_raises_comes_through(controller, plant, realtime):
    def each(t, _):
        if t > 0.1:
            raise ZeroDivisionError("of the caller")

    with pytest.raises(ZeroDivisionError, match="of the caller"):
        run(controller, plant, 1.0, realtime=realtime, each=each)


def test_it_climbs_a_slope_that_it_knows(robot):
    """8° up for four seconds: the height that is held is that over the ground ahead."""
    slope = octo.Plane(slope=np.radians(8.0))
    problem = walking_problem(robot, 20, terrain=slope)
    plant = MujocoPlant(robot, terrain=slope)
    plant.reset_chart(problem.start)
    log = run(Controller(problem, guide=VelocityCommand((0.2, 0.0))), plant, 4.0)
    assert log.report()["falls"] == 0
    gone = log.x[-1, :3] - log.x[0, :3]
    assert gone[0] > 0.5 and gone[2] == pytest.approx(np.tan(np.radians(8.0)) * gone[0], abs=0.02)
    assert 0.02 < log.foot_lift < 0.12  # over the slope, not over the level


@pytest.mark.parametrize(
    "values", [{"seconds": 0.0}, {"rate": 300.0}, {"noise": -1.0}, {"delay": -1}, {"delay": 100}]
)
def test_refused(controller, plant, values):
    with pytest.raises(ValueRangeError, match=next(iter(values))):
        run(controller, plant, **{"seconds": 1.0, **values})


@REALTIME
def test_a_delay_is_no_missed_deadline(controller, plant, realtime):
    """Until the first measurement is through nothing is asked of the controller, and its first plan
    is followed."""
    times, step = [], controller.step
    controller.step = lambda t, q, v: (times.append(t), step(t, q, v))[1]
    try:
        log = run(controller, plant, 0.4, delay=3, realtime=realtime)
    finally:
        del controller.step
    assert (
        log.statuses[:3] == ["nothing measured yet"] * 3
        and "nothing measured yet" not in log.statuses[3:]
    )
    assert np.isnan(log.seconds[:3]).all() and times[0] == 0.0 and len(set(times)) == len(times)
    if realtime:
        # not all of them
        assert log.report()["missed_deadlines"] == log.statuses.count("no new command") < 37
    else:
        assert log.statuses[3:] == ["solved"] * 37 and len(times) == 37
        assert plant.height > 0.9 * controller.problem.start[2]


@pytest.mark.timed
def test_a_controller_that_never_answers_has_a_report(problem, robot):
    plant = MujocoPlant(robot)
    plant.reset_chart(problem.start)
    guide = Slow((0.0, 0.0), seconds=0.2)
    log = run(Controller(problem, guide=guide), plant, 0.05, realtime=True, delay=1)
    report = log.report()
    assert (
        report["statuses"] == {"nothing measured yet": 1, "no new command": 4}
        and report["missed_deadlines"] == 4
    )
    assert (
        np.isnan(report["latency"]["p50"])
        and np.isnan(report["torque_excess"])
        and "4 missed" in str(log)
    )


@REALTIME
def test_a_controller_in_pinocchio_s_form_is_given_it(problem, robot, realtime):
    """Moving at the start and not along its heading, so that world and body axes differ."""
    start, rate = problem.start.copy(), np.zeros(robot.nx)
    start[3:6], rate[:6] = (1.2, 0.1, 0.1), (0.3, 0.2, 0.0, 0.5, 0.3, 0.2)
    logs = []
    for convention in ("mujoco", "pinocchio"):
        plant = MujocoPlant(robot)
        plant.reset_chart(start, rate)
        controller = Controller(problem, convention=convention)
        logs.append(run(controller, plant, 0.4, noise=0.3, realtime=realtime))
    np.testing.assert_allclose(logs[1].x[:5], logs[0].x[:5], atol=0.1 if realtime else 1e-6)
    assert logs[1].statuses.count("solved") >= (10 if realtime else 40)
    assert logs[1].falls == [] and logs[1].x[-1, 2] > 0.8 * start[2]


@REALTIME
def test_ctrl_c_keeps_the_log_so_far(controller, plant, realtime):
    contacts, calls = plant.contacts, []

    def interrupted():
        calls.append(0)
        if len(calls) > 30:
            raise KeyboardInterrupt
        return contacts()

    plant.contacts = interrupted
    log = run(controller, plant, 5.0, realtime=realtime)
    assert log.interrupted and log.report()["interrupted"] and len(log.t) == len(log.statuses) == 30
    assert log.solution().steps == 14
    calls[:] = [0] * 29
    with pytest.raises(KeyboardInterrupt):  # one tick is no motion
        run(controller, plant, 5.0, realtime=realtime)
