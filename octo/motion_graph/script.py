"""The way through a motion graph that does what it is told, as soon as it can.

Dijkstra's algorithm over states (command, node, steps spent on the command so far, at most those
that were asked for). What it keeps small: steps beyond what was asked for; and only where a motion
can neither go on nor be left for what is wanted, steps in other motions.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any

from octo.errors import ProblemError

if TYPE_CHECKING:
    import networkx

Node = tuple[str, int]
State = tuple[int, Node, int]  # command, node, steps spent on it
AWAY = 1000.0  # of a step in a motion that was not asked for, beside one of waiting
LOOP = 1e-3  # of a way back, beside a step of waiting


@dataclass(frozen=True)
class Command:
    """A motion, and how many steps it lasts."""

    name: str
    steps: int


def commanded(
    network: networkx.DiGraph, commands: Sequence[Command], start: Node
) -> tuple[list[Node], list[int]]:
    """The nodes of the way, and for each command but the first the edge that leads to it.

    Raises
    ------
    ProblemError: there is none; naming the command that is not reached.
    """
    begin: State = (0, start, 0)
    cost, before = {begin: 0.0}, {begin: begin}
    order = count()
    heap: list[tuple[float, int, State]] = [(0.0, next(order), begin)]
    done: set[State] = set()
    furthest = 0
    while heap:
        so_far, _, state = heapq.heappop(heap)
        if state in done:
            continue
        done.add(state)
        furthest = max(furthest, state[0])
        if _finished(state, commands):
            return _traced(before, state)
        for following, more in _ways(network, commands, state):
            if so_far + more < cost.get(following, float("inf")):
                cost[following], before[following] = so_far + more, state
                heapq.heappush(heap, (so_far + more, next(order), following))
    name, steps = commands[furthest].name, commands[furthest].steps
    after = f", and then {commands[furthest + 1].name!r}" if furthest + 1 < len(commands) else ""
    raise ProblemError(
        f"command {furthest + 1} cannot be followed: no way through the graph has {steps} steps "
        f"of {name!r}{after}; add loops or transitions"
    )


def _finished(state: State, commands: Sequence[Command]) -> bool:
    number, node, spent = state
    last = len(commands) - 1
    return number == last and node[0] == commands[last].name and spent >= commands[last].steps


def _ways(
    network: networkx.DiGraph, commands: Sequence[Command], state: State
) -> Iterator[tuple[State, float]]:
    """The states behind one, and what each costs."""
    number, node, spent = state
    own = commands[number]
    enough = spent >= own.steps
    wanted = commands[number + 1].name if number + 1 < len(commands) else None
    for other, edge in network.adj[node].items():
        steps, crosses = edge["steps"], edge["number"] is not None
        if enough and other[0] == wanted and crosses:
            yield (number + 1, other, 0), LOOP
        if node[0] == own.name and other[0] == own.name:
            late = max(spent + steps - own.steps, 0)
            waited = float(min(late, steps)) + (LOOP if crosses else 0.0)
            yield (number, other, min(spent + steps, own.steps)), waited
        else:
            yield (number, other, spent), AWAY * steps


def _traced(before: dict[State, Any], state: State) -> tuple[list[Node], list[int]]:
    """From the start to a state."""
    states = [state]
    while before[state] != state:
        state = before[state]
        states.append(state)
    states.reverse()
    marks = [k for k, (a, b) in enumerate(zip(states[:-1], states[1:], strict=True)) if a[0] < b[0]]
    return [own[1] for own in states], marks
