"""Transitions that are alike, each from the nearest one that was found."""

from dataclasses import replace

import numpy as np
import pytest
from standing import standing

import octo
from octo.motion_graph.crossing import Crossing, Placement
from octo.motion_graph.neighbours import Neighbours, apart, in_a_row, spread
from octo.motion_graph.work import Pair, batches_of, broken, work

HOW = {"goal": "feasible", "max_iterations": 100, "passes": 1, "device": "cpu"}


@pytest.fixture(scope="module")
def crossing():
    high, low = standing(0.0, (0.0, 0.0, 0.0), steps=60), standing(0.15, (3.0, -2.0, 2.0), steps=60)
    return Crossing(high, low, 20, [octo.Effort()])


def test_a_motion_seen_from_where_it_stands_comes_back(crossing) -> None:
    x, base = crossing.other.x, crossing.robot.base_coordinate
    place = Placement(1.2, np.array([0.4, -3.0]))
    assert np.abs(place.back.moved(place.moved(x, base), base) - x).max() < 1e-12
    vectors = np.array([[1.0, 0.0, 5.0]])
    turned = np.array([[np.cos(1.2), np.sin(1.2), 5.0]])
    assert np.abs(place.turned(vectors) - turned).max() < 1e-15


def test_whole_turns_of_a_heading_are_no_way_to_go(crossing) -> None:
    """After a turn on the spot the heading is 9 rad; a motion that begins with 0 goes on there."""
    x = crossing.one.x.copy()
    x[:, crossing.robot.base_coordinate + 3] += 4.0 * np.pi
    turned = replace(crossing, one=replace(crossing.one, x=x))
    (_, place), (_, own) = turned.placed(30, 40), crossing.placed(30, 40)
    assert place.yaw == pytest.approx(own.yaw + 4.0 * np.pi)
    guess = turned.problem(30, 40, place, turned.begins(30))[1]
    assert np.abs(guess - crossing.problem(30, 40, own, crossing.begins(30))[1]).max() < 1e-9


def test_pairs_that_differ_in_place_alone_are_solved_once(crossing) -> None:
    """Both stand: whenever the one is left and the other reached, it is the same transition."""
    batch = batches_of(crossing, [Pair("high", at, "low", 40) for at in (20, 30, 40)], 64, HOW)
    assert len(batch) == 1
    outcomes = work(batch[0])
    assert isinstance(outcomes, list) and all(own.found for own in outcomes)
    assert sorted(own.iterations > 0 for own in outcomes) == [False, False, True]
    assert sum(own.seconds > 0.0 for own in outcomes) == 1
    assert np.abs(outcomes[0].x - outcomes[2].x).max() < 1e-9


def _made(crossing, depths):
    """The same transition to poses of several heights, as seen from its start."""
    made = []
    for depth in depths:
        own = replace(crossing, other=standing(depth, (0.0, 0.0, 0.0), steps=60))
        made.append(own.problem(30, 40, own.placed(30, 40)[1], own.begins(30)))
    return made


def test_from_its_neighbour_a_transition_takes_fewer_iterations(crossing) -> None:
    made = _made(crossing, (0.10, 0.11, 0.12, 0.13))
    alone = [octo.solve(problem, start=guess, **HOW) for problem, guess in made]
    alike = Neighbours(made, HOW, lambda motion: not broken(motion), lambda: False)
    motions = alike.solved()
    assert motions is not None and not any(map(broken, motions))
    assert (alike.iterations > 0).all()
    assert alike.iterations.sum() < sum(motion.iterations for motion in alone)


def test_what_is_not_found_is_tried_again_from_what_is(crossing) -> None:
    """A first try that may not take the steps it needs."""
    made, tries = _made(crossing, (0.10, 0.11)), []

    def good(motion) -> bool:
        tries.append(motion)
        return len(tries) != 2 and not broken(motion)  # the second one is lost at first

    alike = Neighbours(made, HOW, good, lambda: False)
    motions = alike.solved()
    assert motions is not None and len(tries) == 3 and motions[1] is not tries[1]


def test_told_to_stop_nothing_more_is_solved(crossing) -> None:
    made = _made(crossing, (0.10, 0.11))
    alike = Neighbours(made, HOW, lambda motion: True, lambda: True)
    assert alike.solved() is None and not alike.motions


def test_things_are_spread_and_put_in_a_row() -> None:
    places = np.array([[0.0], [5.0], [0.1], [5.2], [2.4]])
    off = apart(places)
    assert off[0, 1] == 5.0
    assert spread(off, 3).tolist() == [4, 3, 0]
    assert in_a_row(off).tolist() == [0, 2, 4, 1, 3]
