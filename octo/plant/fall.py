"""When a robot has fallen."""

from __future__ import annotations

import numpy as np

HEIGHT = 0.5  # of the height of the base at the start
TILT = np.cos(np.radians(60.0))  # of the base, from upright


def fallen(height: float, standing: float, upright: float) -> bool:
    """Whether a base at ``height`` (m), which was at ``standing`` at the start, is too low, or
    tilted too far: ``upright`` is the cosine of its tilt."""
    return height < HEIGHT * standing or not upright > TILT
