"""From one motion into another."""

from dataclasses import replace

import numpy as np
import pytest
from standing import standing

import octo
from octo.errors import OctoError
from octo.model.kinematics import sphere_centers
from octo.motion_graph.crossing import Placement, nodes_of

STEPS = 30


@pytest.fixture(scope="module")
def motions():
    return standing(0.0, (0.0, 0.0, 0.0)), standing(0.15, (3.0, -2.0, 2.0))


@pytest.fixture(scope="module")
def found(motions):
    return octo.transition(*motions, seconds=0.5, at=10, to=25, device="cpu")


@pytest.mark.slow
def test_it_leads_from_the_one_to_the_other_within_every_limit(found, motions):
    one, other = motions
    assert found.motion.converged, found
    assert found.motion.violation <= 1e-5
    assert all(bound.held for bound in found.motion.bounds)
    base = one.character.base_coordinate
    end = Placement(found.yaw, found.shift).moved(other.x[26], base)
    assert (found.motion.x[1] == one.x[11]).all()
    assert np.abs(found.motion.x[-1] - end).max() < 1e-12


def test_the_second_motion_is_laid_where_the_first_leads(found, motions):
    """It stood 3.6 m away and turned by 2 rad."""
    assert found.yaw == pytest.approx(-2.0, abs=1e-6)
    feet = sphere_centers(found.motion.character, found.motion.x)
    assert np.abs(feet[-1, :, :2] - feet[0, :, :2]).max() < 0.1
    assert found.distance < 0.05


def test_joined_it_is_one_motion_that_obeys_newton(found, motions):
    joined = found.joined()
    assert joined.steps == 10 + 20 + (STEPS - 25)
    assert joined.violation <= 1e-4  # of poses that stand within the tolerance of a static pose
    assert (joined.x[: 11 + 1] == motions[0].x[: 11 + 1]).all()


def test_where_nothing_is_given_the_most_alike_moments_are_crossed(motions):
    from octo.motion_graph.crossing import Crossing

    one, other = motions
    crossing = Crossing(one, other, 20, [octo.Effort()])
    alike, leaving, reaching = crossing.similarity()
    assert (leaving[-1], reaching[0]) == (STEPS - 20, 20)
    own, placed = crossing.placed(4, 22)
    assert alike.distance[4, 2] == pytest.approx(own.distance[0, 0], rel=1e-9)
    assert alike.yaw[4, 2] == pytest.approx(placed.yaw)


def test_before_its_start_and_after_its_end_a_motion_is_held(motions):
    one = motions[0]
    assert (nodes_of(one, -4, 3) == one.x[0]).all()
    assert (nodes_of(one, STEPS, 3) == one.x[-1]).all()


def _of_other_law(motion: octo.Solution) -> octo.Solution:
    return replace(motion, parameters={**motion.parameters, "contact.w_perp": 7.0})


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"other": lambda m: replace(m, dt=0.02)}, "dt is 0.025 s of the one motion, 0.02 s"),
        ({"other": _of_other_law}, r"contact.w_perp is .* of the other"),
        ({"at": 31}, "at is 31, must be"),
        ({"seconds": 0.05}, "seconds is 0.05, must be four steps"),
        ({"seconds": 2.0}, "a transition of 80 steps is longer"),
        ({"goal": "near"}, "goal 'near' is not known"),
        ({"constraints": "firm"}, "constraints 'firm' is not known"),
    ],
)
def test_what_cannot_be_crossed_is_refused_in_one_line(motions, change, told):
    one, other = motions
    change = dict(change)
    other = change.pop("other", lambda m: m)(other)
    with pytest.raises(OctoError, match=told) as refused:
        octo.transition(one, other, **{"seconds": 0.5, **change})
    assert "\n" not in str(refused.value)
