"""What a user gave, as numbers, or one sentence that names the field and says what is allowed."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from octo.errors import (
    OutputError,
    ProblemError,
    ShapeError,
    UnknownNameError,
    UsageError,
    ValueRangeError,
    said,
)

Array = NDArray[np.float64]  # of NumPy, as everything a user gives and gets
Given = ParamSpec("Given")
Result = TypeVar("Result")
STILLS = (".png", ".pdf", ".svg")  # endings of still pictures
ANIMATED = (".glb", ".bvh", ".mp4", ".gif")  # of what octo.export writes
SHORTEST_STEP = 1e-9  # s
LONGEST_STEP = 1.0  # s, of a robot's motion
MOST_STEPS = 1_000_000  # of a motion: seven hours at 40 Hz
MOST = 10**9  # of things that are counted; runs of more would never end
TEXTS = (str, bytes, bytearray, memoryview)


def asked(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """``function`` of the package octo, with a call that does not fit its signature refused in
    octo's own words; it is called with all of its arguments."""
    signature = inspect.signature(function)
    name = f"octo.{function.__qualname__.removesuffix('.__init__')}"
    named = [key for key in signature.parameters if key != "self"]

    @wraps(function)
    def checked(*args: Given.args, **options: Given.kwargs) -> Result:
        for option in options:
            if option not in named:
                raise UnknownNameError(f"option of {name}", option, named)
        try:
            bound = signature.bind(*args, **options)
        except TypeError as error:
            raise UsageError(f"{name}: {error}; its arguments are {', '.join(named)}") from None
        bound.apply_defaults()
        return function(*bound.args, **bound.kwargs)

    return checked


def takes(*kinds: type) -> Callable[[Callable[Given, Result]], Callable[Given, Result]]:
    """A decorator: what stands in the signature in place of ``**options``, which are the fields of
    these dataclasses that have defaults."""

    def described(function: Callable[Given, Result]) -> Callable[Given, Result]:
        whole = inspect.signature(function)
        kept = {k: one for k, one in whole.parameters.items() if one.kind is not one.VAR_KEYWORD}
        for field in (field for kind in kinds for field in dataclasses.fields(kind)):
            if field.default is not dataclasses.MISSING and field.name not in kept:
                own = {"default": field.default, "annotation": field.type}
                kept[field.name] = inspect.Parameter(
                    field.name, inspect.Parameter.KEYWORD_ONLY, **own
                )
        setattr(function, "__signature__", whole.replace(parameters=[*kept.values()]))  # noqa: B010
        return function

    return described


def floats(field: str, value: Any) -> Array:
    """``value`` as an array of numbers, finite or not; itself where it is one."""
    try:  # NumPy would make some of texts and dates, and real ones of complex ones
        found = np.asarray(value)
        kind = found.dtype.kind
        if kind not in "biufO" or (kind == "O" and any(isinstance(v, TEXTS) for v in found.flat)):
            raise TypeError
        return np.asarray(found, dtype=float)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise ValueRangeError(f"{field} is {said(value)}, must be numbers") from None


def numbers(field: str, value: Any, shape: tuple[int, ...] | None = None) -> Array:
    """``value`` as a finite array, of ``shape`` where one is given."""
    array = floats(field, value)
    if shape is not None and array.shape != shape:
        raise ShapeError(field, array.shape, shape)
    finite = np.isfinite(array)
    if not finite.all():
        place = ", ".join(str(int(k)) for k in np.argwhere(~finite)[0]) if array.ndim else ""
        where = f" at index {place}" if place else ""
        raise ValueRangeError(f"{field} is not finite{where}")
    return array


def number(field: str, value: Any) -> float:
    """``value`` as one finite number."""
    return float(numbers(field, value, ()))


def positive(field: str, value: Any, unit: str = "") -> float:
    try:
        found = float("nan") if isinstance(value, TEXTS) else float(value)
    except (TypeError, ValueError, OverflowError):
        found = float("nan")
    if not (np.isfinite(found) and found > 0.0):
        raise ValueRangeError(
            f"{field} is {said(value)}{unit and ' '}{unit}, must be positive and finite"
        )
    return found


def time_step(value: Any) -> float:
    """dt (s) of a robot's motion."""
    dt = positive("dt", value, "s")
    if dt < SHORTEST_STEP:
        why = "velocities are differences over it"
        raise ValueRangeError(f"dt is {said(value)} s, must be at least {SHORTEST_STEP:g} s: {why}")
    if dt > LONGEST_STEP:
        why = "within one step a robot falls over unseen"
        raise ValueRangeError(f"dt is {said(value)} s, must be at most {LONGEST_STEP:g} s: {why}")
    return dt


