"""A snake of equal links, standing like a low bridge: of five, 14 degrees of freedom."""

from __future__ import annotations

import numpy as np

from octo.checks import whole
from octo.errors import ValueRangeError
from octo.model.character import Character
from octo.model.gallery.parts import Builder, Hinge

LINK = 0.4  # m
RADIUS = 0.06  # m
FEWEST = 3
MOST_BETWEEN = 20
DOWN, ASIDE = 1.3, 0.6  # rad, of the default pose


def chain(links: int = 5, between: int = 0) -> Character:
    """Equal capsules of 1 kg and 0.4 m, the middle one is the base; each joint pitches, then yaws:
    4 + 2 ``links`` coordinates.

    Parameters
    ----------
    links: how many. between: contact spheres of each link beside those at its ends, evenly spaced:
        an edge gets 3 cm into a link of 12 cm where there are 3 of them, 6 mm where there are 7.

    Raises
    ------
    ValueRangeError: fewer than three links, or a negative number of spheres.
    """
    whole("links", links)
    whole("between", between, 0, MOST_BETWEEN)
    if links < FEWEST:
        raise ValueRangeError(f"links is {links}, must be at least {FEWEST}")
    builder = Builder("chain" if links == 5 else f"chain{links}")
    half = LINK / 2
    middle = builder.base("middle", (-half, 0.0, 0.0), (half, 0.0, 0.0), RADIUS)
    builder.sphere("middle_front", middle, (half, 0.0, 0.0), RADIUS)
    builder.sphere("middle_back", middle, (-half, 0.0, 0.0), RADIUS)
    _fill(builder, "middle", middle, (-half, half), between)
    feet: list[str] = []
    tips: list[str] = []
    for end, sign, count in (("front", 1.0, links // 2), ("back", -1.0, (links - 1) // 2)):
        parent, position = middle, (sign * half, 0.0, 0.0)
        names = _names(end, count)
        for k, name in enumerate(names):
            pitch, yaw = _bend(k, links)
            first = Hinge("pitch", "y", -1.8, 1.8, sign * pitch, 10.0)
            hinges, tip = (first, Hinge("yaw", "z", -1.4, 1.4, yaw, 10.0)), (sign * LINK, 0.0, 0.0)
            parent, position = builder.link(name, parent, position, hinges, tip, RADIUS), tip
            builder.sphere(name, parent, position, RADIUS)
            _fill(builder, name, parent, (0.0, sign * LINK), between)
        feet += reversed(names)
        tips.append(names[-1])
    builder.pairs += [(tips[0], tips[1]), (tips[0], "middle_back"), (tips[1], "middle_front")]
    return builder.finish(mass=float(links), feet=feet)


def _fill(builder: Builder, name: str, body: int, ends: tuple[float, float], between: int) -> None:
    """Spheres on a link whose ends are at ``ends`` m along its x axis."""
    for k, x in enumerate(np.linspace(ends[0], ends[1], between + 2)[1:-1], 1):
        builder.sphere(f"{name}_between_{k}", body, (float(x), 0.0, 0.0), RADIUS)


def _names(end: str, count: int) -> list[str]:
    """From the base outward."""
    return [
        f"{end}_{'inner' if k == 0 else 'outer' if k == count - 1 else k + 1}" for k in range(count)
    ]


def _bend(k: int, links: int) -> tuple[float, float]:
    """Pitch (of the front) and yaw of a side's joint ``k``: first down, then in a zigzag; fewer
    than five links lie flat, for on two knees and one tip they would fall over."""
    if links < 5:
        return 0.0, ASIDE * (-1.0) ** k
    return (DOWN, -DOWN, 0.0)[min(k, 2)], 0.0 if k == 0 else ASIDE * (-1.0) ** (k + 1)
