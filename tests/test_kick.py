"""A ball is kicked from the first step to the last one."""

import numpy as np
import pytest

import octo
from octo.model.kinematics import body_poses

MAMMAL = octo.gallery.mammal()


@pytest.mark.slow
def test_a_mammal_kicks_a_ball_to_its_place() -> None:
    """The robot stands at the end, the ball rolls through its place; nothing named the foot."""
    start, place = (0.306, 0.099), (1.306, 0.099)  # it stands where the kick begins
    ball = octo.objects.ball(0.12, MAMMAL.mass / 9.0, (*start, 0.12))
    motion = octo.push(octo.Scene(MAMMAL, [ball]), "ball", place, seeds=1, device="cpu")
    at = [motion.joint_names.index(f"ball_{name}") for name in ("x", "y", "z", "pitch", "roll")]
    x, y, z, *_ = motion.x[1:, at].T
    assert motion.starts[0]["converged"] and motion.violation < 1e-4
    assert (x[-1], y[-1]) == pytest.approx(place, abs=1e-6)
    assert np.ptp(z) < 0.01  # it is not lifted
    touched = np.flatnonzero(motion.touched.any(axis=1))
    assert 1 <= len(touched) < 40 and x[touched[0] - 1] == pytest.approx(start[0], abs=2e-3)
    assert np.abs(np.diff(motion.x[-2:, : MAMMAL.nx], axis=0)).max() < 1e-6  # at rest
    # rolled by what it went, to what slips and sinks at the kick
    turned = body_poses(motion.character, motion.x[1:])[0][:, -1]
    steps = np.einsum("nij,nkj->nik", turned[1:], turned[:-1])
    angle = np.arccos(np.clip(0.5 * (np.trace(steps, axis1=1, axis2=2) - 1.0), -1.0, 1.0)).sum()
    assert angle == pytest.approx((x[-1] - x[0]) / 0.12, rel=0.1)
