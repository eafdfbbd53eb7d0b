"""The same as query.c without a compiler: the way in NumPy, the formulas by CasADi's virtual
machine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from octo.checks import Array
from octo.world.blend import REACH, add, root, soften
from octo.world.jet import SIZES, turned
from octo.world.layout import NEAR
from octo.world.shape import FRACTION, Shape


def jets(shapes: Sequence[Shape], scale: float, points: Array, order: int) -> Array:
    """Jets (k, SIZES[order]) at points (k, 3) m.

    Parameters
    ----------
    scale: T of the smooth minimum, m.
    """
    made = np.full((len(points), SIZES[order]), np.nan)
    known = np.isfinite(points.sum(axis=1))
    if known.any():
        values = distances(shapes, scale, points[known])
        made[known] = softened(shapes, scale, points[known], values, order)
    return made


def of_shape(shape: Shape, points: Array, order: int) -> Array:
    """Jets (k, SIZES[order]) of one shape, in world axes."""
    rotation = np.asarray(shape.rotation)
    made = shape.kind.jets(shape.own, (points - np.asarray(shape.position)) @ rotation, order)
    if (rotation == np.eye(3)).all():
        return made
    columns = np.tile(rotation.reshape(9, 1), len(points))
    return np.asarray(turned(order)(columns, made.T), dtype=float).T


def distances(shapes: Sequence[Shape], scale: float, points: Array) -> Array:
    """φ (k, n) m of each shape, infinite where it cannot matter."""
    boxes = np.array([shape.bounds() for shape in shapes])  # (n, 2, 3)
    bound = np.empty((len(points), len(shapes)))
    for k in range(len(shapes)):
        beyond = np.maximum(np.maximum(boxes[k, 0] - points, points - boxes[k, 1]), 0.0)
        bound[:, k] = FRACTION * np.linalg.norm(beyond, axis=1)
    values = np.full(bound.shape, np.inf)
    nearest = np.argmin(bound, axis=1)
    for k in np.unique(nearest):
        rows = nearest == k
        values[rows, k] = of_shape(shapes[k], points[rows], 0)[:, 0]
    limit = np.maximum(values.min(axis=1) + REACH * scale, 0.0)
    for k, shape in enumerate(shapes):
        rows = (bound[:, k] <= limit) & (nearest != k)
        if rows.any():
            values[rows, k] = of_shape(shape, points[rows], 0)[:, 0]
    return values


def softened(
    shapes: Sequence[Shape], scale: float, points: Array, values: Array, order: int
) -> Array:
    """Jets (k, SIZES[order]) of the smooth minimum of shapes at distances (k, n) m, rank by rank:
    of each point its r-th nearest shape."""
    ranks = np.argsort(values, axis=1, kind="stable")[:, :NEAR]
    least = np.take_along_axis(values, ranks[:, :1], axis=1)[:, 0]
    x = (np.take_along_axis(values, ranks, axis=1) - least[:, None]) / scale
    felt = np.array([_felt(row) for row in x])
    sums = [np.zeros((SIZES[order], len(points))) for _ in range(3)]
    for r in range(felt.max()):
        rows = np.flatnonzero(felt > r)
        one = np.empty((SIZES[order], len(rows)))
        for k in np.unique(ranks[rows, r]):
            here = ranks[rows, r] == k
            one[:, here] = of_shape(shapes[k], points[rows[here]], order).T
        if r == 0:
            alone = one.copy()
        scales = np.stack([least[rows], np.full(len(rows), scale)])
        added = add(order)(scales, one, *[part[:, rows] for part in sums])
        for part, new in zip(sums, added, strict=True):
            part[:, rows] = np.asarray(new)
    scales = np.stack([least, np.full(len(points), scale), felt])
    made = np.asarray(soften(order)(scales, *sums), dtype=float)
    return np.where(felt == 1, alone, made).T


def _felt(x: Array) -> int:
    """How many of rising distances (n,) the minimum feels: those with x < τ."""
    tau, count = REACH, 1
    while count < len(x) and x[count] < tau:
        count += 1
        tau = float(root(count, x[:count].sum(), (x[:count] ** 2).sum()))
    return count
