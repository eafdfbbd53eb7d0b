"""Collision geoms of a robot file -> as few contact spheres as will do, or all vertices; pairs."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from octo.model import shapes
from octo.model.body import ContactSphere
from octo.model.character import Character
from octo.model.kinematics import sphere_centers
from octo.model.quantities import Array
from octo.model.quaternions import rotation_of
from octo.model.robot_file import Carrier, RobotFile, import_mujoco, name_of

Contacts = Literal["few", "vertices"]
TOLERANCE = 0.05  # of the hull of a body, as a part of its size
MOST_SPHERES = 8  # of a body; a first moving body that needs more becomes a box
AT_END = 0.9  # a geom whose reach is this part of its limb's is at its end
SMALL = 0.35  # a mesh at the end whose size is at most this part of the limb's reach is a ball
COMPACT = 2.0  # if its longest side is at most this often its shortest
# a sphere that never leaves one of another body by more than this part of its radius is not needed
SHARED = 0.25
PAIR_CLEARANCE = 0.005  # m between the spheres of a pair in the default pose
PAIR_RADIUS = 0.005  # m; smaller spheres are corners, no use against each other
SPHERES_OF: dict[str, Callable[[Array], shapes.Spheres]] = {  # by the kind of a geom, of its size
    "sphere": lambda size: shapes.sphere(size[0]),
    "capsule": lambda size: shapes.capsule(size[0], size[1]),
    "ellipsoid": shapes.ellipsoid,
    "box": shapes.box,
    "cylinder": lambda size: shapes.cylinder(size[0], size[1]),
}


@dataclass(frozen=True, eq=False)
class Shape:
    """The spheres of one geom, in the frame of the body of the character that carries it."""

    name: str
    kind: str
    body: int
    centers: Array  # (k, 3) m
    radii: Array  # (k,) m
    rod: shapes.Spheres  # the same as a rod or a ball

    def with_spheres(self, spheres: shapes.Spheres) -> Shape:
        return replace(self, centers=spheres[0], radii=spheres[1])


def contact_spheres(
    character: Character,
    source: RobotFile,
    carriers: Mapping[int, Carrier],
    notes: list[str],
    kept: Contacts = "few",
) -> tuple[ContactSphere, ...]:
    """The spheres of every moving body: those at the ends of the limbs first, the lowest of these
    before the others.

    A geom at the end of a limb, and the geoms of the base, keep their form; every other geom
    becomes a rod or a ball. ``kept`` "vertices": every vertex instead.
    """
    ground = _ground(character, source, carriers, notes)
    moving = [b for b, path in enumerate(character.path) if path]
    by_body: dict[int, list[Shape]] = {b: [] for b in moving}
    for g in range(source.model.ngeom):
        carrier = carriers.get(int(source.model.geom_bodyid[g]))
        if carrier is None or not _collides(source.model, g, ground):
            continue
        if carrier.body in by_body:
            by_body[carrier.body] += _shape(source.model, g, carrier, notes, kept)
    ends = end_bodies(character)
    touches = bool(ground) or character.base == "floating"
    spheres: list[ContactSphere] = []
    for b, own in by_body.items():
        if kept == "vertices":
            spheres += _all_of(own, touches)
            continue
        shaped = _boxed(own) if b == moving[0] else _simplified(character, b, own, b in ends)
        spheres += _pruned(shaped, touches)
    if kept == "few":
        spheres = _without_shared(character, spheres)
    if spheres and not touches:
        notes.append("contact with the terrain: the base is fixed and the file has no ground")
    return tuple(_unique_names(_ordered(character, spheres, ends)))


def _boxed(own: list[Shape]) -> list[Shape]:
    """The shapes of the trunk, or one box around them where they are many."""
    if sum(len(shape.radii) for shape in own) <= MOST_SPHERES:
        return own
    return [own[0].with_spheres(shapes.bounding_box(*_all_spheres(own)))]


def _all_spheres(own: list[Shape]) -> shapes.Spheres:
    return np.concatenate([s.centers for s in own]), np.concatenate([s.radii for s in own])


def _simplified(character: Character, b: int, own: list[Shape], at_end: bool) -> list[Shape]:
    """The shapes of body ``b``: what cannot be a foot or a hand becomes rods and balls."""
    if not own:
        return own
    anchor = _anchor(character, b)
    reach = {id(shape): _reach(shape.centers, shape.radii, anchor) for shape in own}
    farthest = max(reach.values())
    result = []
    for shape in own:
        if at_end and reach[id(shape)] >= AT_END * farthest:
            if shape.kind == "mesh" and len(shape.radii) > 1 and _compact(shape.centers, farthest):
                outward = shape.centers.mean(axis=0) - anchor
                outward /= np.linalg.norm(outward)
                shape = shape.with_spheres(shapes.end_ball(shape.centers, outward))
        elif len(shape.radii) > 2:
            shape = shape.with_spheres(shape.rod)
        result.append(shape)
    return result


def _compact(vertices: Array, reach: float) -> bool:
    sides = np.ptp(vertices, axis=0)
    return bool(np.linalg.norm(sides) <= SMALL * reach and sides.max() <= COMPACT * sides.min())


def _ground(
    character: Character, source: RobotFile, carriers: Mapping[int, Carrier], notes: list[str]
) -> list[int]:
    """Geoms of the world that collide; they are noted, the terrain is the problem's own."""
    model = source.model
    parents = {body.parent for body in character.bodies}
    ground = []
    for g in range(model.ngeom):
        b = int(model.geom_bodyid[g])
        carrier = carriers.get(b)
        of_world = b == 0 or (carrier is None and model.body_weldid[b] == 0)
        alone = (
            carrier is not None and not character.path[carrier.body] and carrier.body not in parents
        )
        if (of_world or alone) and collidable(model, g):
            ground.append(g)
    if ground:
        kinds = sorted({geom_kind(model, g) for g in ground})
        notes.append(
            f"{len(ground)} geoms of the world ({', '.join(kinds)}): the terrain is the "
            "problem's, a plane unless said otherwise (--world FILE, octo.load_world)"
        )
    return ground


