"""The largest change a step of dynamics that the user wrote, as a field of a Problem."""

from __future__ import annotations

from typing import Any

import numpy as np

from octo.checks import Array, numbers, owned
from octo.errors import ProblemError, ShapeError, UnknownNameError, ValueRangeError, said

AUTO = "auto"


def checked_step_limit(given: Any, nx: int, written: bool) -> Array | str | None:
    """What ``Problem(step_limit=…)`` gave: AUTO, None, or (nx,); ``written``: by the user, the
    dynamics.

    Raises
    ------
    OctoError: it is none of these, or the dynamics are those of a robot.
    """
    if given is None or (isinstance(given, str) and given == AUTO):
        return given
    if isinstance(given, str):
        raise UnknownNameError("step_limit", given, (AUTO,))
    if not written:
        raise ProblemError(
            f"step_limit is {said(given)}, which is for dynamics that you wrote: of a robot add "
            "octo.StepLimit(…) to the constraints"
        )
    limit = numbers("step_limit", given)
    if limit.shape not in ((), (nx,)):
        raise ShapeError("step_limit", limit.shape, f"() or ({nx},)")
    if not (limit > 0.0).all():
        raise ValueRangeError(f"step_limit has {limit.min():g}, must be positive numbers")
    return owned(np.broadcast_to(limit, (nx,)))
