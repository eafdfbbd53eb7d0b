"""A way through a motion graph, as one motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from octo.checks import Array
from octo.errors import ProblemError
from octo.motion_graph.crossing import Placement, laid_end_to_end
from octo.motion_graph.script import Command, Node
from octo.result.solution import Solution
from octo.shown import Shown


@dataclass(frozen=True, eq=False)
class Edge:
    """From a moment to the next one on a way.

    Attributes
    ----------
    x: (steps + 1, nx) of a transition, where the motion of ``start`` lies as it was found; None
        along a motion.
    yaw, shift: rad, (2,) m, where the motion of ``end`` lies behind it.
    force: (steps, c, 3) N of a transition, of the contacts with the ground.
    """

    start: Node
    end: Node
    steps: int
    x: Array | None = None
    yaw: float = 0.0
    shift: Array | None = None
    force: Array | None = None

    @property
    def placement(self) -> Placement:
        return Placement(self.yaw, np.zeros(2) if self.shift is None else self.shift)


@dataclass(frozen=True)
class Switch:
    """From one command to the next, s from the start: when it was due, when the motion before was
    left, and when the new one was reached."""

    motion: str
    due: float
    left: float
    reached: float

    @property
    def wait(self) -> float:
        """s, until the robot does what it is told."""
        return self.left - self.due


@dataclass(frozen=True, eq=False, repr=False)
class Route(Shown):
    """What :meth:`MotionGraph.route` and :meth:`MotionGraph.way` return.

    Attributes
    ----------
    motions: those of the graph. edges: in their order.
    commands: what was asked for. marks: of each command but the first, which edge leads to it.
    """

    motions: Mapping[str, Solution]
    edges: tuple[Edge, ...]
    start: Node
    commands: tuple[Command, ...] = ()
    marks: tuple[int, ...] = ()

    @property
    def nodes(self) -> list[Node]:
        return [self.start, *(edge.end for edge in self.edges)]

    @property
    def seconds(self) -> float:
        """s, of all of it."""
        return sum(edge.steps for edge in self.edges) * self._first.dt

    @property
    def _first(self) -> Solution:
        return self.motions[self.start[0]]

    @cached_property
    def switches(self) -> list[Switch]:
        """When each command but the first was followed."""
        dt, ends = self._first.dt, np.cumsum([0, *(edge.steps for edge in self.edges)])
        made, reached = [], 0
        for before, command, mark in zip(
            self.commands[:-1], self.commands[1:], self.marks, strict=True
        ):
            due, left = reached + before.steps, int(ends[mark])
            reached = int(ends[mark + 1])
            made.append(Switch(command.name, due * dt, left * dt, reached * dt))
        return made

    @cached_property
    def motion(self) -> Solution:
        """All of it as one motion, whose ‖C‖∞, torques and forces are measured anew, at the joints
        of edges too.

        Raises
        ------
        ProblemError: the way has less than three steps.
        """
        if sum(edge.steps for edge in self.edges) < 3:
            raise ProblemError(f"the way from {self.start} is no motion: it has no three steps")
        name, step = self.start
        place, parts = Placement(0.0, np.zeros(2)), [self._first.x[step : step + 2]]
        robot = self._first.character
        assert robot is not None
        for edge in self.edges:
            name, step = edge.start
            x = self.motions[name].x[step + 2 : step + edge.steps + 2]
            parts.append(place.moved(x if edge.x is None else edge.x[1:], robot.base_coordinate))
            place = place.then(edge.placement)
        return laid_end_to_end(np.concatenate(parts), self._first)

    def report(self) -> dict[str, Any]:
        """The numbers of report.json: nodes, and when each command but the first was followed."""
        return {
            "nodes": [list(node) for node in self.nodes],
            "switches": [{**asdict(own), "wait": own.wait} for own in self.switches],
        }

    def __str__(self) -> str:
        crossed = sum(edge.x is not None for edge in self.edges)
        lines = [
            f"{self.seconds:.4g} s from {_said(self.start)} to {_said(self.nodes[-1])}, "
            f"{crossed} transitions"
        ]
        lines += [
            f"  {own.motion}: due at {own.due:.2f} s, begun at {own.left:.2f} s, reached at "
            f"{own.reached:.2f} s"
            for own in self.switches
        ]
        return "\n".join(lines)


def _said(node: Node) -> str:
    return f"{node[0]}, step {node[1]}"


def waits(routes: Sequence[Route]) -> Array:
    """(n,) s, of all switches."""
    return np.array([switch.wait for route in routes for switch in route.switches])
