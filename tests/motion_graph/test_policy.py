"""What a steered character does next, on graphs whose answers are known."""

import networkx
import pytest

from octo.errors import ProblemError
from octo.motion_graph.policy import policy


def graph(lengths, ways=(), apart=10, crossing=40):
    """Motions of so many moments; ways: (from, to, effort) of nodes written as "a3"."""
    made = networkx.DiGraph()
    for name, count in lengths.items():
        for k in range(count):
            made.add_node((name, k * apart))
            if k:
                edge = (name, (k - 1) * apart), (name, k * apart)
                made.add_edge(*edge, steps=apart, seconds=0.1, effort=1.0, number=None)
    for number, (one, other, effort) in enumerate(ways):
        numbers = {"steps": crossing, "seconds": 0.4, "effort": effort, "number": number}
        made.add_edge(at(one, apart), at(other, apart), **numbers)
    return made


def at(word, apart=10):
    return word[0], int(word[1:]) * apart


def walk(found, wanted, count, node=None):
    """Moments, as written, that follow each other while ``wanted`` is."""
    node, words = found.start if node is None else at(node), []
    for _ in range(count):
        node = found.following[node][wanted]
        words.append(f"{node[0]}{node[1] // 10}")
    return words


def test_a_motion_goes_on_until_its_last_loop_and_takes_the_one_of_least_effort():
    ways = [("a3", "a1", 1.0), ("a4", "a0", 2.0), ("a4", "a2", 1.5)]
    found = policy(graph({"a": 6}, ways), ["a"])
    assert found.start == ("a", 0)
    assert walk(found, "a", 7) == ["a1", "a2", "a3", "a4", "a2", "a3", "a4"]
    assert ("a", 50) not in found.following  # it leads nowhere
    assert at("a4") in [edge[0] for edge in found.edges]
    assert (at("a3"), at("a1")) not in found.edges  # never taken


def test_the_soonest_way_is_taken_and_of_several_that_of_least_effort():
    ways = [("a1", "b1", 1.0), ("a2", "b2", 9.0), ("a2", "b1", 5.0), ("b3", "b0", 1.0)]
    ways += [("b3", "a0", 1.0), ("a3", "a0", 1.0)]
    found = policy(graph({"a": 4, "b": 4}, ways), ["a", "b"])
    assert walk(found, "b", 2, "a0") == ["a1", "b1"]
    assert walk(found, "b", 1, "a1") == ["b1"]
    assert walk(found, "b", 1, "a2") == ["b1"]  # at once, though that of a1 takes less effort
    assert walk(found, "b", 1, "a3") == ["a0"]  # the only way
    assert walk(found, "a", 5, "b0") == ["b1", "b2", "b3", "a0", "a1"]


def test_a_third_motion_is_passed_where_that_is_the_only_way():
    ways = [("a1", "b0", 1.0), ("b1", "c0", 1.0), ("c1", "a0", 1.0)]
    found = policy(graph({"a": 2, "b": 2, "c": 2}, ways), ["a", "b", "c"])
    assert walk(found, "c", 4) == ["a1", "b0", "b1", "c0"]
    assert walk(found, "a", 2, "c0") == ["c1", "a0"]


def test_a_motion_without_loops_is_left_at_its_last_moment_and_reached_again_soon():
    ways = [("a1", "b0", 1.0), ("a2", "b0", 1.0), ("b0", "a0", 7.0), ("b0", "a1", 1.0)]
    ways += [("b1", "b0", 1.0)]
    found = policy(graph({"a": 4, "b": 2}, ways), ["a", "b"])
    # it comes back to where it can stay longest, though that takes more effort
    assert walk(found, "a", 6) == ["a1", "a2", "b0", "a0", "a1", "a2"]


def test_a_moment_from_which_a_motion_can_be_kept_up_is_preferred():
    ways = [("a0", "b0", 9.0), ("a0", "b3", 1.0), ("b2", "b0", 1.0), ("b3", "a0", 1.0)]
    found = policy(graph({"a": 1, "b": 4}, ways), ["a", "b"])
    assert walk(found, "b", 5) == ["b0", "b1", "b2", "b0", "b1"]
    assert walk(found, "b", 3, "b3") == ["a0", "b0", "b1"]  # out and back


def test_motions_from_which_no_way_leads_back_are_left_out():
    ways = [("a0", "b0", 1.0), ("b2", "b0", 1.0), ("b1", "c0", 1.0), ("b0", "d0", 1.0)]
    ways += [("d1", "b0", 1.0)]
    found = policy(graph({"a": 3, "b": 3, "c": 3, "d": 2}, ways), ["a", "b", "c", "d"])
    assert found.motions == ("b", "d")  # none leads to a, none back from c
    assert found.start == ("b", 0)
    assert all(node[0] != "c" for edge in found.edges for node in edge)
    assert walk(found, "b", 2, "a0") == ["b0", "b1"]  # a is left


def test_the_first_moments_lead_into_what_goes_on():
    """No way leads back to rest, from which the motion begins."""
    found = policy(graph({"a": 5}, [("a4", "a2", 1.0)]), ["a"])
    assert walk(found, "a", 6) == ["a1", "a2", "a3", "a4", "a2", "a3"]


def test_every_wish_is_fulfilled_from_everywhere():
    ways = [(f"a{k}", f"b{(3 * k) % 7}", float(k % 3)) for k in range(2, 9)]
    ways += [(f"b{k}", f"c{(2 * k) % 5}", 1.0) for k in (3, 5)] + [("c6", "a1", 1.0)]
    found = policy(graph({"a": 9, "b": 8, "c": 7}, ways), ["a", "b", "c"])
    taken = set(found.edges)
    assert len(found.motions) == 3 and {node for edge in taken for node in edge} <= {
        *found.following
    }
    for node in found.following:
        for wanted in found.motions:
            way = walk(found, wanted, 60, f"{node[0]}{node[1] // 10}")
            assert wanted in {word[0] for word in way[:30]}
            assert wanted in {word[0] for word in way[30:]}


@pytest.mark.parametrize("lengths", [{}, {"a": 5}, {"a": 1, "b": 3}])
def test_a_graph_in_which_nothing_goes_on_is_refused(lengths):
    with pytest.raises(ProblemError, match="needs loops or transitions"):
        policy(graph(lengths), list(lengths))
