"""Where a contact is, with slopes and curvature in closed form.

A row over a contact looks at six numbers: the sphere's centre c now, and the place b that the
body's point nearest to the ground had one step ago (``symbolic.contact_places``). CasADi
differentiates the row to these; they are points of bodies, whose derivatives are cross products.
With R, R_old the body's rotations, a = −radius·normal, G = R_old Rᵀ, and D = ω × c + v,
B = ω_old × b + v_old of a joint's twists now and one step ago:

    ∂c/∂x_next = D          ∂b/∂x_next = −G (ω × a)         ∂b/∂x = B

and of two joints on the way from the root, i before j (or the same),

    ∂²c/∂x_next² = ω_i × D_j      ∂²b/∂x_next² = G (ω_j × (ω_i × a))
    ∂²b/∂x²      = ω_i × B_j      ∂²b/∂x_next_i ∂x_j = −ω_j × G (ω_i × a), in any order

The ground is a plane: elsewhere the normal turns with c.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from octo.dynamics.parameters import section
from octo.model.terrain import normal
from octo.problem.symbols import ContactSymbols

Twist = tuple[ca.SX, ca.SX]  # (3,) ω and the velocity v of the point at the world's origin
SIZE = 6  # of c and b


@dataclass(frozen=True, eq=False)
class TouchPoint:
    """c and b of one contact in one time step.

    Attributes
    ----------
    contact: with c and b as expressions. symbols: (6,) what stands for them.
    path: the degrees of freedom that move the contact, root first. now, before: their twists, at
        x_next and at x.
    """

    contact: ContactSymbols
    symbols: ca.SX
    path: Sequence[int]
    now: Sequence[Twist]
    before: Sequence[Twist]

    @cached_property
    def value(self) -> ca.SX:
        """(6,) c and b."""
        return ca.vertcat(*self.contact.places[0])

    @cached_property
    def _arm(self) -> ca.SX:
        """(3,) m, a, from c to the point nearest to the ground."""
        own, c = self.contact, self.value[:3]
        return -own.radius * normal(own.terrain, c, section(own.dynamics, "terrain."))

    @cached_property
    def _turned(self) -> ca.SX:
        """(3, 3) G."""
        now, before, _ = self.contact.poses
        return before[0] @ now[0].T

    @cached_property
    def _slopes(self) -> tuple[list[ca.SX], list[ca.SX], list[ca.SX]]:
        """D, G (ω × a) and B of each joint of the path."""
        c, b = self.value[:3], self.value[3:]
        return (
            [ca.cross(turn, c) + move for turn, move in self.now],
            [self._turned @ ca.cross(turn, self._arm) for turn, _ in self.now],
            [ca.cross(turn, b) + move for turn, move in self.before],
        )

    def slopes(self, n: int, width: int) -> ca.SX:
        """(6, width) derivatives to (x_next, x, …), of ``n`` coordinates."""
        made = ca.SX(SIZE, width)
        for i, D, swung, B in zip(self.path, *self._slopes, strict=True):
            made[:3, i], made[3:, i], made[3:, n + i] = D, -swung, B
        return ca.sparsify(made)

    def curvature(self, pull: ca.SX, n: int, width: int) -> ca.SX:
        """(width, width) Σ pull ∂²(c, b), pull (6,)."""
        (D, swung, B), whole = self._slopes, ca.SX(width, width)
        turns, old = [turn for turn, _ in self.now], [turn for turn, _ in self.before]
        of_c, of_b = pull[:3], pull[3:]
        back = self._turned.T @ of_b
        pulled, own = [ca.cross(d, of_c) for d in D], [ca.cross(d, of_b) for d in B]
        bent, arms = [ca.cross(back, t) for t in turns], [ca.cross(t, self._arm) for t in turns]
        across = [ca.cross(d, of_b) for d in swung]

        def put(i: int, j: int, value: ca.SX) -> None:
            if not value.is_zero():
                whole[i, j] = whole[j, i] = value

        for k, j in enumerate(self.path):
            for m, i in enumerate(self.path):
                put(i, n + j, -ca.dot(old[k], across[m]))
                if m <= k:
                    put(i, j, ca.dot(turns[m], pulled[k]) + ca.dot(bent[k], arms[m]))
                    put(n + i, n + j, ca.dot(old[m], own[k]))
        return whole
