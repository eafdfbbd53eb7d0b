"""What a user gave, as numbers, or one sentence that names the field and says what is allowed."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.errors import ShapeError, ValueRangeError

Array = NDArray[np.float64]


def numbers(field: str, value: Any, shape: tuple[int, ...] | None = None) -> Array:
    """``value`` as a finite array, of ``shape`` where one is given.

    Raises
    ------
    ValueRangeError: not numbers, or not finite. ShapeError: another shape.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueRangeError(f"{field} is {value!r}, must be numbers") from None
    if shape is not None and array.shape != shape:
        raise ShapeError(field, array.shape, shape)
    finite = np.isfinite(array)
    if not finite.all():
        where = f" at index {', '.join(str(int(k)) for k in np.argwhere(~finite)[0])}" if array.ndim else ""
        raise ValueRangeError(f"{field} is not finite{where}")
    return array


def number(field: str, value: Any) -> float:
    """``value`` as one finite number."""
    return float(numbers(field, value, ()))


def positive(field: str, value: Any, unit: str = "") -> float:
    try:
        found = float(value)
    except (TypeError, ValueError):
        found = float("nan")
    if not (np.isfinite(found) and found > 0.0):
        raise ValueRangeError(f"{field} is {value!r}{unit and ' '}{unit}, must be positive and finite")
    return found


def whole(field: str, value: Any, least: int = 1) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueRangeError(f"{field} is {value!r}, must be a whole number of at least {least}")
    return int(value)


def doubles(field: str, value: Any, shape: tuple[int, ...]) -> Array:
    """``value`` as native code reads it: float64 in C order, of ``shape``; itself where it is that already.

    Raises
    ------
    ShapeError: another shape, of which native code would read what is not there.
    """
    array: Array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ShapeError(field, array.shape, shape)
    return array


def owned(value: Any) -> Any:
    """``value``, or a copy of what its giver could still change: arrays, lists, dicts, and what they hold."""
    if isinstance(value, Mapping):
        return {key: owned(entry) for key, entry in value.items()}
    if isinstance(value, tuple) and type(value) is tuple:
        return tuple(owned(entry) for entry in value)
    if isinstance(value, np.ndarray):
        return np.array(value)
    return copy.deepcopy(value) if hasattr(value, "__setitem__") else value
