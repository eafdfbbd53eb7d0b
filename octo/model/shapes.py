"""Collision shapes -> spheres whose common hull is the shape or lies just inside it.

Every function returns centres (k, 3) m in the shape's own frame and radii (k,) m. A flat-sided
shape is a set of small spheres set into its corners, so that its faces stay where they are and a
corner is a smooth contact.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from octo.model.quantities import Array

Spheres = tuple[Array, Array]
SKIN = 0.2  # radius of a corner sphere, as a part of the shape's smallest half size
# a side this much thinner than the next one is rounded completely: its corners merge in pairs
FLAT = 1.0 / 3.0
CIRCLE_POINTS = 8
# a mesh whose hull is this close to a ball, as a part of its radius, is one sphere
BALL_TOLERANCE = 0.1


def sphere(radius: float) -> Spheres:
    return np.zeros((1, 3)), np.array([radius])


def capsule(radius: float, half_length: float) -> Spheres:
    """The two end spheres of a capsule along z."""
    return np.array([[0.0, 0.0, half_length], [0.0, 0.0, -half_length]]), np.full(2, radius)


def ellipsoid(half: Array) -> Spheres:
    """Two spheres on every axis that touch the surface at its ends and stay inside."""
    centers, radii = [], []
    for axis in range(3):
        # The smallest radius of curvature at the end of the axis bounds a sphere that touches there
        # from inside.
        radius = min(min(half) ** 2 / half[axis], min(half))
        centers += [sign * (half[axis] - radius) * np.eye(3)[axis] for sign in (1.0, -1.0)]
        radii += [radius, radius]
    return np.array(centers), np.array(radii)


def box(half: Array) -> Spheres:
    """Eight spheres in the corners; in a plate they are as thick as the plate, so that only four
    differ."""
    small, middle, _ = np.sort(half)
    radius = small if small <= FLAT * middle else SKIN * small
    return corners(half - radius), np.full(8, radius)


def corners(half: Array) -> Array:
    """(8, 3) m, of a box."""
    return np.array(list(itertools.product((1.0, -1.0), repeat=3))) * half


def cylinder(radius: float, half_length: float) -> Spheres:
    """Eight spheres in each rim of a cylinder along z; a rod is a capsule, a disc has one rim."""
    if radius <= FLAT * half_length:
        return capsule(radius, half_length - radius)
    skin = half_length if half_length <= FLAT * radius else SKIN * min(radius, half_length)
    angles = 2.0 * math.pi * np.arange(CIRCLE_POINTS) / CIRCLE_POINTS
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1) * (radius - skin)
    z = half_length - skin
    centers = [np.column_stack([rim, np.full(CIRCLE_POINTS, end)]) for end in (z, -z)]
    return np.concatenate(centers), np.full(2 * CIRCLE_POINTS, skin)


def hull(vertices: Array) -> Spheres:
    """The vertices (k, 3) of a convex hull as points, or one sphere where they lie on a ball."""
    if len(vertices) >= 12:
        # |v|² = 2 v·c + (r² - |c|²): the ball through the vertices in the least-squares sense.
        matrix = np.column_stack([2.0 * vertices, np.ones(len(vertices))])
        solution = np.linalg.lstsq(matrix, (vertices**2).sum(axis=1), rcond=None)[0]
        center = solution[:3]
        distance = np.linalg.norm(vertices - center, axis=1)
        radius = float(distance.mean())
        # A shallow cap fits a large ball as well: the vertices must surround the centre.
        below = np.all(vertices.min(axis=0) < center - 0.7 * radius)
        around = below and np.all(vertices.max(axis=0) > center + 0.7 * radius)
        if around and np.abs(distance - radius).max() <= BALL_TOLERANCE * radius:
            return center[None], np.array([radius])
    return vertices, np.zeros(len(vertices))


def rod(centers: Array, radii: Array) -> Spheres:
    """Two spheres along the longest side of the box around a set of spheres, or one where it is
    about as thick as long.

    The frame must be the shape's own: MuJoCo turns a mesh to its principal axes.
    """
    top, bottom = (centers + radii[:, None]).max(axis=0), (centers - radii[:, None]).min(axis=0)
    half, middle = (top - bottom) / 2.0, (top + bottom) / 2.0
    longest = int(np.argmax(half))
    radius = float(np.delete(half, longest).mean())
    reach = float(half[longest]) - radius
    if reach <= 0.25 * radius:
        return middle[None], np.array([float(half.mean())])
    arm = reach * np.eye(3)[longest]
    return np.array([middle + arm, middle - arm]), np.full(2, radius)


def bounding_box(centers: Array, radii: Array) -> Spheres:
    """The corners of the box around a set of spheres, along the axes."""
    top, bottom = (centers + radii[:, None]).max(axis=0), (centers - radii[:, None]).min(axis=0)
    corners, skins = box((top - bottom) / 2.0)
    return corners + (top + bottom) / 2.0, skins


def end_ball(vertices: Array, outward: Array) -> Spheres:
    """One sphere in the end of a compact hull: as thick as the hull, reaching as far in the
    direction ``outward``."""
    top, bottom = vertices.max(axis=0), vertices.min(axis=0)
    radius = float(np.median(top - bottom)) / 2.0
    center = (top + bottom) / 2.0
    center = center + outward * (float((vertices @ outward).max()) - radius - center @ outward)
    return center[None], np.array([radius])


def prune(centers: Array, radii: Array, tolerance: float, most: int) -> list[int]:
    """The spheres that matter: a greedy choice whose hull is the hull of all but for ``tolerance``
    (m).

    The height of a set of spheres in the direction d is max(d·c + r). Starting from the extremes
    along the axes, the sphere that closes the largest gap in height over all directions is added,
    until the gap is below ``tolerance`` or ``most`` spheres are chosen. Inner, doubled and nearly
    doubled spheres are never chosen.
    """
    # (k, directions) m; rounded: mirror images tie
    heights = np.round(centers @ _DIRECTIONS.T + radii[:, None], 7)
    chosen: list[int] = []
    reached = np.full(heights.shape[1], -math.inf)
    goal = heights.max(axis=0)
    while len(chosen) < most:
        gap = goal - reached
        direction = len(chosen) if not chosen else int(np.argmax(gap))
        if chosen and gap[direction] <= tolerance:
            break
        new = int(np.argmax(heights[:, direction]))
        chosen.append(new)
        reached = np.maximum(reached, heights[new])
    return sorted(chosen)


def _sphere_directions(count: int) -> Array:
    """Unit vectors (6 + 8 count, 3): down, up and the other axes, then ``count`` in every octant,
    mirror images of each other so that a symmetric shape stays symmetric."""
    k = np.arange(8 * count) + 0.5
    # Fibonacci's spiral
    height, turn = 1.0 - 2.0 * k / (8 * count), math.pi * (1.0 + math.sqrt(5.0)) * k
    around = np.sqrt(1.0 - height**2)
    spiral = np.column_stack([np.cos(turn) * around, np.sin(turn) * around, height])
    octant = spiral[(spiral > 0.0).all(axis=1)]
    mirrored = [octant * signs for signs in itertools.product((1.0, -1.0), repeat=3)]
    x, y, z = np.eye(3)
    return np.concatenate([[-z, z, x, -x, y, -y], *mirrored])


_DIRECTIONS = _sphere_directions(50)