def vectors(field: str, value: Any, size: int) -> Array:
    """``value`` as ``size`` finite numbers, or as a row of them for each step: (size,) or (N,
    size)."""
    array = numbers(field, value)
    if array.ndim not in (1, 2) or array.shape[-1] != size:
        raise ShapeError(field, array.shape, f"({size},) or (N, {size})")
    return array


def for_each(field: str, value: Any, size: int) -> Array:
    """Finite numbers of ``size`` things, as one for all, (size,), or a row of them for each step:
    (size,) or (N, size)."""
    array = numbers(field, value)
    if array.ndim > 2 or (array.ndim and array.shape[-1] != size):
        raise ShapeError(field, array.shape, f"(), ({size},) or (N, {size})")
    return np.broadcast_to(array, (size,)) if array.ndim == 0 else array


def shares(field: str, value: Any, size: int) -> Array:
    """Weights of ``size`` things, given in the same ways, none negative."""
    array = for_each(field, value, size)
    if (array < 0.0).any():
        least = f"{array.min():g}"
        raise ValueRangeError(f"{field} has the negative weight {least}, must not be negative")
    return array


def ending(field: str, path: Any, allowed: Sequence[str]) -> Path:
    """A file's path with one of the endings that say what will be in it."""
    try:
        found = Path(path)
    except TypeError:
        raise OutputError(f"{field} is {said(path)}, must be a file's path") from None
    if found.suffix.lower() not in allowed:
        *others, last = allowed
        words = f"{', '.join(others)} or {last}" if others else last
        raise OutputError(f"{field} is {str(found)!r}, must end in {words}")
    return found


def whole(field: str, value: Any, least: int = 1, most: int = MOST) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        allowed = f"a whole number of at least {least}"
        raise ValueRangeError(f"{field} is {said(value)}, must be {allowed}")
    if value > most:
        raise ValueRangeError(f"{field} is {said(value)}, must be at most {most}")
    return int(value)


def flag(field: str, value: Any) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise ValueRangeError(f"{field} is {said(value)}, must be True or False")
    return bool(value)


def one_of(kind: str, name: Any, valid: Iterable[str], hint: str = "") -> str:
    """``name``, which must be one of the valid ones; else the nearest is said, or ``hint``."""
    names = tuple(valid)
    if not isinstance(name, str) or name not in names:
        raise UnknownNameError(kind, name, names, hint)
    return name


def instance(field: str, value: Any, kind: Any, words: str) -> Any:
    """``value``, which must be of a kind; ``words`` say which."""
    if not isinstance(value, kind):
        raise ProblemError(f"{field} is {said(value)}, must be {words}")
    return value


def room(what: str, doubles: float) -> None:
    """Refuse what does not fit into this machine's memory: the system would end the process in the
    middle."""
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if 8.0 * doubles > there:
        raise ProblemError(
            f"{what} need {8e-9 * doubles:.3g} GB of memory, this machine has {1e-9 * there:.3g} GB"
        )


def steps_in(seconds: float, dt: float) -> int:
    """The number of steps of ``dt`` s nearest to ``seconds``, which may be 0."""
    if not seconds / dt <= MOST_STEPS:
        most = f"{MOST_STEPS} steps of {dt:g} s"
        raise ValueRangeError(f"seconds is {seconds:g}, must be at most {most}")
    return round(seconds / dt)


def doubles(field: str, value: Any, shape: tuple[int, ...]) -> Array:
    """``value`` as native code reads it: float64 in C order, itself where it is that already, and
    of ``shape``: of another one native code would read what is not there."""
    array: Array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ShapeError(field, array.shape, shape)
    return array


def owned(value: Any) -> Any:
    """``value``, or a copy of what its giver could still change: arrays, lists, dicts, and what
    they hold."""
    if isinstance(value, Mapping):
        return {key: owned(entry) for key, entry in value.items()}
    if isinstance(value, tuple) and type(value) is tuple:
        return tuple(owned(entry) for entry in value)
    if isinstance(value, np.ndarray):
        return np.array(value)
    try:
        return copy.deepcopy(value) if hasattr(value, "__setitem__") else value
    except (TypeError, RecursionError):
        raise ValueRangeError(
            f"{said(value)} is given, which cannot be copied, must be numbers or texts"
        ) from None
