"""The way through a graph that does what it is told: graphs of which the answer is known."""

import networkx
import pytest

from octo.errors import ProblemError
from octo.motion_graph.script import Command, commanded


def network(*edges: tuple[tuple[str, int], tuple[str, int]], last: int = 3) -> networkx.DiGraph:
    """Motions a, b and c of moments 0 … ``last``, ten steps apart, and transitions of ten steps."""
    graph = networkx.DiGraph()
    for name in "abc":
        for k in range(last):
            graph.add_edge((name, k), (name, k + 1), steps=10, number=None)
    for number, (one, other) in enumerate(edges):
        graph.add_edge(one, other, steps=10, number=number)
    return graph


def test_it_leaves_at_the_first_transition_once_the_time_is_up() -> None:
    graph = network((("a", 0), ("b", 0)), (("a", 2), ("b", 1)), (("a", 3), ("b", 0)))
    nodes, marks = commanded(graph, [Command("a", 15), Command("b", 10)], ("a", 0))
    assert nodes == [("a", 0), ("a", 1), ("a", 2), ("b", 1), ("b", 2)] and marks == [2]


def test_it_waits_for_a_transition_that_lets_it_stay_long_enough() -> None:
    """b is to last three moments: it is not entered where only one is left."""
    graph = network((("a", 1), ("b", 2)), (("a", 3), ("b", 0)))
    nodes, marks = commanded(graph, [Command("a", 10), Command("b", 30)], ("a", 0))
    assert nodes[marks[0] + 1] == ("b", 0) and nodes[-1] == ("b", 3)


def test_a_loop_keeps_a_motion_up() -> None:
    graph = network((("a", 3), ("a", 1)), (("a", 2), ("b", 0)))
    nodes, _ = commanded(graph, [Command("a", 60), Command("b", 10)], ("a", 0))
    spent = nodes.index(("b", 0)) - 1
    assert nodes.count(("a", 3)) == 2 and spent >= 6
    assert nodes[spent] == ("a", 2)


def test_another_motion_is_crossed_only_where_there_is_no_other_way() -> None:
    around = ((("a", 3), ("c", 0)), (("c", 1), ("a", 0)))
    nodes, _ = commanded(network(*around), [Command("a", 50)], ("a", 0))
    assert nodes.count(("c", 1)) == 1 and nodes[-1][0] == "a"
    nodes, _ = commanded(network(*around, (("a", 3), ("a", 0))), [Command("a", 50)], ("a", 0))
    assert {node[0] for node in nodes} == {"a"}


def test_what_cannot_be_followed_is_said() -> None:
    with pytest.raises(ProblemError, match="^command 2 cannot be followed: .* 40 steps of 'b'"):
        commanded(network((("a", 1), ("b", 0))), [Command("a", 10), Command("b", 40)], ("a", 0))
