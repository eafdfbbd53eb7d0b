"""The motion graph: moments of motions, and the ways between them (§8.6)."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from octo.checks import one_of, positive
from octo.errors import MissingExtraError, ProblemError, UnknownNameError, ValueRangeError, said
from octo.motion_graph.file import File
from octo.motion_graph.route import Edge, Route
from octo.motion_graph.script import Command, Node, commanded
from octo.motion_graph.work import effort_of
from octo.result.solution import Solution
from octo.shown import Shown

if TYPE_CHECKING:
    import networkx

By = Literal["time", "effort"]
MEASURE = {"time": "seconds", "effort": "effort"}  # of an edge


@dataclass(frozen=True, eq=False, repr=False)
class MotionGraph(Shown):
    """Motions of one robot, and transitions between them, as :func:`octo.motion_graph.build` made
    them.

    A node is a moment of a motion, (name, step); an edge leads along a motion to its next moment,
    or by a transition to another motion, or back into the same one.

    Attributes
    ----------
    path: of its file.
    left_out: numbers of transitions that :meth:`pruned` took away.
    """

    path: str | os.PathLike[str]
    left_out: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        _networkx()
        with File(self.path) as file:
            names = file.names
        if not names:
            raise ProblemError(f"{self.path} has no motion yet")

    # -- what is there -----------------------------------------------------------------------------

    @cached_property
    def record(self) -> dict[str, Any]:
        """What it was built with."""
        with File(self.path) as file:
            return file.record

    @cached_property
    def motions(self) -> Mapping[str, Solution]:
        """By name."""
        with File(self.path) as file:
            return {name: file.motion(name) for name in file.names}

    @cached_property
    def table(self) -> list[dict[str, Any]]:
        """A row for each pair of moments that was solved: number, one, at, other, to, found,
        reason, and numbers that say how good it is."""
        with File(self.path) as file:
            return file.table()

    @cached_property
    def network(self) -> networkx.DiGraph:
        """All nodes and edges; an edge has ``steps``, ``seconds``, ``effort`` (∫‖u‖²dt) and
        ``number``, of its transition, or None along a motion."""
        graph = _networkx().DiGraph()
        for name, motion in self.motions.items():
            moments = range(0, motion.steps + 1, self.apart)
            graph.add_nodes_from((name, step) for step in moments)
            for step in moments[:-1]:
                u, span = motion.u[step : step + self.apart], self.apart * motion.dt
                numbers = {"effort": effort_of(u, motion.dt), "number": None}
                edge = (name, step), (name, step + self.apart)
                graph.add_edge(*edge, steps=self.apart, seconds=span, **numbers)
        for row in self._kept:
            numbers = {"effort": row["effort"], "number": row["number"]}
            edge = (row["one"], row["at"]), (row["other"], row["to"])
            span = self.crossing * self.dt
            graph.add_edge(*edge, steps=self.crossing, seconds=span, **numbers)
        return graph

    @property
    def _kept(self) -> list[dict[str, Any]]:
        """The rows of the transitions that it has."""
        return [row for row in self.table if row["found"] and row["number"] not in self.left_out]

    @property
    def dt(self) -> float:
        """s, of a step of all motions."""
        return next(iter(self.motions.values())).dt

    @property
    def apart(self) -> int:
        """Steps between two moments of a motion."""
        return round(self.record["moments"] / self.dt) * int(self.record["every"])

    @property
    def crossing(self) -> int:
        """Steps of a transition."""
        return round(self.record["transitions"] / self.dt)

    @cached_property
    def strong(self) -> networkx.DiGraph:
        """The largest part in which every node is reached from every other one."""
        nodes = max(_networkx().strongly_connected_components(self.network), key=len)
        return self.network.subgraph(nodes).copy()

    # -- which of them -----------------------------------------------------------------------------

    def pruned(
        self,
        *,
        distance: float | None = None,
        torque: float | None = None,
        effort: float | None = None,
        best: int | None = None,
    ) -> MotionGraph:
        """The same with the better transitions alone.

        Parameters
        ----------
        distance: m, rms, by which both motions may differ. torque: largest |u|/limit. effort:
            ∫‖u‖²dt. best: from each moment to each other motion so many, those of least effort.
        """
        most = {"distance": distance, "torque": torque, "effort": effort}
        for name, limit in most.items():
            if limit is not None:
                positive(name, limit)
        rows = self._kept
        out = {
            row["number"]
            for row in rows
            for name, limit in most.items()
            if limit is not None and row[name] > limit
        }
        if best is not None:
            if best < 1:
                raise ValueRangeError(f"best is {best}, must be at least 1")
            seen: Counter[Any] = Counter()
            for row in sorted(rows, key=lambda row: (row["effort"], row["number"])):
                key = row["one"], row["at"], row["other"]
                if row["number"] not in out and row["one"] != row["other"]:
                    seen[key] += 1
                    out |= {row["number"]} if seen[key] > best else set()
        return MotionGraph(self.path, self.left_out | out)

    # -- through it --------------------------------------------------------------------------------

    def way(self, start: Node, end: Node | str, by: By = "time") -> Route:
        """The shortest way from a node to another one, or to any node of a motion.

        Parameters
        ----------
        by: "time", or "effort", ∫‖u‖²dt.

        Raises
        ------
        OctoError: there is no such node, or no way.
        """
        nx = _networkx()
        one_of("by", by, MEASURE)
        self._check(start)
        if isinstance(end, str):
            self._check_name(end)
        else:
            self._check(end)
        length, ways = nx.single_source_dijkstra(self.network, start, weight=MEASURE[by])
        ends = [end] if not isinstance(end, str) else [n for n in ways if n[0] == end]
        reached = [node for node in ends if node in ways]
        if not reached:
            raise ProblemError(f"no way leads from {start} to {end}")
        return self._route(ways[min(reached, key=lambda node: length[node])])

    def path_between(self, start: Node, end: Node | str, by: By = "time") -> Solution:
        """The motion of :meth:`way`."""
        return self.way(start, end, by).motion

    def route(self, commands: Sequence[tuple[str, float]], start: Node | None = None) -> Route:
        """A way that does what it is told: each command is a motion and how long it lasts, s.

        It stays in the motion for so long, by its loops where it is shorter, and then leaves it as
        soon as a transition to the next one is there.

        Parameters
        ----------
        start: the node at which it begins; by default the first of the first motion.

        Raises
        ------
        OctoError: a motion or the start is not there, or the commands cannot be followed: which.
        """
        told = []
        for name, seconds in commands:
            self._check_name(name)
            steps = round(positive("seconds of a command", seconds, "s") / self.dt)
            told.append(Command(name, max(steps, 1)))
        if not told:
            raise ProblemError("commands is empty, must hold (motion, seconds)")
        begin = (told[0].name, 0) if start is None else start
        self._check(begin)
        nodes, marks = commanded(self.network, told, begin)
        return self._route(nodes, tuple(told), tuple(marks))

    def play(self, commands: Sequence[tuple[str, float]], start: Node | None = None) -> Solution:
        """The motion of :meth:`route`."""
        return self.route(commands, start).motion

    def _route(
        self, nodes: Sequence[Node], commands: tuple[Command, ...] = (), marks: tuple[int, ...] = ()
    ) -> Route:
        pairs = zip(nodes[:-1], nodes[1:], strict=True)
        return Route(self.motions, tuple(self.edges(pairs)), nodes[0], commands, marks)

    def edges(self, pairs: Iterable[tuple[Node, Node]]) -> list[Edge]:
        """The edges between nodes, with what the file holds of them.

        Raises
        ------
        OctoError: there is no such node or edge.
        """
        edges = []
        rows = {row["number"]: row for row in self.table}
        nx = next(iter(self.motions.values())).x.shape[1]
        with File(self.path) as file:
            for one, other in pairs:
                self._check(one)
                self._check(other)
                if not self.network.has_edge(one, other):
                    raise ProblemError(f"no edge leads from {one} to {other}")
                found = self.network.edges[one, other]
                number = found["number"]
                if number is None:
                    edges.append(Edge(one, other, found["steps"]))
                    continue
                row, (x, _, force) = rows[number], file.arrays(number, nx)
                shift = np.array([row["shift_x"], row["shift_y"]])
                edges.append(Edge(one, other, found["steps"], x, row["yaw"], shift, force))
        return edges

    def _check_name(self, name: Any) -> None:
        if name not in self.motions:
            raise UnknownNameError("motion", str(name), self.motions)

    def _check(self, node: Any) -> None:
        if not (isinstance(node, tuple) and len(node) == 2):
            raise ProblemError(f"a node is {said(node)}, must be (motion, step)")
        self._check_name(node[0])
        if node not in self.network:
            steps = self.motions[node[0]].steps
            raise ValueRangeError(
                f"step is {node[1]!r}, must be one of 0, {self.apart} … of motion {node[0]!r} of "
                f"{steps} steps"
            )

    # -- numbers -----------------------------------------------------------------------------------

    def report(self) -> dict[str, Any]:
        """How large it is, and how well its motions are reached; seconds and counts."""
        nx, graph = _networkx(), self.network
        crossed = [row for row in self.table if row["one"] != row["other"]]
        found = [row for row in crossed if row["found"]]
        degrees = [degree for _, degree in graph.out_degree()]
        return {
            "robot": self.record["robot"],
            "motions": {name: m.steps * m.dt for name, m in self.motions.items()},
            "pairs": len(crossed),
            "transitions": len(found),
            "loops": sum(bool(row["found"]) for row in self.table) - len(found),
            "shares": shares(crossed),
            "reasons": dict(Counter(row["reason"] for row in crossed if not row["found"])),
            "nodes": graph.number_of_nodes(),
            "edges": graph.number_of_edges(),
            "strong_nodes": self.strong.number_of_nodes(),
            "dead_ends": sum(degree == 0 for degree in degrees),
            "mean_degree": float(np.mean(degrees)),
            "seconds": float(sum(row["seconds"] for row in self.table)),
            "iterations": float(np.median([row["iterations"] for row in crossed] or [0.0])),
            "seconds_to_reach": {name: self._reach(nx, name) for name in self.motions},
        }

    def _reach(self, nx: Any, name: str) -> float | None:
        """s, the mean over nodes of other motions that lead there."""
        back = self.network.reverse(copy=False)
        sources = [node for node in back if node[0] == name]
        far = nx.multi_source_dijkstra_path_length(back, sources, weight="seconds")
        found = [length for node, length in far.items() if node[0] != name]
        return float(np.mean(found)) if found else None

    def __str__(self) -> str:
        own = self.report()
        names = ", ".join(f"{name} {seconds:.3g} s" for name, seconds in own["motions"].items())
        reach = ", ".join(
            f"{name} {'never' if seconds is None else f'{seconds:.2f} s'}"
            for name, seconds in own["seconds_to_reach"].items()
        )
        share = own["transitions"] / max(own["pairs"], 1)
        return "\n".join(
            [
                f"motion graph of {own['robot']}: {names}",
                f"  {own['transitions']} transitions of {own['pairs']} pairs ({share:.0%}), "
                f"{own['loops']} loops; {own['seconds']:.0f} s of processor time",
                f"  {own['nodes']} moments, {own['edges']} ways between them, "
                f"{own['mean_degree']:.1f} from each; {own['strong_nodes']} moments are reached "
                f"from each other, {own['dead_ends']} lead nowhere",
                f"  mean time until a motion is reached: {reach}",
            ]
        )


def shares(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """The share of pairs that were found, of each pair of motions, as "walk, left"."""
    tried = Counter((row["one"], row["other"]) for row in rows)
    found = Counter((row["one"], row["other"]) for row in rows if row["found"])
    return {f"{one}, {other}": found[one, other] / n for (one, other), n in tried.items()}


def _networkx() -> Any:
    try:
        import networkx
    except ImportError as error:
        raise MissingExtraError("a motion graph", "graph") from error
    return networkx
