"""A bounding-volume tree over boxes, as an array that code walks without pointers or recursion.

A node has up to WIDTH children: the coordinates of their boxes' lowest corners, x of all, y of all,
z of all, of their highest corners in the same way, so that a processor compares a point with all
boxes at once, and where each child is: the number of a node, −1 − the number of a shape, or 0, no
child. Children are full but for the last ones, so that n shapes have ⌈log n / log WIDTH⌉ levels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.world.layout import FAR, WIDTH

CHILD = 6  # of a node's rows: where each child is
# a node without children, whose boxes are farther away than anything
EMPTY = np.concatenate([np.full((CHILD, WIDTH), 2.0 * FAR**0.5), np.zeros((1, WIDTH))])


def build(boxes: Array, shapes: Sequence[int]) -> Array:
    """Nodes (count, 7, WIDTH) over the boxes (n, 2, 3) m of shapes of these numbers, the root
    first."""
    nodes = [EMPTY.copy()]
    # nodes without children yet, and the boxes that are to be below them
    waiting: list[tuple[int, NDArray[np.intp]]] = []
    if len(boxes):
        waiting.append((0, np.arange(len(boxes))))
    while waiting:
        place, within = waiting.pop()
        size = 1  # of a full child: with the fewest levels
        while WIDTH * size < len(within):
            size *= WIDTH
        for slot, part in enumerate(_parts(boxes, within, size)):
            child = -1 - shapes[part[0]] if len(part) == 1 else len(nodes)
            _write(nodes[place], slot, _around(boxes[part]))
            nodes[place][CHILD, slot] = child
            if child > 0:
                nodes.append(EMPTY.copy())
                waiting.append((child, part))
    return np.array(nodes)


def refit(nodes: Array, shape: int, box: Array) -> None:
    """Give a shape another box (2, 3) m, and fit the boxes around it, in place."""
    sought, fitted = -1.0 - shape, box
    while sought != 0.0:  # up to the root
        (node,), (slot,) = np.nonzero(nodes[:, CHILD] == sought)
        _write(nodes[node], int(slot), fitted)
        there = nodes[node, :, nodes[node, CHILD] != 0.0]  # (children, 7)
        sought, fitted = float(node), _around(there[:, :CHILD].reshape(-1, 2, 3))


def _parts(boxes: Array, within: NDArray[np.intp], size: int) -> list[NDArray[np.intp]]:
    """Boxes in groups of ``size`` and one of the rest, cut again and again across the longest
    axis."""
    if len(within) <= size:
        return [within]
    centers = boxes[within].mean(axis=1)
    order = within[np.argsort(centers[:, np.argmax(np.ptp(centers, axis=0))], kind="stable")]
    first = size * ((len(within) + 2 * size - 1) // (2 * size))
    return [part for one in (order[:first], order[first:]) for part in _parts(boxes, one, size)]


def _write(node: Array, slot: int, box: Array) -> None:
    node[:CHILD, slot] = box.ravel()


def _around(boxes: Array) -> Array:
    """(2, 3): the box around boxes (n, 2, 3)."""
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
