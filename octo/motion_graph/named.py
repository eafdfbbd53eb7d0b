"""Motions by their names: what a graph is made of where nothing else is given."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from octo.errors import ProblemError, UnknownNameError
from octo.jump import jump
from octo.model.character import Character
from octo.motion_graph.crossing import Placement, laid_end_to_end
from octo.motions import stride, turn, walk
from octo.result.solution import Solution

SPEED = 0.5  # m/s, rad/s
HIGH = 0.1  # m, of a jump on the spot


def _walks(made: Callable[..., Solution], sign: float) -> Callable[..., Solution]:
    def motion(robot: Character, seconds: float, **how: Any) -> Solution:
        return made(robot, sign * SPEED, seconds, **how)

    return motion


def jumps(robot: Character, seconds: float, **how: Any) -> Solution:
    """Jumps on the spot, one after the other, from rest to rest, and standing behind the last.

    how: as that of :func:`octo.jump`, ``pose`` too.
    """
    one = jump(robot, HIGH, 0.0, **how)
    dt, many = one.dt, int(seconds / (one.steps * one.dt) + 1e-9)
    if not one.converged or many < 1:
        why = f"takes {one.steps * dt:.3g} s" if one.converged else one.sentence
        raise ProblemError(f"motion 'jump' of {robot.name}, {HIGH} m high: {why}")
    return _repeated(one, many, round(seconds / dt))


def _repeated(one: Solution, many: int, steps: int) -> Solution:
    """A motion from rest to rest ``many`` times, each where the last one ended, then at rest."""
    robot = one.character
    assert robot is not None
    base, x = robot.base_coordinate, one.x[1:]
    parts, last = [x[:1]], x[0]
    for _ in range(many):
        ground = last[base : base + 2] - x[0, base : base + 2]
        parts.append(Placement(0.0, ground).moved(x[1:], base))
        last = parts[-1][-1]
    nodes = np.concatenate(parts)[: steps + 1]
    nodes = np.concatenate([nodes, np.tile(nodes[-1], (steps + 1 - len(nodes), 1))])
    return laid_end_to_end(np.concatenate([nodes[:1], nodes]), one)


NAMED: dict[str, Callable[..., Solution]] = {
    "walk": _walks(walk, 1.0),
    "back": _walks(walk, -1.0),
    "left": _walks(turn, 1.0),
    "right": _walks(turn, -1.0),
    "stride_left": _walks(stride, 1.0),
    "stride_right": _walks(stride, -1.0),
    "jump": jumps,
}


POSED = ("jump",)  # begin in any pose; the others stand as their strides do


def check_name(name: object) -> str:
    """A name of a motion, as it is.

    Raises
    ------
    UnknownNameError: naming those that there are.
    """
    if not isinstance(name, str) or name not in NAMED:
        raise UnknownNameError("motion", str(name), NAMED)
    return name
