"""Collision geoms of a compiled robot file -> contact spheres and self-collision pairs, as few as will do."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from octo.model import shapes
from octo.model.character import Array, Character, ContactSphere
from octo.model.kinematics import sphere_centers
from octo.model.robot_file import Carrier, RobotFile, import_mujoco, name_of, rotation_of

END_TOLERANCE, END_SPHERES = 0.05, 12  # of the bodies at the ends of limbs: of the body's size, at most
INNER_TOLERANCE, INNER_SPHERES = 0.12, 8  # of all others
SAME_PLACE = 0.004  # m; spheres of two bodies that stay this close in every pose are one
PAIR_CLEARANCE = 0.005  # m between the spheres of a pair in the default pose
PAIR_RADIUS = 0.005  # m; smaller spheres are corners, no use against each other


@dataclass(frozen=True, eq=False)
class Candidate:
    """A sphere of one geom, in the frame of the body of the character that carries it."""

    name: str
    body: int
    position: Array  # (3,) m
    radius: float  # m


def contact_spheres(
    character: Character, source: RobotFile, carriers: Mapping[int, Carrier], notes: list[str]
) -> tuple[ContactSphere, ...]:
    """The spheres of every moving body: its geoms' spheres, pruned; those at the ends of the limbs first, lowest first."""
    ground = _ground(character, source, carriers, notes)
    moving = [b for b, path in enumerate(character.path) if path]
    by_body: dict[int, list[Candidate]] = {b: [] for b in moving}
    for g in range(source.model.ngeom):
        carrier = carriers.get(int(source.model.geom_bodyid[g]))
        if carrier is None or not _collides(source.model, g, ground, character.base == "floating"):
            continue
        if carrier.body in by_body:
            by_body[carrier.body] += _candidates(source.model, g, carrier, notes)
    ends = end_bodies(character)
    kept = []
    for b in moving:
        if by_body[b]:
            limits = (END_TOLERANCE, END_SPHERES) if b in ends else (INNER_TOLERANCE, INNER_SPHERES)
            kept += _pruned(by_body[b], *limits)
    kept = _without_shared(character, kept)
    touches = bool(ground) or character.base == "floating"
    if kept and not touches:
        notes.append("contact with the terrain: the base is fixed and the file has no ground")
    spheres = [ContactSphere(c.name, c.body, c.position, c.radius, touches) for c in kept]
    return tuple(_unique_names(_ordered(character, spheres, ends)))


def _ground(character: Character, source: RobotFile, carriers: Mapping[int, Carrier], notes: list[str]) -> list[int]:
    """Geoms of the world that collide; they are noted, the terrain is the problem's own."""
    model, mujoco = source.model, import_mujoco()
    parents = {body.parent for body in character.bodies}
    ground = []
    for g in range(model.ngeom):
        b = int(model.geom_bodyid[g])
        carrier = carriers.get(b)
        of_world = b == 0 or (carrier is None and model.body_weldid[b] == 0)
        alone = carrier is not None and not character.path[carrier.body] and carrier.body not in parents
        if (of_world or alone) and _collidable(model, g):
            ground.append(g)
    if ground:
        kinds = sorted({_kind(mujoco, model, g) for g in ground})
        notes.append(
            f"{len(ground)} geoms of the world ({', '.join(kinds)}): the terrain is the problem's, a plane unless said otherwise"
        )
    return ground


def _collidable(model: Any, g: int) -> bool:
    return bool(model.geom_contype[g] or model.geom_conaffinity[g] or _paired(model, g))


def _paired(model: Any, g: int) -> list[int]:
    """Geoms that an explicit contact pair of the file ties to geom ``g``."""
    first, second = model.pair_geom1, model.pair_geom2
    return [int(b if a == g else a) for a, b in zip(first, second, strict=True) if g in (a, b)]


def _collides(model: Any, g: int, ground: list[int], floating: bool) -> bool:
    """Whether geom ``g`` touches the ground of the file; in a file without one, whether it could touch anything."""
    if not ground:
        return _collidable(model, g)
    partners = set(_paired(model, g))
    types, affinities = model.geom_contype, model.geom_conaffinity
    return any(h in partners or types[g] & affinities[h] or types[h] & affinities[g] for h in ground)


def _kind(mujoco: Any, model: Any, g: int) -> str:
    return str(mujoco.mjtGeom(model.geom_type[g]).name).removeprefix("mjGEOM_").lower()


def _candidates(model: Any, g: int, carrier: Carrier, notes: list[str]) -> list[Candidate]:
    mujoco = import_mujoco()
    kind, size = _kind(mujoco, model, g), np.array(model.geom_size[g], dtype=float)
    link = name_of(model, "body", int(model.geom_bodyid[g]))
    name = model.geom(g).name or link
    if kind == "sphere":
        centers, radii = shapes.sphere(size[0])
    elif kind == "capsule":
        centers, radii = shapes.capsule(size[0], size[1])
    elif kind == "ellipsoid":
        centers, radii = shapes.ellipsoid(size)
    elif kind == "box":
        centers, radii = shapes.box(size)
    elif kind == "cylinder":
        centers, radii = shapes.cylinder(size[0], size[1])
    elif kind == "mesh":
        centers, radii = shapes.hull(_hull_vertices(model, int(model.geom_dataid[g])))
    else:
        notes.append(f"geom {name} of {link}: a {kind} cannot be a contact of a moving body")
        return []
    centers = centers @ rotation_of(model.geom_quat[g]).T + model.geom_pos[g]
    centers = centers @ carrier.rotation.T + carrier.position
    return [Candidate(name, carrier.body, c, float(r)) for c, r in zip(centers, radii, strict=True)]


