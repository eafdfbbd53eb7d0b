"""A bounding-volume tree over boxes, as an array that code walks without pointers or recursion.

A node has up to WIDTH children: the coordinates of their boxes' lowest corners, x of all, y of all,
z of all, of their highest corners in the same way, so that a processor compares a point with all
boxes at once, and where each child is: the number of a node, −1 − the number of a shape, or 0, no
child. Children have nearly as many shapes each, so that n shapes have ⌈log n / log WIDTH⌉ levels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from octo.checks import Array
from octo.world.layout import WIDTH

CHILD = 6  # of a node's rows: where each child is


def build(boxes: Array, shapes: Sequence[int]) -> Array:
    """Nodes (count, 7, WIDTH) over the boxes (n, 2, 3) m of shapes of these numbers, the root
    first."""
    nodes: list[Array] = []
    # which boxes are to be placed, and the child that they become
    waiting: list[tuple[Array, tuple[int, int] | None]] = [(np.arange(len(boxes)), None)]
    while waiting:
        within, child = waiting.pop()
        if child is not None:
            node, slot = child
            _write(nodes[node], slot, _around(boxes[within]))
            alone = len(within) == 1
            nodes[node][CHILD, slot] = -1.0 - shapes[within[0]] if alone else len(nodes)
            if alone:
                continue
        nodes.append(np.zeros((CHILD + 1, WIDTH)))
        parts = [part for part in _parts(boxes, within, WIDTH) if len(part)]
        waiting += [(part, (len(nodes) - 1, slot)) for slot, part in enumerate(parts)]
    return np.array(nodes)


def refit(nodes: Array, shape: int, box: Array) -> None:
    """Give a shape another box (2, 3) m, and fit the boxes around it, in place."""
    sought, fitted = -1.0 - shape, box
    while sought != 0.0:  # up to the root
        (node,), (slot,) = np.nonzero(nodes[:, CHILD] == sought)
        _write(nodes[node], slot, fitted)
        there = nodes[node, :, nodes[node, CHILD] != 0.0]  # (children, 7)
        sought, fitted = float(node), _around(there[:, :CHILD].reshape(-1, 2, 3))


def _parts(boxes: Array, within: Array, count: int) -> list[Array]:
    """Boxes in ``count`` groups of nearly the same size, halved along the longest axis."""
    if count == 1 or len(within) <= 1:
        return [within]
    centers = boxes[within].mean(axis=1)
    order = within[np.argsort(centers[:, np.argmax(np.ptp(centers, axis=0))], kind="stable")]
    half = (len(within) + 1) // 2
    return [part for one in (order[:half], order[half:]) for part in _parts(boxes, one, count // 2)]


def _write(node: Array, slot: int, box: Array) -> None:
    node[:CHILD, slot] = box.ravel()


def _around(boxes: Array) -> Array:
    """(2, 3): the box around boxes (n, 2, 3)."""
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
