"""Motions under the contact law of another one."""

from __future__ import annotations

import re

import numpy as np
import pytest
from standing import standing

import octo
from octo.errors import ProblemError
from octo.motion_graph.one_law import under_one_law
from octo.motions.path import ground_law


@pytest.fixture(scope="module")
def motion() -> octo.Solution:
    return standing(0.1, (1.0, -1.0, 1.0), steps=20)


def under(motion: octo.Solution, times: float, **changed: float) -> octo.Solution:
    """Something whose contact law is so many times softer."""
    law = {name: own / times for name, own in ground_law(motion).items()}
    return octo.Solution(**{**vars(motion), "parameters": {**motion.parameters, **law, **changed}})


@pytest.mark.slow
def test_a_softer_law_carries_it_deeper_and_still(motion: octo.Solution) -> None:
    like = under(motion, 4.0)
    own = under_one_law(motion, like, "hard", "low")
    assert own.converged and ground_law(own) == ground_law(like)
    assert own.pointwise_residual < 1e-5
    joints, base = motion.character.actuated, motion.character.base_coordinate
    assert np.abs(own.x - motion.x)[:, joints].max() < 0.02
    for end in (slice(0, 2), slice(-2, None)):  # it rests there, as it did, a little lower
        sunk = motion.x[end, base + 2] - own.x[end, base + 2]
        assert np.ptp(own.x[end], axis=0).max() == 0.0 and (sunk > 1e-5).all()
    assert under_one_law(motion, motion, "hard", "low") is motion


def test_an_end_that_moves_stays_where_it_is(motion: octo.Solution) -> None:
    lower = motion.x[-1].copy()
    lower[motion.character.base_coordinate + 2] -= 0.03
    problem = octo.Problem(
        motion.character,
        steps=6,
        dt=motion.dt,
        costs=[octo.PoseTarget(target=lower, at="all")],
        x0=motion.x[-1],
        parameters=ground_law(motion),
    )
    crouch = octo.solve(problem, passes=1, device="cpu")
    assert crouch.converged and np.abs(crouch.v[-1]).max() > 0.01
    own = under_one_law(crouch, under(crouch, 1.5), "hard", "crouch")
    assert own.converged and np.array_equal(own.x[-2:], crouch.x[-2:])
    assert (own.x[:2] != crouch.x[:2]).any()


def test_laws_too_far_apart(motion: octo.Solution) -> None:
    own = motion.parameters["contact.w_perp"]
    words = rf"'low' .* contact.w_perp is {own:.3g}, theirs {own / 20.0:.3g}, must be within 10 "
    with pytest.raises(ProblemError, match=words.replace("+", re.escape("+"))):
        under_one_law(motion, under(motion, 20.0), "hard", "low")
