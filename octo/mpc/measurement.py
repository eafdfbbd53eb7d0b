"""What a controller takes: which problems, which measurements, which device."""

from __future__ import annotations

import logging
from functools import cache
from typing import Any

import numpy as np

from octo.checks import floats, instance, number
from octo.devices import check_device_name
from octo.dynamics.evaluate import RobotDynamics
from octo.errors import DeviceError, ProblemError, ShapeError, ValueRangeError
from octo.model.character import Character
from octo.model.convention import Convention
from octo.model.quantities import Array
from octo.problem.problem import Problem
from octo.problem.step_pairs import refuse_step_pairs
from octo.solver.receding import PAST

FARTHEST, FASTEST = 1e6, 1e4  # m and rad, m/s and rad/s: what is beyond that was not measured
LATEST = 1e11  # s, 3,000 years: neighbouring numbers are 15 µs apart there
SHORTEST, LONGEST = 1e-3, 1e3  # a quaternion


def robot_of(problem: Problem) -> Character:
    """The robot of a problem that a controller can plan by.

    Raises
    ------
    ProblemError: no problem, or one without a robot, without the basis "nodes", with a fixed end,
        a cycle, or too short.
    """
    instance("problem", problem, Problem, "an octo.Problem")
    if not isinstance(problem.dynamics, RobotDynamics) or problem.character is None:
        raise ProblemError(
            "a controller needs a robot: user-written dynamics have no configuration to measure"
        )
    if problem.cycle is not None:
        raise ProblemError(
            "cycle is given: a controller begins where the robot is, with a free end"
        )
    if problem.basis_object.name != "nodes" or problem.end is not None:
        basis = f"basis is {problem.basis_object.name!r}"
        found = basis if problem.end is None else "x_end is given"
        raise ProblemError(f"{found}: a controller needs the basis 'nodes' and a free end")
    refuse_step_pairs(problem.costs, "a controller")
    if problem.steps <= PAST:
        raise ProblemError(f"steps is {problem.steps}: a controller needs at least {PAST + 1}")
    return problem.character


def measured(value: Any, size: int) -> Array:
    """(size,) numbers, NaN where the value is nothing of that kind."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.full(size, np.nan)
    return array if array.shape == (size,) else np.full(size, np.nan)


def time_of(t: Any) -> float:
    """s; NaN where it is no number, or so far off that a tick later is the same number."""
    try:
        time = float(t)
    except (TypeError, ValueError, OverflowError):
        return float("nan")
    return time if abs(time) <= LATEST else float("nan")


def checked_time(t: Any) -> float:
    """s. Raises ValueRangeError where a clock cannot go on from there."""
    time = number("t", t)
    if abs(time) > LATEST:
        raise ValueRangeError(
            f"t is {time:g} s, must be at most {LATEST:g} from zero: a tick later would be the "
            "same number"
        )
    return time


def plausible(q: Array, v: Array, convention: Convention) -> bool:
    """Whether q (nq,) and v (nv,) are finite and something that a robot can be at."""
    if not (np.abs(q).max() <= FARTHEST and np.abs(v).max() <= FASTEST):
        return False
    length = np.linalg.norm(q[convention.quaternion])
    return not convention.floating or bool(SHORTEST <= length <= LONGEST)


def checked(q: Any, v: Any, convention: Convention) -> tuple[Array, Array]:
    """q and v as arrays. Raises ShapeError, or ValueRangeError where they are not plausible."""
    arrays = []
    for name, value, size in (("q", q, convention.nq), ("v", v, convention.nv)):
        arrays.append(floats(name, value))
        if arrays[-1].shape != (size,):
            raise ShapeError(name, arrays[-1].shape, (size,))
    if not plausible(arrays[0], arrays[1], convention):
        raise ValueRangeError(
            f"q and v must be finite, at most {FARTHEST:g} and {FASTEST:g}, a quaternion from "
            f"{SHORTEST:g} to {LONGEST:g} long"
        )
    return arrays[0], arrays[1]


def check_device(device: str) -> None:
    """Raises DeviceError for "cuda", UnknownNameError for what is no device."""
    check_device_name(device)
    if device == "cuda":
        raise DeviceError(
            "device is 'cuda': this version has no control loop on a GPU, use device 'cpu'"
        )
    if device == "auto":
        _say_cpu()


@cache
def _say_cpu() -> None:
    logging.getLogger("octo").info("using the CPU: this version has no control loop on a GPU")
