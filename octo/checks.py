"""What a user gave, as numbers, or one sentence that names the field and says what is allowed."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from octo.errors import ShapeError, UnknownNameError, UsageError, ValueRangeError, said

Array = NDArray[np.float64]
Given = ParamSpec("Given")
Result = TypeVar("Result")


def asked(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """``function`` of the package octo, with a call that does not fit its signature refused in octo's own words.

    Raises
    ------
    UnknownNameError: no such option; says the nearest. UsageError: an argument is missing, or given twice.
    """
    signature = inspect.signature(function)
    name = f"octo.{function.__qualname__.removesuffix('.__init__')}"
    named = [key for key in signature.parameters if key != "self"]

    @wraps(function)
    def checked(*args: Given.args, **options: Given.kwargs) -> Result:
        for option in options:
            if option not in named:
                raise UnknownNameError(f"option of {name}", option, named)
        try:
            signature.bind(*args, **options)
        except TypeError as error:
            raise UsageError(f"{name}: {error}; its arguments are {', '.join(named)}") from None
        return function(*args, **options)

    return checked


def numbers(field: str, value: Any, shape: tuple[int, ...] | None = None) -> Array:
    """``value`` as a finite array, of ``shape`` where one is given.

    Raises
    ------
    ValueRangeError: not numbers, or not finite. ShapeError: another shape.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueRangeError(f"{field} is {said(value)}, must be numbers") from None
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
        raise ValueRangeError(f"{field} is {said(value)}{unit and ' '}{unit}, must be positive and finite")
    return found


def whole(field: str, value: Any, least: int = 1) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueRangeError(f"{field} is {said(value)}, must be a whole number of at least {least}")
    return int(value)
