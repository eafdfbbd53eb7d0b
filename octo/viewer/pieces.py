"""The edges of a motion graph, each ready to be laid anywhere: where its bodies are at its frames,
and what its contacts carry, as seen from where the base stands and heads at its start."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from octo.model.character import Character
from octo.model.kinematics import body_poses
from octo.model.quantities import Array
from octo.model.quaternions import quaternions
from octo.motion_graph.crossing import Placement
from octo.motion_graph.graph import MotionGraph
from octo.motion_graph.route import Edge
from octo.motion_graph.script import Node
from octo.result.solution import Solution
from octo.result.trajectory import carrying

RATE = 30.0  # frames a second, at least where a motion has as many


@dataclass(frozen=True, eq=False)
class Piece:
    """An edge. Its x, y and heading are 0 at its start.

    Attributes
    ----------
    rotation: (frames, bodies, 4) quaternions, real part first. origin: (frames, bodies, 3) m.
    force: (frames - 1, c, 3) N on the contacts with the ground, in the step that ends a frame; 0
        of those that do not carry.
    end: where the next piece is laid.
    """

    start: Node
    stop: Node
    crosses: bool
    rotation: Array
    origin: Array
    force: Array
    end: Placement


def pieces_of(graph: MotionGraph, pairs: Iterable[tuple[Node, Node]]) -> list[Piece]:
    """A piece for each edge between two nodes."""
    each = _steps_of_a_frame(graph)
    return [_piece(edge, graph.motions[edge.start[0]], each) for edge in graph.edges(pairs)]


def frame_seconds(graph: MotionGraph) -> float:
    """s from frame to frame."""
    return _steps_of_a_frame(graph) * graph.dt


def _steps_of_a_frame(graph: MotionGraph) -> int:
    """So many that every edge is a whole number of frames."""
    common = math.gcd(graph.apart, graph.crossing)
    most = max(1, round(1.0 / (RATE * graph.dt)))
    return max(each for each in range(1, most + 1) if common % each == 0)


def _piece(edge: Edge, motion: Solution, each: int) -> Piece:
    """``each``: steps of a frame."""
    robot, at = motion.character, edge.start[1]
    assert robot is not None
    if edge.x is None or edge.force is None:
        x = motion.x[at + 1 : at + edge.steps + 2]
        force, loaded = (own[at : at + edge.steps] for own in (motion.contact_force, motion.loaded))
    else:
        x, force = edge.x, edge.force
        loaded = carrying(force[..., 2], motion.weight, robot)  # the ground is level
    first = robot.base_coordinate
    x = _from(x[0], first).moved(x[::each], first)
    rotation, origin = _poses(robot, x)
    end = Placement(float(x[-1, first + 3]), x[-1, first : first + 2])
    carried = np.where(loaded[..., None], force, 0.0)[each - 1 :: each]
    return Piece(edge.start, edge.end, edge.x is not None, rotation, origin, carried, end)


def _from(x: Array, first: int) -> Placement:
    """Where all lies as seen from the base of x (nx,), whose coordinates begin at ``first``."""
    turn = Placement(-float(x[first + 3]), np.zeros(2))
    return Placement(turn.yaw, -turn.then(Placement(0.0, x[first : first + 2])).shift)


def _poses(robot: Character, x: Array) -> tuple[Array, Array]:
    turns, origin = body_poses(robot, x)
    rotation = np.stack([quaternions(turns[:, b]) for b in range(len(robot.bodies))], axis=1)
    return rotation, origin
