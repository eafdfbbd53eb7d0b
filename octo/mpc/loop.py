"""The loop around a controller: a plant, its sensors, a clock; and a log of what happened."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from octo.checks import number, positive, whole
from octo.errors import ProblemError, ValueRangeError
from octo.model.quantities import Array
from octo.mpc.command import Command
from octo.mpc.controller import Controller
from octo.mpc.disturbance import Push, Sensors
from octo.mpc.log import Log
from octo.mpc.machine import Plant
from octo.mpc.record import memory_in_use
from octo.plant.fall import fallen
from octo.world.world import World

__all__ = ["Plant", "Push", "Sensors", "run", "timing"]


def run(
    controller: Controller,
    plant: Plant,
    seconds: float,
    *,
    rate: float = 100.0,
    realtime: bool = False,
    noise: float = 0.0,
    delay: int = 0,
    push: Push | None = None,
    seed: int = 0,
    each: Callable[[float, Controller], None] | None = None,
) -> Log:
    """Close the loop for ``seconds``; falls (of a floating base) are counted, and the plant is put
    back once.

    Parameters
    ----------
    controller: its plan is followed from the start.
    plant: what moves, an ``octo.plant.MujocoPlant`` or one of your own.
    push: a force on the base for a time.
    rate: Hz, of the controller's calls; a tick is a whole number of the plant's time steps.
    realtime: the plant runs at the pace of the clock and the controller in its own thread, late
        where it is slow: a tick with no command by its end is logged as one, and the plan before
        goes on. Otherwise the plant waits.
    noise: of the sensors, 1 is that of a robot's estimator. delay: ticks between a measurement and
        the command from it; as long after the start and after a fall the controller's first plan is
        followed, and no call is made.
    each: called as ``each(t, controller)`` before every call of the controller, to change its
        references.

    Returns
    -------
    The log; at Ctrl-C what there is of it, from two ticks on, with ``interrupted`` set.

    Raises
    ------
    ValueRangeError: naming the argument. ProblemError: not a controller, a plant or a push; a push
        on a base that does not float.
    Once the loop runs only what a guide or ``each`` raises comes through.
    """
    _check_kinds(controller, plant, push, each)
    tick, count, ticks = timing(seconds, rate, plant.timestep, push, delay)
    whole("seed", seed, 0)
    if number("noise", noise) < 0.0:
        raise ValueRangeError(f"noise is {noise}, must not be negative")
    _check_base(plant, push)
    sensors = Sensors(plant.character, noise, seed)
    loop = _Loop(controller, plant, tick, count, sensors, delay, push, each, ticks)
    return loop.realtime() if realtime else loop.synchronous()


def _check_base(plant: Plant, push: Push | None) -> None:
    if push is not None and plant.character.base != "floating":
        raise ProblemError(
            f"push needs a floating base: the base of {plant.character.name!r} is fixed"
        )


def _check_kinds(controller: object, plant: object, push: object, each: object) -> None:
    plants = "a MujocoPlant, a SimulatorPlant or their like"
    for name, value, good, wanted in (
        ("controller", controller, isinstance(controller, Controller), "a Controller"),
        ("plant", plant, hasattr(plant, "contacts"), plants),
        ("push", push, push is None or isinstance(push, Push), "a Push"),
        ("each", each, each is None or callable(each), "a function each(t, controller)"),
    ):
        if not good:
            raise ProblemError(f"{name} is {type(value).__name__!r}, must be {wanted}")


MOST_TICKS = 10_000_000  # a day at 100 Hz: the log is held in memory
HUGE = 1e15  # a number that is still a whole one


def timing(
    seconds: float, rate: float, timestep: float, push: Push | None = None, delay: int = 0
) -> tuple[float, int, int]:
    """A tick (s), the plant's time steps in it, and the ticks of a motion.

    Raises
    ------
    ValueRangeError: naming the argument.
    """
    positive("seconds", seconds, "s")
    tick = 1.0 / positive("rate", rate, "Hz")
    count = round(min(tick / timestep, HUGE))
    if count < 1 or abs(count * timestep - tick) > 1e-9 * tick + 1e-12:
        raise ValueRangeError(
            f"rate is {rate} Hz, a tick must be a whole number of the plant's steps of {timestep} s"
        )
    ticks = round(min(seconds / tick, HUGE))
    if ticks < 2:
        raise ValueRangeError(f"seconds is {seconds}, must be at least two ticks: {2.0 * tick:g}")
    if ticks > MOST_TICKS:
        raise ValueRangeError(
            f"seconds is {seconds:g}, must be at most {MOST_TICKS} ticks: {MOST_TICKS * tick:g}"
        )
    if whole("delay", delay, 0) >= ticks:
        raise ValueRangeError(
            f"delay is {delay} ticks, must be less than those of the motion: {ticks}"
        )
    if push is not None and push.start >= ticks * tick:
        raise ValueRangeError(
            f"push begins at t = {push.start:g} s, seconds is {seconds:g}: it must end later than "
            "that"
        )
    return tick, count, ticks


class _Loop:
    def __init__(
        self,
        controller: Controller,
        plant: Plant,
        tick: float,
        count: int,
        sensors: Sensors,
        delay: int,
        push: Push | None,
        each: Callable[[float, Controller], None] | None,
        ticks: int,
    ):
        self.controller, self.plant, self.tick, self.count = controller, plant, tick, count
        self.sensors, self.push, self.each = sensors, push, each
        self.queue: deque[tuple[float, Array, Array]] = deque(maxlen=delay + 1)
        self._seen = controller.convention.of_mujoco
        self.start, self.height = plant.q.copy(), plant.height
        self.fallen = self.over = False
        self.impulse = 0.0
        self.lock, self.stop, self.fresh = threading.Lock(), threading.Event(), threading.Event()
        self.latest: Command | None = None
        self.answered = -np.inf  # s, the time of the measurement of the last call
        # a reset that the controller's thread has yet to do
        self.anew: tuple[float, Array, Array] | None = None
        self.error: BaseException | None = None
        self.ticks = ticks
        self.log = Log.empty(plant.character, tick, controller, ticks)
        terrain = getattr(plant, "terrain", None)
        self.log.shapes = terrain if isinstance(terrain, World) else None

    def synchronous(self) -> Log:
        self._begin()
        with self._until_interrupted():
            for k in range(self.ticks):
                self._wait_for_all(k * self.tick)
        return self._end()

    def _wait_for_all(self, t: float) -> None:
        """A tick in which the plant waits for the controller."""
        self._measure(t)
        measured = self._arrived()
        command = None if measured is None else self._call(measured, t)
        self._run_tick(t)
        self.log.record(t, self.plant, command, measured is not None)
        if self._look(t):
            self.queue.clear()
            self.controller.reset(*self._seen(self.plant.q, self.plant.v), t + 0.5 * self.tick)

    @contextmanager
    def _until_interrupted(self) -> Iterator[None]:
        """Ctrl-C ends the loop; what was logged is kept if it is a motion."""
        try:
            yield
        except KeyboardInterrupt:
            if self.log.count < 2:
                raise
            self.log.interrupted = True

    def _begin(self) -> None:
        self.controller.reset(*self._seen(self.plant.q, self.plant.v), 0.0)
        self.log.memory_start = memory_in_use()

    def _end(self) -> Log:
        self.log.memory_end = memory_in_use()
        self.log.impulses = [self.impulse] if self.push is not None else []
        self.log.finish()
        return self.log

    def _measure(self, t: float) -> None:
        self.sensors.draw()
        q, v = self._seen(*self.sensors.read(self.plant.q, self.plant.v))
        with self.lock:
            self.queue.append((t, q, v))

    def _arrived(self) -> tuple[float, Array, Array] | None:
        """The newest measurement that the delay has let through."""
        return self.queue[0] if len(self.queue) == self.queue.maxlen else None

    def _call(self, measured: tuple[float, Array, Array], t: float | None = None) -> Command:
        if self.each is not None:
            self.each(measured[0] if t is None else t, self.controller)
        self.answered = measured[0]
        return self.controller.step(*measured)

    def _run_tick(self, t: float, began: float | None = None) -> None:
        """One tick of the plant; step by step at the clock's pace where time 0 was at ``began``."""
        plant, step = self.plant, self.plant.timestep
        for k in range(self.count):
            now = t + k * step
            if began is not None:
                self._wait(began + now)
            q, v = self._seen(*self.sensors.read(plant.q, plant.v))
            u = self.controller.command(now, q, v)
            if self.push is not None:
                plant.push = self.push.at(now, plant.base_rotation)
                self.impulse += float(np.linalg.norm(plant.push)) * step
            plant.step(u)
        self.log.torque = u

    def _look(self, t: float) -> bool:
        """Count a fall, put the plant back once: whether the controller must begin anew."""
        plant = self.plant
        if plant.character.base != "floating":
            return False
        down = fallen(plant.height, self.height, plant.base_rotation[2, 2])
        if not down or self.fallen:
            self.fallen = down
            return False
        self.log.falls.append(t)
        self.fallen = self.over
        if self.over:
            return False
        self.over = True
        plant.reset(self.start)
        return True

    def realtime(self) -> Log:
        """The plant at the clock's pace, the controller in its own thread, a lock between."""
        self._begin()
        self._measure(0.0)
        first = self._arrived()
        self.latest = None if first is None else self._call(first)
        thread = threading.Thread(target=self._control, daemon=True)
        thread.start()
        began = time.perf_counter()
        try:
            with self._until_interrupted():
                for k in range(self.ticks):
                    self._pace(k * self.tick, began)
                    if self.error is not None:
                        break
        finally:
            self.stop.set()
            self.fresh.set()
            thread.join()
        if self.error is not None:
            raise self.error
        return self._end()

    def _pace(self, t: float, began: float) -> None:
        """A tick: it begins with a measurement, and ends with the command that came meanwhile."""
        self._wait(began + t)
        if t > 0.0:
            self._measure(t)
            self.fresh.set()
        self._run_tick(t, began)
        self._wait(began + t + self.tick)
        with self.lock:
            command, self.latest = self.latest, None
            arrived = self._arrived() is not None
        self.log.record(t, self.plant, command, arrived)
        if self._look(t):
            with self.lock:
                self.queue.clear()
                now = self._seen(self.plant.q.copy(), self.plant.v.copy())
                self.anew = (t + 0.5 * self.tick, *now)
            self.fresh.set()

    def _control(self) -> None:
        try:
            self._answer()
        except BaseException as error:  # raised again in the plant's thread
            self.error = error

    def _answer(self) -> None:
        while not self.stop.is_set():
            self.fresh.wait(0.1)
            self.fresh.clear()
            with self.lock:
                anew, self.anew = self.anew, None
                measured = self._arrived()
            if anew is not None:
                t, q, v = anew
                self.controller.reset(q, v, t)
            if measured is None or measured[0] <= self.answered:
                continue
            command = self._call(measured)
            with self.lock:
                self.latest = command
            if command.seconds <= self.tick:
                self.controller.prepare()

    @staticmethod
    def _wait(until: float) -> None:
        left = until - time.perf_counter()
        if left > 0.0:
            time.sleep(left)