def collidable(model: Any, g: int) -> bool:
    """Whether geom ``g`` touches anything at all."""
    return bool(model.geom_contype[g] or model.geom_conaffinity[g] or _paired(model, g))


def _paired(model: Any, g: int) -> list[int]:
    """Geoms that an explicit contact pair of the file ties to geom ``g``."""
    first, second = model.pair_geom1, model.pair_geom2
    return [int(b if a == g else a) for a, b in zip(first, second, strict=True) if g in (a, b)]


def _collides(model: Any, g: int, ground: list[int]) -> bool:
    """Whether geom ``g`` touches the ground of the file, or without one could touch anything."""
    if not ground:
        return collidable(model, g)
    partners = set(_paired(model, g))
    types, affinities = model.geom_contype, model.geom_conaffinity
    return any(
        h in partners or types[g] & affinities[h] or types[h] & affinities[g] for h in ground
    )


def geom_kind(model: Any, g: int) -> str:
    """The word of an MJCF for what geom ``g`` is: "box", "plane"."""
    return str(import_mujoco().mjtGeom(model.geom_type[g]).name).removeprefix("mjGEOM_").lower()


def _shape(model: Any, g: int, carrier: Carrier, notes: list[str], kept: Contacts) -> list[Shape]:
    kind, size = geom_kind(model, g), np.array(model.geom_size[g], dtype=float)
    link = name_of(model, "body", int(model.geom_bodyid[g]))
    name = model.geom(g).name or link
    if kept == "vertices" and kind in ("mesh", "box"):
        corners = (
            shapes.corners(size) if kind == "box" else vertices_of(model, model.geom_dataid[g])
        )
        centers, radii = corners, np.zeros(len(corners))
    elif kind in SPHERES_OF:
        centers, radii = SPHERES_OF[kind](size)
    elif kind == "mesh":
        centers, radii = shapes.hull(_hull_vertices(model, int(model.geom_dataid[g])))
    else:
        notes.append(f"geom {name} of {link}: a {kind} cannot be a contact of a moving body")
        return []
    rod, rod_radii = (centers, radii) if kept == "vertices" else shapes.rod(centers, radii)
    R = carrier.rotation @ rotation_of(model.geom_quat[g])
    t = carrier.position + carrier.rotation @ model.geom_pos[g]
    return [Shape(name, kind, carrier.body, centers @ R.T + t, radii, (rod @ R.T + t, rod_radii))]


def vertices_of(model: Any, mesh: int) -> Array:
    """All vertices (k, 3) m of a mesh."""
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    return np.asarray(model.mesh_vert[first : first + count], dtype=float)


def _hull_vertices(model: Any, mesh: int) -> Array:
    """Vertices (k, 3) m of the convex hull that MuJoCo found, all vertices where it made none."""
    vertices = vertices_of(model, mesh)
    graph = model.mesh_graphadr[mesh]
    if graph < 0:
        return vertices
    # layout: number of vertices, of faces, edge addresses, vertex numbers, ...
    on_hull = model.mesh_graph[graph]
    return vertices[model.mesh_graph[graph + 2 + on_hull : graph + 2 + 2 * on_hull]]


def _pruned(own: list[Shape], touches: bool) -> list[ContactSphere]:
    """The spheres of one body that make up its hull."""
    if not own:
        return []
    centers, radii = _all_spheres(own)
    names = [shape.name for shape in own for _ in shape.radii]
    top, bottom = (centers + radii[:, None]).max(axis=0), (centers - radii[:, None]).min(axis=0)
    tolerance, body = TOLERANCE * float(np.linalg.norm(top - bottom)), own[0].body
    return [
        ContactSphere(names[k], body, centers[k], float(radii[k]), touches)
        for k in shapes.prune(centers, radii, tolerance, MOST_SPHERES)
    ]


