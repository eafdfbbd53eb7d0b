"""A fall, as control loops and replays count it."""

import numpy as np
import pytest

from octo.plant.fall import fallen


@pytest.mark.parametrize(
    ("height", "tilt", "expected"),
    [
        (0.30, 0.0, False),
        (0.16, 59.0, False),
        (0.14, 0.0, True),
        (0.30, 61.0, True),
        (0.30, np.nan, True),
    ],
)
def test_too_low_or_tilted_too_far(height: float, tilt: float, expected: bool) -> None:
    assert fallen(height, 0.30, float(np.cos(np.radians(tilt)))) is expected
