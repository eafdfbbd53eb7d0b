"""The joint-level PD: springs and dampers to the joints of a plan, read several times a tick."""

from __future__ import annotations

import ctypes
import importlib.resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo import native
from octo.checks import numbers
from octo.errors import ShapeError, ValueRangeError
from octo.model.mass_matrix import mass_matrix
from octo.model.quantities import GRAVITY, Array
from octo.mpc.plan import Grid, Plan
from octo.problem.problem import Problem

STIFFNESS = 1.1  # relative to mg·ℓ a rad, kp
SWING = 0.23  # of √(ℓ/g), kd over kp
PERIOD = 0.002  # s, in which the low level is expected to be called
LIGHT = 1.0  # of the damping that stops a free joint within that period; twice as much is unstable


def gains(field: str, value: Any, nu: int) -> Array:
    """(nu,) of one number or as many; ValueRangeError, ShapeError where they are something else or
    negative."""
    array = numbers(field, value)
    if array.shape not in ((), (nu,)):
        raise ShapeError(field, array.shape, f"a number or ({nu},)")
    if (array < 0.0).any():
        raise ValueRangeError(f"{field} is {float(array.min())}, must not be negative")
    return np.broadcast_to(array, (nu,))


def default_stiffness(problem: Problem) -> float:
    """kp, N m/rad."""
    return STIFFNESS * problem.weight * problem.length


def default_damping(problem: Problem, kp: float | Array) -> Array:
    """kd (nu,), no more than the period allows a joint with nothing but its own leg's inertia."""
    robot = problem.character
    assert robot is not None
    inverse = np.linalg.inv(mass_matrix(robot, problem.start))
    free = 1.0 / np.diag(inverse)[robot.actuated]  # kg m²
    damping = SWING * np.sqrt(problem.length / GRAVITY) * np.asarray(kp)
    return np.minimum(damping, LIGHT * free / PERIOD)


class LowLevel:
    """u = u_plan + kp (q_plan − q) + kd (v_plan − v), inside the limits; one call of compiled code,
    or NumPy without a compiler.

    Attributes
    ----------
    kp: (nu,) N m/rad or N/m, to be written in place.
    kd: (nu,) N m s/rad or N s/m, to be written in place.
    limit: (nu,) N m or N, to be written in place.
    """

    def __init__(self, grid: Grid, q_at: NDArray[np.intp], kp: Array, kd: Array, limit: Array):
        """``q_at`` (nu,): places of the actuated coordinates in q."""
        text = importlib.resources.files(__package__) / "low_level.c"
        library = native.load(text.read_text(encoding="utf-8"))
        self.kp, self.kd, self.limit = (np.array(k, dtype=float) for k in (kp, kd, limit))
        self._q_at, self._actuated = q_at, grid.actuated
        self._entry: Any = None
        self._places = tuple(np.array(places, dtype=np.int32) for places in (grid.actuated, q_at))
        pointers = (a.ctypes.data for a in (*self._places, self.kp, self.kd, self.limit))
        self._record = _Record(grid.rows, grid.steps, grid.n, grid.nu, grid.dt, *pointers)
        self._at = ctypes.addressof(self._record)
        # Called with the interpreter's lock held: who gives it away in real time may wait 5 ms
        # until the planner returns it.
        if library is not None:
            self._entry = _ENTRY(("octo_low_level", library))
        self._out: Any = ctypes.c_double * grid.nu

    def __call__(self, plan: Plan, t: float, q: Array, v: Array) -> Array:
        """(nu,) N m or N at ``t`` s, measured q (nq,), v (nv,)."""
        if self._entry is None:
            return self._interpreted(plan, t, q, v)
        u = self._out()
        self._entry(self._at, plan.address, t, q.tobytes(), v.tobytes(), u)
        return np.frombuffer(u)

    def _interpreted(self, plan: Plan, t: float, q: Array, v: Array) -> Array:
        j = self._actuated
        x, rate, planned = plan.at(t if np.isfinite(t) else plan.time)
        with np.errstate(over="ignore", invalid="ignore"):
            u = planned + self.kp * (x[j] - q[self._q_at]) + self.kd * (rate[j] - v[j])
        # a joint that is not measured follows the plan's torque
        u = np.where(np.isfinite(u), u, planned)
        return np.asarray(np.minimum(np.maximum(u, -self.limit), self.limit))


_POINTER = ctypes.c_void_p
_ENTRY = ctypes.PYFUNCTYPE(None, _POINTER, _POINTER, ctypes.c_double, _POINTER, _POINTER, _POINTER)


class _Record(ctypes.Structure):
    """low_level of low_level.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("rows", "steps", "nx", "nu")),
        ("dt", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("joint", "q_at", "kp", "kd", "limit")),
    ]
