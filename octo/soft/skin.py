"""What is drawn of a soft body: its surface in two shades, so that one sees how it turns."""

from __future__ import annotations

import numpy as np

from octo.checks import Array
from octo.model.figure import Surface
from octo.model.skins import Skin
from octo.soft.body import Body
from octo.soft.coordinates import Coordinates

SHADES = np.array([[0.26, 0.47, 0.70], [0.47, 0.65, 0.83]])  # colours of the octants, in turn


def soft_skins(body: Body) -> list[Skin]:
    """Two parts, each with all points and half of the triangles, by the octants of the rest
    shape."""
    middle = body.points[body.faces].mean(axis=1)
    other = np.prod(middle, axis=1) > 0.0
    parts = [body.faces[other == odd].astype(np.intp) for odd in (False, True)]
    return [
        Skin(Surface(body.points, faces), shade)
        for faces, shade in zip(parts, SHADES, strict=True)
        if len(faces)
    ]


def shaded(color: Array, shade: Array) -> Array:
    """(3,) the shade of a part, of a body that is drawn in another colour (3,)."""
    return np.asarray(color * shade / SHADES[-1])


def posed(soft: Coordinates, x: Array) -> list[tuple[Surface, Array]]:
    """The parts where they are at x (n,), m in the world, and their colours."""
    points = soft.surface(x[None])[0]
    parts = soft_skins(soft.body)
    return [(Surface(points, part.surface.faces), np.asarray(part.color)) for part in parts]
