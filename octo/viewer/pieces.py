"""The edges of a motion graph, each ready to be laid anywhere: where its bodies are at its frames,
and what its contacts carry, as seen from where the base stands and heads at its start."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from octo.dynamics.crowd import crowd_columns
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
    each, robot = _steps_of_a_frame(graph), next(iter(graph.motions.values())).character
    assert robot is not None
    edges = graph.edges(pairs)
    paths = [_path(edge, graph.motions[edge.start[0]])[::each] for edge in edges]
    # all at once: one edge after the other takes four times as long
    turns, origins = body_poses(robot, np.concatenate(paths))
    rotations = np.stack([quaternions(turns[:, b]) for b in range(len(robot.bodies))], axis=1)
    ends = np.cumsum([len(x) for x in paths])[:-1]
    poses = zip(np.split(rotations, ends), np.split(origins, ends), strict=True)
    first, pieces = robot.base_coordinate, []
    for edge, x, (rotation, origin) in zip(edges, paths, poses, strict=True):
        force = _carried(edge, graph.motions[edge.start[0]])[each - 1 :: each]
        end = Placement(float(x[-1, first + 3]), x[-1, first : first + 2])
        pieces.append(Piece(edge.start, edge.end, edge.x is not None, rotation, origin, force, end))
    return pieces


def frame_seconds(graph: MotionGraph) -> float:
    """s from frame to frame."""
    return _steps_of_a_frame(graph) * graph.dt


def _steps_of_a_frame(graph: MotionGraph) -> int:
    """So many that every edge is a whole number of frames."""
    common = math.gcd(graph.apart, graph.crossing)
    most = max(1, round(1.0 / (RATE * graph.dt)))
    return max(each for each in range(1, most + 1) if common % each == 0)


def _path(edge: Edge, motion: Solution) -> Array:
    """(steps + 1, nx) as seen from where the base stands and heads at the start."""
    robot, at = motion.character, edge.start[1]
    assert robot is not None
    x, first = edge.x, robot.base_coordinate
    x = motion.x[at + 1 : at + edge.steps + 2] if x is None else x
    turn = Placement(-float(x[0, first + 3]), np.zeros(2))
    there = turn.then(Placement(0.0, x[0, first : first + 2])).shift
    return Placement(turn.yaw, -there).moved(x, first)


def _carried(edge: Edge, motion: Solution) -> Array:
    """(steps, c, 3) N, 0 of contacts that do not carry."""
    at = edge.start[1]
    if edge.force is None:
        force, loaded = (own[at : at + edge.steps] for own in (motion.contact_force, motion.loaded))
    else:
        force = edge.force
        crowds = crowd_columns(motion.character)
        loaded = carrying(force[..., 2], motion.weight, crowds)  # the ground is level
    return np.asarray(np.where(loaded[..., None], force, 0.0))
