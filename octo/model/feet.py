"""What a foot is: by its place at a pose, or by the force on it. Each threshold is here, once."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from octo.model.kinematics import sphere_centers
from octo.model.quantities import Array
from octo.model.terrain import Ground, own_parameters, signed_distance
from octo.model.tree import Tree

# Places. A pose whose height nobody has chosen yet says only which contacts are lowest; where the
# ground is known, a foot is what touches it.
LEVEL = 0.02  # m over the lowest contact: what stands beside it on level ground
UNEVEN = 0.1  # of the span of the contacts' heights: the same in a pose that nobody levelled
TOUCHING = 0.01  # m over the ground: what touches it; no contact of Eq. 6 is exact to less

SMALL = 1e-6  # rad or m, of differences
DAMPING = 1e-4  # m² over rad² or m², of a step of feet towards places

# Forces, relative to mg. One contact is not told apart by one threshold: LOADED, the lower end of
# the hysteresis of a stance, is also where a force is large enough to divide by; CARRYING is what
# a mean, a controller or a machine's measurement is asked for, in which small forces are noise.
TOUCHDOWN = 0.05  # a stance begins
LOADED = 0.01  # a stance ends below it
CARRYING = 0.02  # the foot takes part in holding the robot


def bottoms(character: Tree, x: NDArray) -> Array:
    """(..., contacts) m, heights of the lowest points of all contact spheres at x (..., nx)."""
    radius = np.array([contact.radius for contact in character.contacts])
    return np.asarray(sphere_centers(character, x)[..., 2] - radius)


def terrain_bottoms(character: Tree, x: NDArray) -> Array:
    """(..., c) m, those of the robot's spheres that touch the terrain."""
    return bottoms(character, x)[..., list(character.own_contacts)]


def lowest_contacts(character: Tree, x: NDArray, within: float = LEVEL) -> list[int]:
    """The robot's contacts with the terrain at most ``within`` m over the lowest, at x (nx,)."""
    heights = terrain_bottoms(character, x)
    low = heights <= heights.min(initial=math.inf) + within
    return [k for k, is_low in zip(character.own_contacts, low, strict=True) if is_low]


def low_contacts(character: Tree, x: NDArray) -> list[int]:
    """The same where the pose (nx,) is a file's: its feet may differ in height by more."""
    return lowest_contacts(character, x, UNEVEN * float(np.ptp(terrain_bottoms(character, x))))


def gaps(character: Tree, terrain: Ground, values: Mapping[str, float], x: NDArray) -> Array:
    """(c,) m between the ground and the spheres that may touch it, negative inside, at x (nx,).

    values: the terrain's parameters.
    """
    chosen = list(character.terrain_contacts)
    radius = np.array([character.contacts[k].radius for k in chosen])
    return signed_distance(terrain, sphere_centers(character, x)[chosen], values) - radius


def touching(character: Tree, terrain: Ground, x: NDArray) -> list[int]:
    """The robot's contacts that touch the ground at x (nx,), with the terrain's own parameters."""
    gap = gaps(character, terrain, own_parameters(terrain), x)
    found = [k for k, g in zip(character.terrain_contacts, gap, strict=True) if g < TOUCHING]
    own = set(character.own_contacts)
    return [k for k in found if k in own]


def chosen_contacts(
    character: Tree, contacts: Iterable[str] | Literal["feet"] | None, feet: Iterable[int]
) -> set[int]:
    """Indices of ``contacts``, given by name, as "feet", or None for all of the robot's own that
    touch the terrain."""
    if contacts == "feet":
        return set(feet)
    if contacts is None:
        return set(character.own_contacts)
    known = {contact.name: k for k, contact in enumerate(character.contacts)}
    return {known[n] if n in known else character.contact_index(n) for n in contacts}


def feet_of(character: Tree, contacts: Iterable[int]) -> list[int]:
    """The bodies of contacts, in their order: heel and toe of one body are one foot."""
    return list(dict.fromkeys(character.contacts[k].body for k in contacts))


def stances(force: Array, weight: float) -> NDArray[np.bool_]:
    """(N, c) whether each contact stands, of its normal force (N, c) N.

    Between TOUCHDOWN and LOADED it does what it did before, so that a load that wavers is one
    stance; it does not stand before it has touched down.
    """
    sure = (force >= TOUCHDOWN * weight) | (force < LOADED * weight)
    rows = np.where(sure, np.arange(len(force))[:, None], 0)
    known = np.maximum.accumulate(rows, axis=0)  # the last row that says
    return np.take_along_axis(force, known, axis=0) >= TOUCHDOWN * weight


def runs(on: NDArray[np.bool_], begin: int, end: int) -> list[tuple[int, int]]:
    """First row and the row after the last of each run of True that begins and ends in a window.

    The rows of the window are begin … end−1; the motion's own first and last run never count.
    """
    flips = np.flatnonzero(on[1:] != on[:-1]) + 1
    pairs = zip(flips[:-1].tolist(), flips[1:].tolist(), strict=True)
    return [(a, b) for a, b in pairs if on[a] and begin <= a and b <= end]


def toward(character: Tree, x: Array, contacts: list[int], targets: Array) -> Array:
    """(nu,) rad or m: one damped least-squares step of the actuated joints at x (nx,) that takes
    the centres of contact spheres, by index, towards ``targets`` (contacts, 3) m."""
    joints = character.actuated
    moved = np.repeat(x[None], len(joints) + 1, axis=0)
    moved[np.arange(len(joints)), joints] += SMALL
    where = sphere_centers(character, moved)[:, contacts].reshape(len(moved), -1)
    slope = (where[:-1] - where[-1]).T / SMALL  # (3 contacts, nu) m/rad
    miss = slope.T @ (targets.ravel() - where[-1])
    return np.linalg.solve(slope.T @ slope + DAMPING * np.eye(len(joints)), miss)