def _all_of(own: list[Shape], touches: bool) -> list[ContactSphere]:
    """Every sphere of one body."""
    return [
        ContactSphere(shape.name, shape.body, center, float(radius), touches)
        for shape in own
        for center, radius in zip(shape.centers, shape.radii, strict=True)
    ]


def _without_shared(character: Character, spheres: list[ContactSphere]) -> list[ContactSphere]:
    """Drop a sphere that stays inside of another body's: two links that share a knee."""
    if not spheres:
        return []
    poses = np.random.default_rng(0).uniform(-1.5, 1.5, (4, character.nx))
    centers = _centers(character, spheres, poses)  # (4, k, 3) m
    radii = np.array([sphere.radius for sphere in spheres])
    # (k, k) m, over the poses
    away = np.linalg.norm(centers[:, :, None] - centers[:, None], axis=-1).max(axis=0)
    inside = away <= (1.0 + SHARED) * radii[None, :] - radii[:, None]
    dropped: set[int] = set()
    # Later bodies are further out: the outer link keeps the sphere of a joint that two links share.
    for k, other in zip(*np.nonzero(inside), strict=True):
        smaller = radii[k] < radii[other] or (radii[k] == radii[other] and k < other)
        if k != other and other not in dropped and smaller:
            dropped.add(int(k))
    return [sphere for k, sphere in enumerate(spheres) if k not in dropped]


def _centers(character: Character, spheres: list[ContactSphere], x: Array) -> Array:
    """Centres (..., k, 3) m of spheres that the character does not have yet, at x (..., nx)."""
    return sphere_centers(replace(character, contacts=tuple(_unique_names(spheres))), x)


def end_bodies(character: Character) -> list[int]:
    """Moving bodies that carry no other: feet, hands, heads."""
    parents = {body.parent for body in character.bodies}
    return [b for b, path in enumerate(character.path) if path and b not in parents]


def _anchor(character: Character, b: int) -> Array:
    """Where body ``b`` hangs on its parent (3,) m, in its own frame."""
    joints = character.bodies[b].joints
    return joints[-1].anchor if joints and joints[-1].kind == "hinge" else np.zeros(3)


def _reach(centers: Array, radii: Array, anchor: Array) -> float:
    """Distance (m) of the far side of spheres from the joint their body hangs on."""
    return float(np.max(np.linalg.norm(centers - anchor, axis=1) + radii))


def _sphere_reach(character: Character, sphere: ContactSphere) -> float:
    return _reach(sphere.position[None], np.array([sphere.radius]), _anchor(character, sphere.body))


def _ordered(
    character: Character, spheres: list[ContactSphere], ends: list[int]
) -> list[ContactSphere]:
    """The ends of limbs first, those that stand lowest in the default pose before the others."""
    height = _centers(character, spheres, character.start_pose)[:, 2]
    lowest = {
        b: min(h for h, s in zip(height, spheres, strict=True) if s.body == b)
        for b in {s.body for s in spheres}
    }

    def key(sphere: ContactSphere) -> tuple[bool, float, int, float]:
        end = sphere.body in ends
        # left and right differ by rounding only
        step = round(lowest[sphere.body] / 0.05) if end else 0
        return not end, step, sphere.body, -_sphere_reach(character, sphere) if end else 0.0

    return sorted(spheres, key=key)


def _unique_names(spheres: list[ContactSphere]) -> list[ContactSphere]:
    """Number the spheres that come from one geom or link."""
    count = Counter(sphere.name for sphere in spheres)
    seen: dict[str, int] = {}
    numbered = []
    for sphere in spheres:
        seen[sphere.name] = seen.get(sphere.name, 0) + 1
        name = sphere.name if count[sphere.name] == 1 else f"{sphere.name}_{seen[sphere.name]}"
        numbered.append(replace(sphere, name=name))
    return numbered


def self_collision_pairs(character: Character) -> tuple[tuple[int, int], ...]:
    """The ends of the limbs against each other, each against its two nearest; none touches in the
    default pose."""
    tips = {}
    for b in end_bodies(character):
        reach = {
            k: _sphere_reach(character, s)
            for k, s in enumerate(character.contacts)
            if s.body == b and s.radius >= PAIR_RADIUS
        }
        if reach:
            tips[b] = [k for k, value in reach.items() if value >= AT_END * max(reach.values())]
    centers = sphere_centers(character, character.start_pose)
    radii = np.array([sphere.radius for sphere in character.contacts])
    nearest: dict[tuple[int, int], tuple[float, int, int]] = {}  # limbs -> gap (m), spheres
    for first, second in itertools.combinations(tips, 2):
        gaps = [
            (round(float(np.linalg.norm(centers[a] - centers[b]) - radii[a] - radii[b]), 6), a, b)
            for a, b in itertools.product(tips[first], tips[second])
        ]
        nearest[first, second] = min(gaps)
    pairs: set[tuple[int, int]] = set()
    for limb in tips:
        for gap, a, b in sorted(value for limbs, value in nearest.items() if limb in limbs)[:2]:
            if gap > PAIR_CLEARANCE:
                pairs.add((a, b))
    return tuple(sorted(pairs))
