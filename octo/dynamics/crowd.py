"""Bodies with many contacts, as the vertices of a mesh: crowds, of which the dynamics evaluate only
the contacts that are near the ground.

The contacts of one body with the terrain, where there are more than FEW, are a crowd: one entry
beside the single contacts, whose wrench and blocks are the sums over its active members. Those are
found by a tree of spheres around its points in the body's frame (crowd.c). φ is at least φ(c) −
steepness · r in the sphere of radius r around c, so what is below a sphere is skipped where that is
out of reach. The steepness, an upper bound of |∇φ|, is 1 of a plane, whose φ is a distance; a world
knows its own (``World.data``); of an expression it is ``Terrain.steepest``: nothing is missed where
φ changes by no more than that in 1 m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from octo.checks import Array
from octo.dynamics.parameters import Layout
from octo.model.terrain import ADDRESS, Ground, World
from octo.model.tree import Tree
from octo.world.jet import SIZES

FEW = 16  # contacts of one body that are evaluated one by one
LEAF = 4  # points below a sphere that is not divided, at most
WIDER = 1.0 + 1e-9  # of a sphere around points: rounding


def crowds_of(character: Tree) -> list[list[int]]:
    """The contacts of each crowd, as indices into the character's."""
    by_body: dict[int, list[int]] = {}
    for k in character.terrain_contacts:
        by_body.setdefault(character.contacts[k].body, []).append(k)
    return [own for b, own in by_body.items() if len(own) > FEW and character.path[b]]


def members_of(character: Tree) -> list[int]:
    """The contacts that belong to a crowd, one crowd after the other."""
    return [k for own in crowds_of(character) for k in own]


def singles_of(character: Tree) -> list[int]:
    """The contacts with the terrain that belong to none, in their order."""
    members = set(members_of(character))
    return [k for k in character.terrain_contacts if k not in members]


def crowd_columns(character: Tree | None) -> list[list[int]]:
    """Where the contacts of each crowd stand among those with the terrain."""
    if character is None:
        return []
    place = {k: c for c, k in enumerate(character.terrain_contacts)}
    return [[place[k] for k in own] for own in crowds_of(character)]


@dataclass(frozen=True, eq=False)
class Entries:
    """A tree of spheres in the order of a walk that goes down first; its leaves are the points.

    centers (k, 3) m: of spheres around points, and the points themselves. around (k,) m: the radius
    of a sphere, 0 of a point. radii (k,) m: of the contact sphere at a point, the largest one below
    a sphere. skip (k,): the entry after all that are below. member (k,): which point it is, -1 of
    a sphere around several.
    """

    centers: Array
    around: Array
    radii: Array
    skip: NDArray[np.intp]
    member: NDArray[np.intp]


def tree_of(points: Array, radii: Array) -> Entries:
    """The tree over ``points`` (n, 3) m, which have spheres of ``radii`` (n,) m.

    Points are divided at the median of their longest side, so the tree is balanced.
    """
    entries: list[tuple[Array, float, float, int]] = []
    skip: list[int] = []
    # points of a sphere to do, or the place of one whose points are all there
    stack: list[NDArray[np.intp] | int] = [np.arange(len(points))]
    while stack:
        own = stack.pop()
        if isinstance(own, int):
            skip[own] = len(entries)
            continue
        at, largest = points[own], float(radii[own].max())
        center, radius = _around(at)
        stack.append(len(entries))
        entries.append((center, radius, largest, -1))
        skip.append(0)
        if len(own) <= LEAF:
            for k in own:
                entries.append((points[k], 0.0, float(radii[k]), int(k)))
                skip.append(len(entries))
            continue
        order = own[np.argsort(at[:, np.argmax(np.ptp(at, axis=0))], kind="stable")]
        stack += [order[len(order) // 2 :], order[: len(order) // 2]]
    centers, around, spheres, member = zip(*entries, strict=True)
    return Entries(
        np.array(centers), np.array(around), np.array(spheres), np.array(skip), np.array(member)
    )


def _around(points: Array) -> tuple[Array, float]:
    """A sphere around points (n, 3): its centre and its radius, m."""
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return center, WIDER * float(np.linalg.norm(points - center, axis=1).max())


@dataclass(frozen=True, eq=False)
class Crowds:
    """What the C text knows of crowds, and of a world also of the single contacts: ``sizes`` are
    macros, the others arrays.

    bodies: of each crowd.
    """

    bodies: list[int]
    sizes: dict[str, int]
    integers: dict[str, list[int]]
    numbers: dict[str, ArrayLike]


def tables_of(character: Tree, layout: Layout, terrain: Ground) -> Crowds:
    """The entries of all crowds, one tree after the other (crowd.c), and what a world is asked at
    each node, behind the poses and twists (octo_look in tree.c)."""
    crowds = crowds_of(character)
    made = Crowds([character.contacts[own[0]].body for own in crowds], {}, {}, {})
    if isinstance(terrain, World):
        singles = [character.contacts[k] for k in singles_of(character)]
        made.sizes.update(NG=len(singles), JET=SIZES[-1], WORLD=layout.index(ADDRESS))
        made.integers["ground_body"] = [sphere.body for sphere in singles]
        made.numbers["ground_sphere"] = [[*sphere.position, sphere.radius] for sphere in singles]
        moved = [g for g, sphere in enumerate(singles) if character.path[sphere.body]]
        made.integers["contact_ground"] = moved
    if crowds:
        _add(character, crowds, made)
        steepest = (
            1.0 if isinstance(terrain, World) else terrain.steepest
        )  # a world's is in its data
        made.numbers["crowd_steepest"] = [steepest]
    return made


def _add(character: Tree, crowds: list[list[int]], made: Crowds) -> None:
    """Their entries."""
    spheres, around = [], []
    skip: list[int] = []
    member: list[int] = []
    start, first = [0], [0]
    for own in crowds:
        points = np.array([character.contacts[k].position for k in own])
        tree = tree_of(points, np.array([character.contacts[k].radius for k in own]))
        spheres.append(np.column_stack([tree.centers, tree.radii]))
        around.append(tree.around)
        skip += (tree.skip + start[-1]).tolist()
        member += np.where(tree.member < 0, -1, tree.member + first[-1]).tolist()
        start.append(len(skip))
        first.append(first[-1] + len(own))
    made.sizes.update(NCROWD=len(crowds), NMEMBER=first[-1], NENTRY=start[-1])
    named = {"body": made.bodies, "start": start, "first": first, "skip": skip, "member": member}
    made.integers.update({f"crowd_{name}": own for name, own in named.items()})
    made.numbers["crowd_sphere"] = np.concatenate(spheres)
    made.numbers["crowd_around"] = np.concatenate(around)
