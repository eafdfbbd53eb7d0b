"""Where a motion begins and ends: which of the fields of a Problem that say so go together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from octo.errors import ProblemError

STATES = ("x0", "v0", "x_end", "v_end", "displacement")  # fields that are a configuration


def check_ends(fields: Mapping[str, Any]) -> None:
    """Refuse ``fields``, those of a Problem by name, that say the same in two ways, or half of
    it."""
    if fields["x0"] is not None and fields["pose"] is not None:
        raise ProblemError(
            "x0 and pose are both given: x0 is the start, pose is where a static one is "
            "searched from"
        )
    if fields["x_end"] is not None and fields["displacement"] is not None:
        raise ProblemError(
            "x_end and displacement are both given: the last configuration is one or the other"
        )
    if fields["v_end"] is not None and fields["x_end"] is fields["displacement"] is None:
        raise ProblemError(
            "v_end is given without x_end: a fixed last velocity needs the last configuration too"
        )


def check_free(fields: Mapping[str, Any]) -> None:
    """Refuse states that are given of a cycle, which are unknown."""
    for name in STATES:
        if fields[name] is not None:
            raise ProblemError(
                f"{name} is given with cycle: the first and last states of a cycle are unknown"
            )
