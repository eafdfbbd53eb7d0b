"""When a term acts: at all steps, at the last one, at some of them, or at times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from octo.checks import numbers, one_of
from octo.errors import ValueRangeError, said

Array = NDArray[np.float64]
ALLOWED = "'all', 'last', numbers of steps, a mask of truths or octo.At(seconds)"


@dataclass(frozen=True)
class At:
    """Times at which a term acts, as of a keyframe: of each the step whose x_next is nearest.

    Parameters
    ----------
    seconds: after the start, one or several; step i is at (i + 1)·dt, and a time must be within
        half a dt of one.
    """

    seconds: ArrayLike

    def __post_init__(self) -> None:
        found = numbers("At.seconds", self.seconds)
        if found.ndim > 1 or not found.size:
            raise ValueRangeError(f"At.seconds is {said(self.seconds)}, must be one time or more")
        object.__setattr__(self, "seconds", tuple(np.atleast_1d(found).tolist()))

    def steps(self, field: str, count: int, dt: float) -> NDArray[np.intp]:
        """The steps, of ``count`` of ``dt`` s; ``field``: what a message names."""
        times = numbers("At.seconds", self.seconds) / dt
        out = np.flatnonzero((times < 0.5) | (times > count + 0.5))
        if len(out):
            nearest = f"between {0.5 * dt:g} and {(count + 0.5) * dt:g} s"
            time = f"{times[out[0]] * dt:g} s"
            raise ValueRangeError(f"{field} has the time {time}, must be {nearest}")
        return np.clip(np.rint(times).astype(int) - 1, 0, count - 1)


# numbers of steps from 0, from the end where they are negative; or a truth for each step
Steps = Literal["all", "last"] | Sequence[int] | Sequence[bool] | NDArray[Any] | At


def always(at: Any) -> bool:
    """Whether a term acts at all steps because it says no others."""
    return isinstance(at, str) and at == "all"


def check_at(field: str, at: Any) -> None:
    """Refuse what says no steps, whatever their number.

    Raises
    ------
    OctoError: names ``field``, its value and what is allowed.
    """
    if isinstance(at, At):
        return
    if isinstance(at, str):
        one_of(field, at, ("all", "last"))
        return
    _entries(field, at)


def _entries(field: str, at: Any) -> NDArray[Any]:
    """Numbers of steps, or a truth for each."""
    try:
        found = np.asarray(at)
    except (TypeError, ValueError):  # of lists of several lengths
        found = np.zeros(())
    if found.ndim != 1 or (found.size and found.dtype.kind not in "biu"):
        raise ValueRangeError(f"{field} is {said(at)}, must be {ALLOWED}")
    if not (found.any() if found.dtype == bool else found.size):
        raise ValueRangeError(f"{field} is {said(at)}, must have one step or more")
    return found


def shares(field: str, at: Any, steps: int, dt: float) -> Array:
    """(N,) what the weight of a term is multiplied with at each of its ``steps`` of ``dt`` s: 1
    over the number of steps at which it acts, else 0.

    Raises
    ------
    OctoError: names ``field``, its value and what is allowed.
    """
    on = np.zeros(steps, dtype=bool)
    check_at(field, at)
    if isinstance(at, str):
        on[slice(None) if at == "all" else -1] = True
    elif isinstance(at, At):
        on[at.steps(field, steps, dt)] = True
    else:
        chosen = _entries(field, at)
        if chosen.dtype == bool and len(chosen) != steps:
            raise ValueRangeError(f"{field} is a mask of {len(chosen)} steps, must be of {steps}")
        out = chosen[(chosen < -steps) | (chosen >= steps)]
        if chosen.dtype != bool and len(out):
            raise ValueRangeError(
                f"{field} has the step {int(out[0])}, must be between {-steps} and {steps - 1}"
            )
        on[chosen] = True
    return np.where(on, 1.0 / np.count_nonzero(on), 0.0)
