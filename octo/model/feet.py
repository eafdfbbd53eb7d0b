"""Which contacts are feet: the lowest of a pose; and from which load on a foot is loaded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.model.kinematics import sphere_centers
from octo.model.quantities import Array
from octo.model.tree import Tree

LOADED = 0.02  # relative to mg: a foot that carries more is loaded


def bottoms(character: Tree, x: NDArray) -> Array:
    """(..., contacts) m, heights of the lowest points of all contact spheres at x (..., nx)."""
    radius = np.array([contact.radius for contact in character.contacts])
    return np.asarray(sphere_centers(character, x)[..., 2] - radius)


def terrain_bottoms(character: Tree, x: NDArray) -> Array:
    """(..., c) m, those of the spheres that touch the terrain."""
    return bottoms(character, x)[..., list(character.terrain_contacts)]


def lowest_contacts(character: Tree, x: NDArray, within: float) -> list[int]:
    """Contacts that touch the terrain and are at most ``within`` m over the lowest of them, at x
    (nx,)."""
    heights = terrain_bottoms(character, x)
    low = heights <= heights.min() + within
    return [k for k, is_low in zip(character.terrain_contacts, low, strict=True) if is_low]
