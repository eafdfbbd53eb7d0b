"""Contacts of a deforming surface with the ground, over all steps at once, in NumPy: of all
vertices their heights, of those that are near what the law says and how it changes."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.dynamics import stages
from octo.dynamics.contact_numbers import AT_ONCE, NAMES, one_contact
from octo.dynamics.laws import ContactLaw
from octo.dynamics.parameters import Layout
from octo.model.terrain import ADDRESS, Ground, World, world_at
from octo.soft.body import Body
from octo.soft.inertia import Forces
from octo.soft.nodes import Nodes, Turns
from octo.world.jet import SIZES

VERTEX = "vertex_"  # how the names of contacts begin, behind which the vertex's number is


@dataclass(frozen=True, eq=False)
class Surface:
    """A body's vertices and the law that they touch the ground by.

    Attributes
    ----------
    shapes: (P, K, 3), of each vertex its φ_0 = X (m), φ_1, …, φ_r.
    terrain: the ground; a world is looked up. place: where p has the address of its numbers.
    reach: how far from the ground the law acts. gap: how far inside that a point is.
    laws: force and derivatives, by order.
    """

    shapes: Array
    terrain: Ground
    place: int
    reach: ca.Function
    gap: ca.Function
    laws: tuple[ca.Function, ca.Function, ca.Function]

    @classmethod
    def of(cls, body: Body, law: ContactLaw, terrain: Ground, layout: Layout) -> Surface:
        one, two, three = (stages.point(order, layout, law, terrain) for order in (0, 1, 2))
        shapes = np.concatenate([body.points[:, None], body.modes], axis=1)
        place = layout.index(ADDRESS) if isinstance(terrain, World) else -1
        near = stages.reach(layout, law), stages.gap(layout, law, terrain)
        return cls(shapes, terrain, place, *near, (one, two, three))

    def world(self, p: Array) -> World | None:
        """The one that p (NP,) names, or the terrain's; None where the ground is none."""
        if not isinstance(self.terrain, World):
            return None
        return world_at(float(p[self.place])) or self.terrain

    def places(self, at: Nodes) -> Array:
        """(N, P, 3) m, world."""
        y = np.einsum("sk,pkj->spj", at.weights, self.shapes)
        return np.asarray(y @ at.turns.value.swapaxes(1, 2) + at.place[:, None], dtype=float)

    def touching(self, at: Nodes, p: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Steps and vertices of the contacts that are near the ground."""
        places = self.places(at)
        flat, world = places.reshape(-1, 3), self.world(p)
        if world is None:
            gap = np.asarray(self.gap(flat.T, 0.0, p)).reshape(places.shape[:2])
        else:
            gap = (float(self.reach(p)) - world.distance(flat)).reshape(places.shape[:2])
        step, vertex = np.nonzero(~(gap <= 0.0))  # a NaN is near
        return step, vertex

    def states(
        self, at: Nodes, now: Nodes, p: Array, own: Array, layout: Layout, law: ContactLaw
    ) -> tuple[tuple[str, ...], list[Array], Array]:
        """Names (c,) of the vertices that come near the ground; their forces, places, velocities
        and normals (N, c, 3) and depths (N, c) at ``at``, which ``now`` is a step before; p (NP,),
        and as the dynamics bind it."""
        chosen = np.unique(self.touching(at, own)[1])
        places = self.places(at)[:, chosen]
        flat, before = places.reshape(-1, 3), self.places(now)[:, chosen].reshape(-1, 3)
        one, world = one_contact(layout, law, self.terrain), self.world(own)
        found = np.empty((len(flat), 3 * len(NAMES) + 1))
        for first in range(0, len(flat), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            count = len(flat[part])
            still = np.tile(np.eye(3).reshape(9, 1), count)
            poses = [np.concatenate([still, points[part].T]) for points in (flat, before)]
            order = len(SIZES) - 1
            look = [] if world is None else [flat[part].T, world.jets(flat[part], order).T]
            given = (*poses, np.zeros((4, count)), np.repeat(p[:, None], count, axis=1), *look)
            found[part] = np.asarray(one(*given)).T
        state = found.reshape(*places.shape[:2], found.shape[1])
        names = tuple(f"{VERTEX}{k}" for k in chosen)
        return names, [state[..., 3 * k : 3 * k + 3] for k in range(len(NAMES))], state[..., -1]


class Contacts:
    """Those that are near the ground at x_next, one row each: C of them.

    Parameters
    ----------
    window: next and now. order: of the derivatives.
    along: R_λ, and ``lam`` (N, n), of order 2.
    """

    def __init__(
        self,
        surface: Surface,
        window: tuple[Nodes, Nodes],
        p: Array,
        order: int,
        along: Turns | None = None,
        lam: Array | None = None,
    ):
        self.steps = len(window[0].place)
        self.step, self.vertex = surface.touching(window[0], p)
        self.shapes = surface.shapes[self.vertex]  # (C, K, 3)
        self.at, self.now = (_rows(node, self.step) for node in window)
        places = [_place(node, self.shapes) for node in (self.at, self.now)]
        self.place, delta, count = places[0], np.zeros((len(self.step), 3)), len(self.step)
        if along is not None and lam is not None:
            self.along, self.lam = along_rows(along, self.step), lam[self.step]
            self.delta_slope = self._along_slopes()
            delta = self._displaced()
        world = surface.world(p)
        jets = [] if world is None else [world.jets(places[0], len(SIZES) - 1).T]
        given = (places[0].T, places[1].T, p, delta.T, *jets)
        out = surface.laws[order](*given) if count else ()
        found = (out,) if isinstance(out, ca.DM) else out
        numbers = [np.asarray(one, dtype=float).T for one in found]
        sizes = ((3,), (3, 3), (3, 3), (6, 6))
        made = [one.reshape(count, *size) for one, size in zip(numbers, sizes, strict=False)]
        made += [np.zeros((0, *size)) for size in sizes[len(made) :]]
        self.force, self.by_place, self.by_before, self.second = made
        self.delta = delta

    def add_to(self, forces: Forces) -> None:
        """−f on T_next."""
        np.subtract.at(forces.blocks, self.step, _outer(self.force, self.shapes))
        np.subtract.at(forces.total, self.step, self.force)

    def jacobian(self) -> tuple[Array, Array]:
        """What FD's Jacobian to next and to now has beside F's: −Jᵀ f_c J, −Jᵀ f_U J', (N, n, n)
        each."""
        J, before = _slopes(self.at, self.shapes), _slopes(self.now, self.shapes)
        left = J.swapaxes(1, 2)
        return self._sum(-left @ self.by_place @ J), self._sum(-left @ self.by_before @ before)

    def pulls(self) -> tuple[Array, Array]:
        """−(∂f)ᵀδ on T of next and of now, (N, K, 3, 3) each."""
        made = []
        for slope in (self.by_place, self.by_before):
            pull = -np.einsum("cij,ci->cj", slope, self.delta)
            total = np.zeros((self.steps, *self.shapes.shape[1:2], 3, 3))
            np.add.at(total, self.step, _outer(pull, self.shapes))
            made.append(total)
        return made[0], made[1]

    def curvature(self) -> tuple[Array, Array, Array]:
        """Blocks (next, next), (next, now) and (now, now) of what −δ·f has beside F's and the
        pulls', (N, n, n) each."""
        J, before = _slopes(self.at, self.shapes), _slopes(self.now, self.shapes)
        h, turned = self.second, self.delta_slope.swapaxes(1, 2)
        mixed = turned @ self.by_place @ J
        left = J.swapaxes(1, 2)
        return (
            self._sum(left @ h[:, :3, :3] @ J - mixed - mixed.swapaxes(1, 2)),
            self._sum(left @ h[:, :3, 3:] @ before - turned @ self.by_before @ before),
            self._sum(before.swapaxes(1, 2) @ h[:, 3:, 3:] @ before),
        )

    def _displaced(self) -> Array:
        """δ = J λ (C, 3) m."""
        y = np.einsum("ck,ckj->cj", self.at.weights, self.shapes)
        bent = np.einsum("ck,ckj->cj", self.lam[:, 6:], self.shapes[:, 1:])
        turned = np.einsum("cij,cj->ci", self.along.value, y)
        return np.asarray(
            self.lam[:, :3] + turned + np.einsum("cij,cj->ci", self.at.turns.value, bent)
        )

    def _along_slopes(self) -> Array:
        """∂δ/∂x_next (C, 3, n)."""
        made = _slopes(Nodes(self.at.place, self.along, self.at.weights, *_NONE), self.shapes)
        made[:, :, :3] = 0.0
        bent = np.einsum("ck,ckj->cj", self.lam[:, 6:], self.shapes[:, 1:])
        made[:, :, 3:6] += np.einsum("caij,cj->cia", self.at.turns.slope, bent)
        return made

    def _sum(self, blocks: Array) -> Array:
        """Over the contacts of each step."""
        total = np.zeros((self.steps, *blocks.shape[1:]))
        np.add.at(total, self.step, blocks)
        return total


_NONE = (np.zeros(0), np.zeros(0))


def along_rows(turns: Turns, step: NDArray[np.intp]) -> Turns:
    return Turns(turns.value[step], turns.slope[step], turns.second[step])


def _rows(node: Nodes, step: NDArray[np.intp]) -> Nodes:
    return Nodes(node.place[step], along_rows(node.turns, step), node.weights[step], *_NONE)


def _place(node: Nodes, shapes: Array) -> Array:
    """(C, 3) m."""
    y = np.einsum("ck,ckj->cj", node.weights, shapes)
    return np.asarray(node.place + np.einsum("cij,cj->ci", node.turns.value, y), dtype=float)


def _slopes(node: Nodes, shapes: Array) -> Array:
    """∂P/∂x (C, 3, n)."""
    count = len(shapes)
    y = np.einsum("ck,ckj->cj", node.weights, shapes)
    turned = np.einsum("caij,cj->cia", node.turns.slope, y)
    modal = np.einsum("cij,ckj->cik", node.turns.value, shapes[:, 1:])
    return np.concatenate([np.broadcast_to(np.eye(3), (count, 3, 3)), turned, modal], axis=2)


def _outer(force: Array, shapes: Array) -> Array:
    """(C, K, 3, 3) of a force (C, 3) at a vertex: on the blocks w_k R."""
    return np.asarray(force[:, None, :, None] * shapes[:, :, None, :], dtype=float)
