"""What a character looks like: one closed surface per body, guessed from its contact spheres, its
inertia and its joints.

It is what is drawn of a robot whose file draws nothing. A body with two or more spheres is their
convex hull; another one is the capsule or the rounded box of its mass and inertia (for a capsule of
the gallery that is the capsule itself); rods join them to their joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial import ConvexHull

from octo.model.body import Body, ContactSphere
from octo.model.character import Character
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.quantities import Array

Faces = NDArray[np.intp]
SLENDER = 0.93  # two largest principal moments nearer than this: a capsule, else a box
ROD = 0.7  # radius of a rod, relative to the thinner of the two things that it joins
THICK = 0.06  # radius from which on a solid is drawn finer, relative to the character's size
MANY = 16  # contacts of a body from which on they are its surface: the vertices of a mesh
FINE, SKIN = 2, 1e-2  # of that surface: directions, and of a flat one the rounding, of its size
THINNEST = 0.02  # radius of what has no size, relative to the character's size
ARROW = 0.8  # length of the arrow of a force that is the weight, relative to the character's size


@dataclass(frozen=True)
class Surface:
    """Triangles in the frame of a body, outward side counter-clockwise."""

    vertices: Array  # (v, 3) m
    faces: Faces  # (f, 3) indices into vertices


@dataclass(frozen=True)
class Solid:
    """The convex hull of balls: a ball, a capsule, a rounded box."""

    centers: Array  # (k, 3) m, body frame
    radii: Array  # (k,) m

    @property
    def radius(self) -> float:
        return float(self.radii.min())

    def nearest(self, point: Array) -> Array:
        """The point (3,) of the polygon of centres that is about nearest to ``point``: over its
        edges."""
        best, least = self.centers[0], np.inf
        for a in self.centers:
            for b in self.centers:
                along = b - a
                share = np.clip((point - a) @ along / max(along @ along, 1e-12), 0.0, 1.0)
                candidate = a + share * along
                distance = float(np.linalg.norm(candidate - point))
                if distance < least:
                    best, least = candidate, distance
        return best


def surfaces(character: Character, fineness: int = 2) -> list[Surface | None]:
    """One surface per body, None where there is nothing to draw. A ball has 10·4^fineness + 2
    vertices, a thick one more."""
    scale = size(character)
    thin = THINNEST * scale
    cores = [_core(character, b, scale) for b in range(len(character.bodies))]
    out: list[Surface | None] = []
    for b, core in enumerate(cores):
        solids = [*([core] if core else []), *_rods(character, b, cores, thin)]
        hulls = [hull(solid, fineness + (solid.radius > THICK * scale)) for solid in solids]
        out.append(_joined(hulls) if hulls else None)
    return out


def size(character: Character) -> float:
    """m, the largest extent of joints and spheres in the default pose."""
    pose = character.start_pose
    moving = [b for b, body in enumerate(character.bodies) if character.path[b] or body.parent < 0]
    places = body_poses(character, pose)[1][moving]
    points = np.concatenate([places, sphere_centers(character, pose)])
    radius = max((contact.radius for contact in character.contacts), default=0.0)
    return float(max(np.ptp(points, axis=0).max() + 2 * radius, 0.05))


def tile(scale: float) -> float:
    """m, edge of a square of the ground under a character of size ``scale`` m: a round number."""
    rounds = (0.05, 0.1, 0.2, 0.25, 0.5, 1.0, 2.0)
    return min(rounds, key=lambda edge: abs(np.log(edge / (0.4 * scale))))


def ball(center: Sequence[float] | Array, radius: float, fineness: int = 2) -> Surface:
    return hull(Solid(np.asarray(center, dtype=float)[None], np.array([radius])), fineness)


def hull(solid: Solid, fineness: int = 2) -> Surface:
    """The surface of a solid."""
    sphere = unit_sphere(fineness) if solid.radii.any() else np.zeros((1, 3))  # corners
    return hull_of((solid.centers[:, None] + solid.radii[:, None, None] * sphere).reshape(-1, 3))


def hull_of(points: Array) -> Surface:
    """The surface of the convex hull of points (k, 3) m."""
    found = ConvexHull(points)
    corners = points[found.simplices]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.sum(normal * found.equations[:, :3], axis=1) < 0.0
    faces = np.where(inward[:, None], found.simplices[:, ::-1], found.simplices)
    used, renumbered = np.unique(faces, return_inverse=True)
    return Surface(points[used], renumbered.reshape(faces.shape))


@lru_cache
def unit_sphere(fineness: int) -> Array:
    """Vertices (v, 3) of an icosahedron whose triangles are quartered ``fineness`` times, on the
    unit sphere."""
    golden = (1.0 + 5.0**0.5) / 2.0
    corner = [(0.0, s, t * golden) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    points = np.array([np.roll(c, k) for c in corner for k in range(3)])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    for _ in range(fineness):
        faces = ConvexHull(points).simplices
        sides = np.concatenate([faces[:, pair] for pair in ([0, 1], [1, 2], [0, 2])])
        edges = np.unique(np.sort(sides, axis=1), axis=0)
        middle = points[edges].sum(axis=1)
        points = np.concatenate([points, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
    return cast(Array, points)


def _core(character: Character, b: int, scale: float) -> Solid | None:
    """The body without its rods; ``scale`` is the size of the character."""
    own = [s for s in character.contacts if s.body == b]
    if len(own) > MANY:
        return _outermost(own)
    spheres = [s for s in own if s.radius > 0.0]
    if len(spheres) >= 2:
        return Solid(np.array([s.position for s in spheres]), np.array([s.radius for s in spheres]))
    core = _of_inertia(character.bodies[b], _reach(character, b, scale))
    if core is None and spheres:
        return Solid(spheres[0].position[None], np.array([spheres[0].radius]))
    return core


def _outermost(own: list[ContactSphere]) -> Solid:
    """The hull of many points, by those that are farthest in some direction."""
    points = np.array([sphere.position for sphere in own])
    farthest = np.unique(np.argmax(points @ unit_sphere(FINE).T, axis=0))
    radii = np.array([own[k].radius for k in farthest])
    points = points[farthest]
    flat = np.linalg.matrix_rank(points - points[0], tol=1e-6 * float(np.ptp(points))) < 3
    return Solid(points, np.maximum(radii, SKIN * float(np.ptp(points)) if flat else 0.0))


def _reach(character: Character, b: int, scale: float) -> float:
    """m, how far a body may stretch from its centre of mass, whatever inertia its file gives it."""
    body = character.bodies[b]
    if body.parent < 0:
        return np.inf
    places = [np.zeros(3), *(child.position for child in character.bodies if child.parent == b)]
    places += [contact.position for contact in character.contacts if contact.body == b]
    return 1.25 * max(*(float(np.linalg.norm(place - body.com)) for place in places), 0.1 * scale)


def _of_inertia(body: Body, reach: float) -> Solid | None:
    """The capsule or rounded box of the body's mass and inertia, at most ``reach`` m long."""
    if body.mass <= 0.0:
        return None
    # m², ascending: the first axis is the longest
    moments, axes = np.linalg.eigh(body.inertia / body.mass)
    if not moments[0] > 1e-9:
        return None
    if moments[1] >= SLENDER * moments[2]:
        radius, length = _capsule_of(float(moments[0]), float(moments[1:].mean()))
        ends = body.com + np.outer([-0.5, 0.5], min(length, 2.0 * reach) * axes[:, 0])
        return Solid(ends, np.full(2, min(radius, reach)))
    squares = 1.5 * (moments.sum() - 2.0 * moments)
    # m, half edges along the axes
    half = np.minimum(np.sqrt(np.maximum(squares, 1e-3 * squares.max())), reach)
    radius = 0.5 * float(half.min())
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)
    return Solid(body.com + (signs * (half - radius)) @ axes.T, np.full(8, radius))


