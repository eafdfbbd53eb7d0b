"""What a user gave, as numbers, or one sentence that names the field and says what is allowed."""

from __future__ import annotations

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
