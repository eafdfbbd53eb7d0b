"""Numbers and names of a character, checked: finite, of the right shape and size."""

from __future__ import annotations

import math
import operator
from typing import Any, TypeVar

import numpy as np

from octo.checks import Array
from octo.errors import ModelError, said

T = TypeVar("T")
GRAVITY = 9.81  # m/s², the default, and that of scales
LARGEST = 1e12  # SI units, of every quantity but a limit: squares and cubes of it are still numbers


def vector3(values: object = (0.0, 0.0, 0.0)) -> Array:
    """(3,) of three numbers, by default zeros."""
    return np.asarray(values, dtype=float).reshape(3)


def interpolated(values: Array, place: Array) -> Array:
    """Rows of ``values`` (k, ...) at the fractional indices ``place``, linearly; the first one
    before, the last one afterwards."""
    place = np.clip(place, 0.0, len(values) - 1.0)
    index = np.minimum(place.astype(int), max(len(values) - 2, 0))
    share = (place - index).reshape(-1, *[1] * (values.ndim - 1))
    following = np.minimum(index + 1, len(values) - 1)
    return np.asarray((1.0 - share) * values[index] + share * values[following])


def text(what: str, value: object) -> None:
    """Refuse a name that is no text, or empty."""
    if not isinstance(value, str) or not value:
        raise ModelError(f"{what}: name is {said(value)}, must be a text that is not empty")


def choice(what: str, value: object, allowed: tuple[str, str]) -> None:
    """Refuse a word that is none of the two."""
    if not isinstance(value, str) or value not in allowed:
        raise ModelError(f"{what} is {said(value)}, must be {allowed[0]!r} or {allowed[1]!r}")


def tuple_of(what: str, value: Any, kind: type[T], words: str = "") -> tuple[T, ...]:
    """``value`` as a tuple of things of a kind, which ``words`` call by another name."""
    if not isinstance(value, (tuple, list)) or not all(isinstance(one, kind) for one in value):
        raise ModelError(f"{what} is {said(value)}, must be a tuple of {words or kind.__name__}")
    return tuple(value)


def array(what: str, value: object, shape: tuple[int, ...]) -> Array:
    """A copy of ``value`` as finite numbers of this shape that fit into the arithmetic."""
    try:
        found = np.array(value)
    except ValueError:  # lists of unequal lengths
        found = np.array(None)
    if found.dtype.kind not in "iuf":
        raise ModelError(f"{what} is {said(value)}, must be numbers")
    found = found.astype(float)
    if found.shape != shape:
        raise ModelError(f"{what} has shape {found.shape}, must have {shape}")
    if not (np.abs(found) <= LARGEST).all():
        bad = found[~(np.abs(found) <= LARGEST)].ravel()[0]
        raise ModelError(f"{what} has the entry {bad}, must be finite and at most {LARGEST:.0e}")
    return found


def quantity(what: str, value: object, rule: str = "finite", *, unlimited: bool = False) -> float:
    """``value`` as a number that is finite; with ``unlimited``, as a limit, which may also be
    infinite. Never NaN."""
    try:
        number = float(operator.pos(value))  # type: ignore[arg-type]  # a text has no sign
    except (TypeError, ValueError):
        raise ModelError(f"{what} is {said(value)}, must be a number") from None
    except OverflowError:
        number = math.inf
    negative = "not negative" in rule and number < 0.0 or "positive" in rule and number <= 0.0
    if math.isnan(number) or negative or (not unlimited and abs(number) > LARGEST):
        large = not negative and math.isfinite(number)
        raise ModelError(
            f"{what} is {number}, must be {f'at most {LARGEST:.0e}' if large else rule}"
        )
    return number
