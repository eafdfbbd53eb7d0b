"""What a network sees of a control c = (x, d), d the second half of it (x_i − x_{i−1}, or τ ẋ_k),
and how what it says makes the next one.

    s = (x − center, turned d)/(USUAL size)    without the place on the ground and the yaw
    c_next = held(c) + turned back (size · f(s))

held(c) is the pose at rest that a motion begins with: a network that says nothing says "stand". Of
the state of the *body* the place on the ground and the yaw ψ leave the inputs and are those of c in
held(c), and what is horizontal is turned by −ψ: a network cannot know where, when or in which
direction it walks. Of the state of the *world* all numbers are inputs, as printed in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, array_module, like

# what numbers of a control vary by, in sizes: 0.4 in a long walk, 0.1 in a stride. Inputs that were
# as small as these would leave a new network nearly linear
USUAL = 1 / 6


@dataclass(frozen=True, eq=False)
class Frame:
    """Of controls of n coordinates.

    Attributes
    ----------
    size: (n,) m or rad, what is one of each coordinate. center: (n,) where the inputs are zero.
    heading: the coordinates x, y and yaw of a state of the body; none of the world's.
    """

    size: Array
    center: Array
    heading: tuple[int, int, int] | None

    @property
    def n(self) -> int:
        return len(self.size)

    @cached_property
    def kept(self) -> NDArray[np.intp]:
        """Which numbers of a control are inputs."""
        out = () if self.heading is None else self.heading
        return np.setdiff1d(np.arange(2 * self.n), out)

    @cached_property
    def sizes(self) -> Array:
        """(2n,) of a control."""
        return np.tile(self.size, 2)

    @cached_property
    def _units(self) -> Array:
        """(2n,) what is one of each input."""
        return USUAL * self.sizes

    def _yaw(self, c: Array) -> tuple[Array, Array]:
        """cos ψ and sin ψ (…)."""
        xp = array_module(c)
        assert self.heading is not None
        yaw = c[..., self.heading[2]]
        return xp.cos(yaw), xp.sin(yaw)

    def turned(self, c: Array, v: Array, way: float = -1.0, slope: bool = False) -> Array:
        """v (…, 2n) with what is horizontal turned by way·ψ of the controls c (…, 2n), into the
        body's frame by default; its ``slope`` with respect to ψ, whose other numbers are zero."""
        if self.heading is None:
            return array_module(v).zeros_like(v) if slope else v.copy()
        (x, y, _), n, (cos, sin) = self.heading, self.n, self._yaw(c)
        made = array_module(v).zeros_like(v) if slope else v.copy()
        a, b = (-sin, way * cos) if slope else (cos, way * sin)
        a, b = a[..., None], b[..., None]
        ahead, left = v[..., x::n], v[..., y::n]  # of the place, and of its change
        made[..., x::n] = a * ahead - b * left
        made[..., y::n] = b * ahead + a * left
        return made

    def inputs(self, c: Array) -> Array:
        """s (…, inputs) of controls (…, 2n)."""
        made = self.turned(c, c)
        made[..., : self.n] = c[..., : self.n] - like(self.center, c)
        return (made / like(self._units, c))[..., like(self.kept, c)]

    def held(self, c: Array) -> Array:
        """(…, 2n) the pose at rest, where c (…, 2n) is."""
        made = array_module(c).zeros_like(c)
        made[..., : self.n] = like(self.center, c)
        for j in self.heading or ():
            made[..., j] = c[..., j]
        return made

    def change(self, c: Array, c_next: Array) -> Array:
        """(…, 2n) what f(s) should be for c_next to follow c, in the frame and in sizes."""
        return self.turned(c, c_next - self.held(c)) / like(self.sizes, c)

    def following(self, c: Array, f: Array) -> Array:
        """(…, 2n) the control after c (…, 2n) for a network's outputs f (…, 2n)."""
        return self.held(c) + self.turned(c, f * like(self.sizes, c), 1.0)

    # -- derivatives -------------------------------------------------------------------------------

    def through(self, c: Array, slopes: Array) -> Array:
        """(…, rows, 2n) with respect to controls c (…, 2n), of slopes (…, rows, inputs) with
        respect to the inputs."""
        xp = array_module(slopes)
        whole = xp.zeros((*slopes.shape[:-1], 2 * self.n))
        whole[..., like(self.kept, c)] = slopes
        whole /= like(self._units, c)
        if self.heading is not None:
            bent = self._bent(c)[..., None, :]
            along = (whole * bent).sum(axis=-1)
            whole[..., self.n :] = self._back(c, whole)[..., self.n :]
            whole[..., self.heading[2]] += along
        return whole

    def _back(self, c: Array, whole: Array) -> Array:
        """Rows (…, rows, 2n) of the body's frame as rows with respect to the world's numbers."""
        return self.turned(c[..., None, :], whole, 1.0)

    def _bent(self, c: Array) -> Array:
        """(…, 2n) how the inputs' numbers, not yet in sizes, change with ψ: those of d alone."""
        made = self.turned(c, c, slope=True)
        made[..., : self.n] = 0.0
        return made

    def pulled_inputs(self, c: Array, pull: Array) -> Array:
        """(…, 2n) the gradient with respect to c of s(c)·pull, pull (…, inputs)."""
        return self.through(c, pull[..., None, :])[..., 0, :]

    def pulled_following(self, c: Array, f: Array, pull: Array) -> tuple[Array, Array]:
        """The gradients of following(c, f)·pull, pull (…, 2n): with respect to f, and to c through
        the turn and held(c)."""
        of_f = self.turned(c, pull) * self.sizes
        of_c = array_module(c).zeros_like(pull)
        if self.heading is not None:
            own = list(self.heading)
            of_c[..., own] = pull[..., own]
            bent = self.turned(c, f * self.sizes, 1.0, slope=True)
            of_c[..., self.heading[2]] += (bent * pull).sum(axis=-1)
        return of_f, of_c

    def change_slopes(self, c: Array, c_next: Array) -> tuple[Array, Array]:
        """(…, 2n, 2n) twice: of ``change`` with respect to c and to c_next."""
        xp = array_module(c)
        eye = xp.broadcast_to(xp.eye(2 * self.n), (*c.shape, 2 * self.n))
        # a row of a turn by −ψ is a column of a turn by ψ
        sizes = like(self.sizes, c)
        of_next = self.turned(c[..., None, :], eye, 1.0) / sizes[:, None]
        of_c = xp.zeros_like(of_next)
        if self.heading is None:
            return of_c, of_next
        for j in self.heading:
            of_c[..., j] = -of_next[..., j]
        bent = self.turned(c, c_next - self.held(c), slope=True) / sizes
        of_c[..., self.heading[2]] += bent
        return of_c, of_next
