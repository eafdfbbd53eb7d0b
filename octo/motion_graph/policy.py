"""What a steered character does next: for each moment of a motion graph, and each motion that may
be wanted, the moment that follows (§8.6).

A motion that is wanted is reached as soon as it can be, by Dijkstra's algorithm from all of its
moments backwards. Once there it goes on along the motion, by a loop where it would end, and where
no loop is left the quickest way out of it and back.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any

from octo.errors import ProblemError
from octo.motion_graph.script import Node

if TYPE_CHECKING:
    import networkx

# steps until the motion is reached; minus those that it can be kept up for; effort
Cost = tuple[int, float, float]
FOR_EVER = float("inf")


@dataclass(frozen=True)
class Policy:
    """What :func:`policy` returns.

    Attributes
    ----------
    start: the earliest moment of the first of ``motions``.
    motions: those that may be wanted, at any time: from everywhere a way leads there, and back.
    following: of each node and each of ``motions``, the node that follows.
    """

    start: Node
    motions: tuple[str, ...]
    following: Mapping[Node, Mapping[str, Node]]

    @property
    def edges(self) -> list[tuple[Node, Node]]:
        """All that are ever taken from the start on, whatever is wanted and when."""
        seen, left = {self.start}, [self.start]
        found: set[tuple[Node, Node]] = set()
        while left:
            node = left.pop()
            for other in self.following[node].values():
                found.add((node, other))
                if other not in seen:
                    seen.add(other)
                    left.append(other)
        return sorted(found)


def policy(network: networkx.DiGraph, names: Sequence[str]) -> Policy:
    """What follows each node of :attr:`MotionGraph.network`.

    Parameters
    ----------
    names: of the motions, in their order. Those without a moment in the largest part of the graph
        in which every node is reached from every other one are left out.

    Raises
    ------
    ProblemError: there is no such part: nothing can go on for ever.
    """
    import networkx as nx  # it is there where a graph is

    core: set[Node] = max(nx.strongly_connected_components(network), key=len, default=set())
    if not network.subgraph(core).number_of_edges():
        raise ProblemError(
            "no motion of the graph can be kept up or left and reached again: it needs loops or "
            "transitions"
        )
    graph = network.subgraph(core | nx.ancestors(network, min(core)))
    motions = tuple(name for name in names if any(node[0] == name for node in core))
    following: dict[Node, dict[str, Node]] = {node: {} for node in graph}
    for name in motions:
        for node, other in _wanted(graph, name).items():
            following[node][name] = other
    start = min(node for node in graph if node[0] == motions[0])
    return Policy(start, motions, following)


def _wanted(graph: networkx.DiGraph, name: str) -> dict[Node, Node]:
    """What follows each node where motion ``name`` is wanted."""
    own = graph.subgraph(node for node in graph if node[0] == name)
    goes_on, stays = _going_on(own)
    reached, back = _reaching(graph, {node: (0, -stays[node], 0.0) for node in own})
    following = {node: other for node, other in back.items() if node not in own}
    for node in own:
        if node in goes_on:
            following[node] = goes_on[node]
        else:
            out = {m: edge for m, edge in graph.adj[node].items() if m not in own}
            following[node] = min(out, key=lambda m: (_further(reached[m], out[m]), m))
    return following


def _going_on(own: networkx.DiGraph) -> tuple[dict[Node, Node], dict[Node, float]]:
    """What follows each node within its motion, ``own``, if anything does, and for how many steps
    the motion can be kept up from there."""
    kept = set(own)
    while gone := {node for node in kept if not kept.intersection(own.adj[node])}:
        kept -= gone
    goes_on: dict[Node, Node] = {}
    for node in own:
        among = [m for m in own.adj[node] if m in kept or node not in kept]
        if among:
            edges = own.adj[node]
            goes_on[node] = min(among, key=lambda m: (_crosses(edges[m]), edges[m]["effort"], m))
    stays = dict.fromkeys(kept, FOR_EVER)
    for first in own:
        way = [first]
        while way[-1] not in stays and way[-1] in goes_on:
            way.append(goes_on[way[-1]])
        stays.setdefault(way[-1], 0.0)
        for node in reversed(way[:-1]):
            stays[node] = stays[goes_on[node]] + own.edges[node, goes_on[node]]["steps"]
    return goes_on, stays


def _crosses(edge: Mapping[str, Any]) -> bool:
    """Whether it is a transition: not along a motion."""
    return edge["number"] is not None


def _further(cost: Cost, edge: Mapping[str, Any]) -> Cost:
    """One edge before."""
    return cost[0] + edge["steps"], cost[1], cost[2] + edge["effort"]


def _reaching(
    graph: networkx.DiGraph, ends: Mapping[Node, Cost]
) -> tuple[dict[Node, Cost], dict[Node, Node]]:
    """The least cost from each node to one of the ends, and what follows the node."""
    best, following = dict(ends), dict[Node, Node]()
    order = count()
    heap = [(cost, next(order), node) for node, cost in best.items()]
    heapq.heapify(heap)
    while heap:
        cost, _, node = heapq.heappop(heap)
        if cost > best[node]:
            continue
        for before, edge in graph.pred[node].items():
            further = _further(cost, edge)
            if before not in best or further < best[before]:
                best[before], following[before] = further, node
                heapq.heappush(heap, (further, next(order), before))
    return best, following