def _hull_vertices(model: Any, mesh: int) -> Array:
    """Vertices (k, 3) m of the convex hull that MuJoCo found, all vertices where it made none."""
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[first : first + count].astype(float)
    graph = model.mesh_graphadr[mesh]
    if graph < 0:
        return vertices
    on_hull = model.mesh_graph[graph]  # layout: number of vertices, of faces, edge addresses, vertex numbers, ...
    return vertices[model.mesh_graph[graph + 2 + on_hull : graph + 2 + 2 * on_hull]]


def _pruned(candidates: list[Candidate], tolerance: float, most: int) -> list[Candidate]:
    centers, radii = np.array([c.position for c in candidates]), np.array([c.radius for c in candidates])
    size = float(np.linalg.norm((centers + radii[:, None]).max(axis=0) - (centers - radii[:, None]).min(axis=0)))
    return [candidates[k] for k in shapes.prune(centers, radii, tolerance * size, most)]


def _without_shared(character: Character, candidates: list[Candidate]) -> list[Candidate]:
    """Drop a sphere that stays inside, or in the place of, one of another body: two links that share a knee."""
    if not candidates:
        return []
    spheres = tuple(ContactSphere(c.name, c.body, c.position, c.radius) for c in candidates)
    bare = Character(character.name, character.bodies, spheres, base=character.base, chart=character.chart)
    poses = np.random.default_rng(0).uniform(-1.5, 1.5, (4, character.nx))
    centers = sphere_centers(bare, poses)  # (4, k, 3) m
    radii = np.array([c.radius for c in candidates])
    away = np.linalg.norm(centers[:, :, None] - centers[:, None], axis=-1).max(axis=0)  # (k, k) m, over the poses
    dropped: set[int] = set()
    # Later bodies are further out: the outer link keeps the sphere of a joint that two links share.
    for k, other in itertools.permutations(range(len(candidates)), 2):
        smaller = radii[k] < radii[other] or (radii[k] == radii[other] and k < other)
        if other not in dropped and smaller and away[k, other] <= radii[other] - radii[k] + SAME_PLACE:
            dropped.add(k)
    return [c for k, c in enumerate(candidates) if k not in dropped]


def end_bodies(character: Character) -> list[int]:
    """Moving bodies that carry no other: feet, hands, heads."""
    parents = {body.parent for body in character.bodies}
    return [b for b, path in enumerate(character.path) if path and b not in parents]


def _reach(character: Character, sphere: ContactSphere) -> float:
    """Distance (m) of a sphere's far side from the joint its body hangs on."""
    joints = character.bodies[sphere.body].joints
    anchor = joints[-1].anchor if joints else np.zeros(3)
    return float(np.linalg.norm(sphere.position - anchor)) + sphere.radius


def _ordered(character: Character, spheres: list[ContactSphere], ends: list[int]) -> list[ContactSphere]:
    """The ends of limbs first, those that stand lowest in the default pose before the others."""
    posed = Character(character.name, character.bodies, tuple(spheres), base=character.base, chart=character.chart)
    height = sphere_centers(posed, character.default_pose)[:, 2] if spheres else np.zeros(0)
    lowest = {b: min(h for h, s in zip(height, spheres, strict=True) if s.body == b) for b in {s.body for s in spheres}}

    def key(sphere: ContactSphere) -> tuple[bool, float, int, float]:
        end = sphere.body in ends
        step = round(lowest[sphere.body] / 0.05) if end else 0  # left and right differ by rounding only
        return not end, step, sphere.body, -_reach(character, sphere) if end else 0.0

    return sorted(spheres, key=key)


def _unique_names(spheres: list[ContactSphere]) -> list[ContactSphere]:
    """Number the spheres that come from one geom or link."""
    names = [sphere.name for sphere in spheres]
    seen: dict[str, int] = {}
    numbered = []
    for sphere in spheres:
        seen[sphere.name] = seen.get(sphere.name, 0) + 1
        name = sphere.name if names.count(sphere.name) == 1 else f"{sphere.name}_{seen[sphere.name]}"
        numbered.append(ContactSphere(name, sphere.body, sphere.position, sphere.radius, sphere.touches_terrain))
    return numbered


def self_collision_pairs(character: Character) -> tuple[tuple[int, int], ...]:
    """The outermost spheres of the limbs against each other, each against its two nearest, none touching at the start."""
    outermost = []
    for b in end_bodies(character):
        own = [k for k, s in enumerate(character.contacts) if s.body == b and s.radius >= PAIR_RADIUS]
        if own:
            outermost.append(max(own, key=lambda k: _reach(character, character.contacts[k])))
    if len(outermost) < 2:
        return ()
    centers = sphere_centers(character, character.default_pose)
    gap = {}
    for a, b in itertools.combinations(outermost, 2):
        first, second = character.contacts[a], character.contacts[b]
        gap[a, b] = float(np.linalg.norm(centers[a] - centers[b])) - first.radius - second.radius
    pairs = set()
    for k in outermost:
        near = sorted((pair for pair in gap if k in pair), key=lambda pair: round(gap[pair], 6))[:2]
        pairs.update(pair for pair in near if gap[pair] > PAIR_CLEARANCE)
    return tuple(sorted(pairs))