def _capsule_of(along: float, across: float) -> tuple[float, float]:
    """Radius and length (m) of the solid capsule with these moments per mass (m²)."""

    def moments(ratio: float) -> tuple[float, float]:
        cylinder, balls = ratio, 4.0 / 3.0  # volumes over π radius³
        total = cylinder + balls
        of_cylinder, of_balls = 0.25 + ratio**2 / 12, 0.4 + ratio**2 / 4 + 0.375 * ratio
        about_other = (cylinder * of_cylinder + balls * of_balls) / total
        return (cylinder / 2 + balls * 0.4) / total, about_other

    def excess(ratio: float) -> float:
        own, other = moments(ratio)
        return other / own - across / along

    if excess(0.0) >= 0.0:
        ratio = 0.0
    else:
        ratio = float(brentq(excess, 0.0, 1e3)) if excess(1e3) > 0.0 else 1e3
    radius = float(np.sqrt(along / moments(ratio)[0]))
    return radius, ratio * radius


def _rods(character: Character, b: int, cores: list[Solid | None], thin: float) -> list[Solid]:
    """From the body's joints and its lone sphere to its core, where they do not touch it."""
    body, core = character.bodies[b], cores[b]
    ends: list[tuple[Array, float]] = []
    if body.joints and body.parent >= 0:
        ends.append((_hinge(body), _radius(cores[body.parent], thin)))
    for c, child in enumerate(character.bodies):
        if child.parent == b:
            place = child.position + child.rotation @ _hinge(child)
            ends.append((place, _radius(cores[c], thin)))
    own_spheres = [sphere for sphere in character.contacts if sphere.body == b]
    if len(own_spheres) <= MANY:
        ends += [(sphere.position, max(sphere.radius, thin)) for sphere in own_spheres]
    rods = []
    for place, other in ends:
        nearest = core.nearest(place) if core is not None else np.zeros(3)
        own = _radius(core, thin)
        if np.linalg.norm(place - nearest) > (0.5 * own if core is not None else 1e-6):
            rods.append(Solid(np.stack([nearest, place]), np.full(2, ROD * min(own, other))))
    return rods


def _hinge(body: Body) -> Array:
    """(3,) m, a point of the axis of its first hinge; the body's origin where it has none."""
    anchors = (joint.anchor for joint in body.joints if joint.kind == "hinge")
    return next(anchors, np.zeros(3))


def _radius(core: Solid | None, thin: float) -> float:
    return thin if core is None or core.radius == 0.0 else core.radius


def _joined(parts: list[Surface]) -> Surface:
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=True)]
    return Surface(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))
