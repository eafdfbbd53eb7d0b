"""Numbers and names of a character, checked: finite, of the right shape and size."""

from __future__ import annotations

import math
import operator

import numpy as np

from octo.checks import Array
from octo.errors import ModelError, said

GRAVITY = 9.81  # m/s², the default, and that of scales
LARGEST = 1e12  # SI units, of every quantity but a limit: squares and cubes of it are still numbers


def vector3(values: object = (0.0, 0.0, 0.0)) -> Array:
    """(3,) of three numbers, by default zeros."""
    return np.asarray(values, dtype=float).reshape(3)


def text(what: str, value: object) -> None:
    """Refuse a name that is no text, or empty."""
    if not isinstance(value, str) or not value:
        raise ModelError(f"{what}: name is {said(value)}, must be a text that is not empty")


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
