"""Worlds by name, as ``octo.worlds.stairs(rise=0.1)`` or ``--world stairs:rise=0.1``: what a robot
meets on its way along the x axis.

Lengths are m. The ground is at height 0; the robot stands at the origin on level ground, which ends
``start`` m ahead of it. Parts overlap wherever one goes on from another, so that no rounded edge
leaves a seam that a foot could catch in.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from octo.checks import Array, flag, number, positive, whole
from octo.errors import ValueRangeError
from octo.world.shapes import Box, Ground, Shape
from octo.world.world import World

START = 0.6  # m, from the origin to the first obstacle: no robot of the gallery stands so far ahead
FAR = 10.0  # m, how far platforms go on behind the robot and beyond the obstacle
SUNK = 0.3  # m, of what stands on the ground that is below it
STEEPEST = 0.75  # rad, of a ramp
TILT = 0.1  # rad, most that a stone of rubble leans
MOVED, WIDEST = 0.1, 1.4  # in parts of the way from stone to stone: off its place, its edge
OVERLAP = 0.1  # m, of parts that go on from one another
ROUNDING = 0.01  # m, of the edges

Interval = tuple[float, float]


def stairs(
    rise: float = 0.1,
    run: float = 0.3,
    n: int = 5,
    width: float = 1.5,
    landing: float = 1.0,
    down: bool = True,
    start: float = START,
) -> World:
    """Stairs up, a landing and stairs down again.

    Parameters
    ----------
    rise, run: m, height and depth of each step. n: how many of them go up.
    width: m, across. landing: m, length of the top, its step included.
    down: as many steps go down behind it; else it ends in a wall.
    start: m, of the first riser ahead of the origin.

    Raises
    ------
    ValueRangeError: a size that is not positive, or no step.
    """
    sizes = _lengths("stairs", rise=rise, run=run, width=width, landing=landing, start=start)
    rise, run, width, landing, start = sizes
    count, down = whole("n of stairs", n), flag("down of stairs", down)
    parts: list[Shape] = []
    for k in range(count):  # each goes on below all that are higher
        first = start + k * run
        behind = (count - 1 - k) * run
        last = start + (count - 1) * run + landing + (behind if down else 0.0)
        parts.append(_box(f"step {k + 1}", (first, last), _across(width), (-SUNK, (k + 1) * rise)))
    return World([Ground(name="ground"), *parts])


def gap(width: float = 0.25, depth: float = 1.0, start: float = START) -> World:
    """A gap across the way, too deep to step into.

    Parameters
    ----------
    width: m, from edge to edge. depth: m, down to its floor. start: m, of its near edge ahead of
        the origin.

    Raises
    ------
    ValueRangeError: a size that is not positive.
    """
    width, depth, start = _lengths("gap", width=width, depth=depth, start=start)
    return World(_banks(start, width, depth))


def ditch(width: float = 0.6, depth: float = 0.15, start: float = START) -> World:
    """A ditch across the way, to step into and out of.

    Parameters
    ----------
    width: m, of its floor. depth: m, of its floor below the ground. start: m, of its near edge
        ahead of the origin.

    Raises
    ------
    ValueRangeError: a size that is not positive.
    """
    width, depth, start = _lengths("ditch", width=width, depth=depth, start=start)
    return World(_banks(start, width, depth))


def beam(
    width: float = 0.2, length: float = 2.0, depth: float = 1.0, start: float = START
) -> World:
    """A beam over a gap, as high as the ground on both sides.

    Parameters
    ----------
    width: m, across. length: m, from bank to bank. depth: m, down to the floor on either side.
    start: m, of its near end ahead of the origin.

    Raises
    ------
    ValueRangeError: a size that is not positive.
    """
    sizes = _lengths("beam", width=width, length=length, depth=depth, start=start)
    width, length, depth, start = sizes
    along = (start - OVERLAP, start + length + OVERLAP)
    bar = _box("beam", along, _across(width), (-depth - SUNK, 0.0))
    return World([*_banks(start, length, depth), bar])


def blocks(
    height: float = 0.15,
    n: int = 1,
    length: float = 1.0,
    width: float = 1.5,
    apart: float = 0.5,
    start: float = START,
) -> World:
    """Blocks to climb onto, one behind the other.

    Parameters
    ----------
    height: m, of each. n: how many.
    length, width: m, of each along the way and across it.
    apart: m, of level ground between two of them. start: m, of the first ahead of the origin.

    Raises
    ------
    ValueRangeError: a size that is not positive, or no block.
    """
    own = {"height": height, "length": length, "width": width, "apart": apart, "start": start}
    height, length, width, apart, start = _lengths("blocks", **own)
    parts: list[Shape] = []
    for k in range(whole("n of blocks", n)):
        first = start + k * (length + apart)
        along = (first, first + length)
        parts.append(_box(f"block {k + 1}", along, _across(width), (-SUNK, height)))
    return World([Ground(name="ground"), *parts])


def rubble(
    seed: int = 0,
    height: float = 0.05,
    length: float = 3.0,
    width: float = 2.0,
    stone: float = 0.3,
    start: float = START,
) -> World:
    """A field of stones that lean and lie at random, without gaps between them.

    Parameters
    ----------
    seed: of the stones: the same number, the same field. height: m, of the highest of them.
    length, width: m, of the field along the way and across it. stone: m, from one stone to the
        next. start: m, of the field ahead of the origin.

    Raises
    ------
    ValueRangeError: a size that is not positive.
    """
    own = {"height": height, "length": length, "width": width, "stone": stone, "start": start}
    height, length, width, stone, start = _lengths("rubble", **own)
    rng = np.random.default_rng(whole("seed of rubble", seed, 0))
    reach = (MOVED + WIDEST / math.sqrt(2.0)) * stone  # m, of a stone from its place at most
    rows, columns = (max(1, 1 + int((size - 2.0 * reach) / stone)) for size in (length, width))
    parts: list[Shape] = []
    for k in range(rows):
        for j in range(columns):
            place = np.array([start + reach + k * stone, (j - 0.5 * (columns - 1)) * stone])
            parts.append(_stone(f"stone {len(parts) + 1}", rng, place, stone, height))
    return World([Ground(name="ground"), *parts])


def _stone(name: str, rng: np.random.Generator, place: Array, side: float, height: float) -> Box:
    """One stone about ``place`` (2,) m, wider than ``side`` and no corner of it over ``height``."""
    x, y = place + rng.uniform(-MOVED, MOVED, 2) * side
    edges, turn = side * rng.uniform(1.1, WIDEST, 2), rng.uniform(0.0, math.pi)
    lean = rng.uniform(-1.0, 1.0, 2) * min(TILT, 0.4 * height / side)
    top = rng.uniform(0.4, 1.0) * height - 0.5 * float(np.abs(lean) @ edges)
    rotation = _about(2, turn) @ _about(0, lean[1]) @ _about(1, lean[0])
    center = np.array([x, y, top]) - rotation @ [0.0, 0.0, 0.5 * (height + SUNK)]
    size = (edges[0], edges[1], height + SUNK)
    return Box(size=size, rounding=ROUNDING, position=center, rotation=rotation, name=name)


def slope(
    angle: float = 0.26,
    length: float = 2.0,
    width: float = 2.0,
    landing: float = 1.0,
    start: float = START,
) -> World:
    """A ramp up, a landing and a ramp down again.

    Parameters
    ----------
    angle: rad, of both ramps. length: m, of each, measured along the ground.
    width: m, across. landing: m, length of the top. start: m, of the ramp ahead of the origin.

    Raises
    ------
    ValueRangeError: a size that is not positive, or an angle of no ramp.
    """
    sizes = _lengths("slope", length=length, width=width, landing=landing, start=start)
    length, width, landing, start = sizes
    if not 0.0 < number("angle of slope", angle) <= STEEPEST:
        raise ValueRangeError(
            f"angle of slope is {angle:g} rad, must be over 0 and at most {STEEPEST:g} rad: 15° "
            "are 0.26 rad"
        )
    height = length * math.tan(angle)
    top = (start + length, start + length + landing)
    parts: list[Shape] = [
        _ramp("ramp up", start, height, angle, width, 1.0),
        _box("landing", top, _across(width), (-SUNK, height)),
        _ramp("ramp down", top[1] + length, height, angle, width, -1.0),
    ]
    return World([Ground(name="ground"), *parts])


def _ramp(name: str, foot: float, height: float, angle: float, width: float, sign: float) -> Box:
    """A leaning box whose upper face goes from the ground at x = ``foot`` m up to ``height`` m,
    ahead (``sign`` 1) or back (−1), and on into the ground and the landing."""
    along = np.array([sign * math.cos(angle), 0.0, math.sin(angle)])
    normal = np.array([-sign * math.sin(angle), 0.0, math.cos(angle)])
    low, high = -OVERLAP, height / math.sin(angle) + ROUNDING  # m, along the face
    thick = (height + SUNK) * math.cos(angle)  # m: below its upper end it reaches the ground
    middle = np.array([foot, 0.0, 0.0]) + 0.5 * (low + high) * along - 0.5 * thick * normal
    size = (high - low, width, thick)
    turn = _about(1, -sign * angle)
    return Box(size=size, rounding=ROUNDING, position=middle, rotation=turn, name=name)


def arch(
    height: float = 0.4, width: float = 0.8, thickness: float = 0.1, start: float = START
) -> World:
    """An arch to go through: two posts and a bar across them.

    Parameters
    ----------
    height: m, below the bar. width: m, between the posts. thickness: m, of posts and bar.
    start: m, of the arch ahead of the origin.

    Raises
    ------
    ValueRangeError: a size that is not positive.
    """
    own = {"height": height, "width": width, "thickness": thickness, "start": start}
    height, width, thickness, start = _lengths("arch", **own)
    along, half = (start, start + thickness), 0.5 * width
    up = (-SUNK, height + 0.5 * thickness)  # posts end within the bar
    parts: list[Shape] = [
        _box("left post", along, (half, half + thickness), up),
        _box("right post", along, (-half - thickness, -half), up),
        _box("bar", along, _across(width + 3.0 * thickness), (height, height + thickness)),
    ]
    return World([Ground(name="ground"), *parts])


def _banks(start: float, width: float, depth: float) -> list[Shape]:
    """Level ground before and behind what is ``width`` m wide and ``depth`` m deep, and the floor
    of that."""
    down = (-depth - SUNK, 0.0)
    return [
        Ground(height=-depth, name="floor"),
        _box("near bank", (-FAR, start), _across(2.0 * FAR), down),
        _box("far bank", (start + width, start + width + FAR), _across(2.0 * FAR), down),
    ]


def _box(name: str, x: Interval, y: Interval, z: Interval) -> Box:
    """The box between these coordinates, m."""
    low, high = np.array([x, y, z]).T
    size = tuple((high - low).tolist())
    own = {"rounding": min(ROUNDING, 0.25 * min(size)), "name": name}
    return Box(size=size, position=0.5 * (low + high), **own)


def _across(width: float) -> Interval:
    return -0.5 * width, 0.5 * width


def _about(axis: int, angle: float) -> Array:
    """The rotation (3, 3) by ``angle`` rad about an axis of the world."""
    turned = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    turned[j, j] = turned[k, k] = math.cos(angle)
    turned[k, j], turned[j, k] = math.sin(angle), -math.sin(angle)
    return turned


def _lengths(world: str, **values: float) -> list[float]:
    """The values, in order, each a length (m) over zero."""
    return [positive(f"{name} of {world}", value, "m") for name, value in values.items()]


WORLDS: dict[str, Callable[..., World]] = {
    make.__name__: make for make in (arch, beam, blocks, ditch, gap, rubble, slope, stairs)
}

__all__ = ["WORLDS", *WORLDS]
