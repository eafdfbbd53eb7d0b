"""Many shapes as one φ, positive outside of all of them, with its derivatives at any point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from octo.checks import Array, numbers, positive, whole
from octo.errors import ProblemError, UnknownNameError, ValueRangeError, said
from octo.world import interpreted, layout, query, tree
from octo.world.blend import PART
from octo.world.drawn import Drawn, drawn, everywhere
from octo.world.jet import SIZES
from octo.world.shape import FRACTION, Shape, places
from octo.world.shapes import KINDS

REACHED = 1e-6  # m, over a surface that a falling point has come to
FALLEN = 1e4  # m, that it falls at most
LEAST = 1e-3  # m, of a step of its way, so that it does not creep down a wall beside it
HALVINGS = 10  # of such a step, down to REACHED


@dataclass(frozen=True, eq=False)
class World:
    """The union of shapes: φ is the smooth minimum of theirs.

    Parameters
    ----------
    shapes: of ``octo.shapes``; those with a name have different ones.
    blend: m, six times the farthest that the surface bulges where shapes meet: concave corners are
        rounded. A shape matters where it is less than a quarter of this farther than the nearest.

    Raises
    ------
    ProblemError: no shapes, or two of one name. ValueRangeError: ``blend`` is not positive.
    """

    shapes: Sequence[Shape]
    blend: float = 0.005

    def __post_init__(self) -> None:
        if isinstance(self.shapes, Shape) or not isinstance(self.shapes, Sequence):
            raise ProblemError(f"shapes is {said(self.shapes)}, must be a list of octo.shapes")
        if not 0 < len(self.shapes) <= layout.MOST:
            raise ProblemError(
                f"a World has {len(self.shapes)} shapes, must have 1 to {layout.MOST}"
            )
        names: dict[str, int] = {}
        for k, shape in enumerate(self.shapes):
            if not isinstance(shape, Shape) or getattr(shape, "kind", None) not in KINDS:
                raise ProblemError(f"shapes[{k}] is {said(shape)}, must be one of octo.shapes")
            if shape.name is not None and names.setdefault(shape.name, k) != k:
                raise ProblemError(
                    f"shapes[{names[shape.name]}] and shapes[{k}] are both named {shape.name!r}: "
                    "rename one"
                )
        object.__setattr__(self, "shapes", tuple(self.shapes))
        object.__setattr__(self, "blend", positive("blend", self.blend, "m"))

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and copies: the fields. Numbers of its own make a copy known by their place in
        memory, and keep them as they are."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    # -- numbers -----------------------------------------------------------------------------------

    @cached_property
    def data(self) -> Array:
        """(size,) all numbers, as the C text of ``octo.world.query`` reads them."""
        boxes = np.array([shape.bounds() for shape in self.shapes])
        finite = np.isfinite(boxes).all(axis=(1, 2))
        bounded, endless = np.flatnonzero(finite), np.flatnonzero(~finite)
        nodes = tree.build(boxes[bounded], bounded.tolist())
        records = np.empty((len(self.shapes), layout.RECORD))
        parts = [np.empty(layout.HEAD), records, endless, nodes, *(s.own for s in self.shapes)]
        at = np.cumsum([0, *(np.size(part) for part in parts)])
        steepest = max(shape.steepest for shape in self.shapes)
        parts[0][:] = len(self.shapes), len(bounded), PART * self.blend, steepest, *at[1:5]
        for k, shape in enumerate(self.shapes):
            records[k, layout.KIND], records[k, layout.OWN] = KINDS.index(shape.kind), at[4 + k]
            _place(records[k], shape)
        parts.append(np.zeros(layout.PAST))
        return _kept(np.concatenate([np.ravel(part) for part in parts]))

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) m: the lowest and the highest corner of a box around all points with φ ≤ 0,
        infinite where they have no end."""
        boxes = np.array([shape.bounds() for shape in self.shapes])
        bulge = self.blend / 6.0 / FRACTION if len(boxes) > 1 else 0.0  # where shapes meet
        return _kept(np.stack([boxes[:, 0].min(axis=0) - bulge, boxes[:, 1].max(axis=0) + bulge]))

    # -- queries -----------------------------------------------------------------------------------

    def jets(self, points: ArrayLike, order: int = 1) -> Array:
        """φ and its derivatives, (k, 1, 4, 10 or 20), in m and world axes: [φ; x y z; xx xy xz yy
        yz zz; xxx xxy xxz xyy xyz xzz yyy yyz yzz zzz] up to an order.

        Parameters
        ----------
        points: (k, 3) m. order: of the derivatives, 0 to 3.
        """
        given = places(points)
        whole("order", order, 0, len(SIZES) - 1)
        found = query.compiled(self.data, given, order)
        if found is None:
            found = interpreted.jets(self.shapes, PART * self.blend, given, order)
        return found

    def distance(self, points: ArrayLike) -> Array:
        """φ (k,) m, positive outside.

        Parameters
        ----------
        points: (k, 3) m.
        """
        return self.jets(points, 0)[:, 0]

    def below(self, points: ArrayLike) -> Array:
        """Heights (k,) m of the surface straight below points; a point inside a shape is its own,
        and −∞ where there is nothing.

        Parameters
        ----------
        points: (k, 3) m.
        """
        given = places(points).copy()
        if self._one_map:  # of which φ is the height over it
            given[:, 2] -= np.maximum(self.distance(given), 0.0)
            return given[:, 2]
        lowest = max(self.bounds[0, 2] - 1.0, float(given[:, 2].min(initial=0.0)) - FALLEN)
        height = given[:, 2]
        steepest = float(self.data[layout.STEEPEST])
        if query.fallen(self.data, given, (lowest, REACHED, LEAST, steepest, HALVINGS)):
            return height
        above, falling = height.copy(), np.arange(len(given))
        while len(falling):
            away = self.distance(given[falling])
            falling, away = falling[away > REACHED], away[away > REACHED]
            above[falling] = height[falling]
            # so far there is no surface; beside a wall that is near
            height[falling] -= np.maximum(away / steepest, LEAST)
            height[falling[height[falling] < lowest]] = -np.inf
            falling = falling[np.isfinite(height[falling])]
        landed = np.flatnonzero(np.isfinite(height) & (height < above))
        for _ in range(HALVINGS):  # who took a least step may be inside
            middle = given[landed]
            middle[:, 2] = 0.5 * (above[landed] + height[landed])
            inside = self.distance(middle) <= REACHED
            height[landed[inside]] = middle[inside, 2]
            above[landed[~inside]] = middle[~inside, 2]
        return height

    @cached_property
    def _one_map(self) -> bool:
        """Whether it is a single map of heights that is not turned."""
        one = self.shapes[0]
        level = np.array_equal(np.asarray(one.rotation), np.eye(3))
        return len(self.shapes) == 1 and one.kind.name == "heights" and level

    def covers(self, points: ArrayLike) -> Array:
        """(k,) whether points have a shape above or below them, as seen from above.

        Parameters
        ----------
        points: (k, 3) m.
        """
        return np.any([shape.covers(points) for shape in self.shapes], axis=0)

    def surface(self, around: ArrayLike | None = None) -> list[Drawn]:
        """What it looks like: the triangles of each shape, as fine as the shape itself.

        Parameters
        ----------
        around: (2, 2) m, the least and the largest x and y of the picture, which planes fill and
            maps are cut to; by default around all that ends somewhere.
        """
        frame = everywhere(self.shapes) if around is None else numbers("around", around, (2, 2))
        return drawn(self.shapes, frame)

    # -- motion ------------------------------------------------------------------------------------

    def index(self, name_or_index: str | int) -> int:
        """The number of a shape.

        Parameters
        ----------
        name_or_index: its name, or its place in ``shapes``.
        """
        if isinstance(name_or_index, str):
            names = [shape.name for shape in self.shapes]
            if name_or_index not in names:
                known = [name for name in names if name is not None]
                raise UnknownNameError("shape", name_or_index, known)
            return names.index(name_or_index)
        most = len(self.shapes) - 1
        if isinstance(name_or_index, bool) or not isinstance(name_or_index, (int, np.integer)):
            raise ProblemError(f"a shape is {said(name_or_index)}, must be a name or a number")
        if not -len(self.shapes) <= name_or_index <= most:
            raise ValueRangeError(f"shape {name_or_index} is not there, must be 0 to {most}")
        return int(name_or_index) % len(self.shapes)

    def moved(
        self,
        name_or_index: str | int,
        position: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
    ) -> World:
        """The same world with one shape in another pose: only numbers change.

        Parameters
        ----------
        name_or_index: of the shape. position: (3,) m. rotation: (3, 3), or a quaternion wxyz (4,).
            What is not given stays.
        """
        k = self.index(name_or_index)
        shape = self.shapes[k].moved(position, rotation)
        made = replace(self, shapes=[*self.shapes[:k], shape, *self.shapes[k + 1 :]])
        data = self.data.copy()
        record = int(data[layout.RECORDS]) + layout.RECORD * k
        _place(data[record : record + layout.RECORD], shape)
        box = shape.bounds()
        if np.isfinite(box).all():
            first, last = int(data[layout.TREE]), int(data[layout.NUMBERS])
            tree.refit(data[first:last].reshape(-1, tree.CHILD + 1, layout.WIDTH), k, box)
        made.__dict__["data"] = _kept(data)  # where a cached_property looks first
        return made


def _place(record: Array, shape: Shape) -> None:
    """Write the pose of a shape into its record."""
    rotation = np.asarray(shape.rotation)
    record[layout.TURNED] = float((rotation != np.eye(3)).any())
    record[layout.POSITION : layout.ROTATION] = shape.position
    record[layout.ROTATION : layout.RECORD] = rotation.ravel()


def _kept(data: Array) -> Array:
    """Numbers that nobody changes any more."""
    data.flags.writeable = False
    return data
