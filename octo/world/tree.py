"""A bounding-volume tree over boxes, as an array that code walks without pointers or recursion.

A node is [lowest corner (3,) m, highest corner (3,) m, next]. Nodes stand in preorder: the first
child of an inner node is the one behind it, the second is number ``next``; of a leaf ``next`` is
−1 − the number of its shape. Halves are equal in number, so that n leaves have ⌈log₂ n⌉ + 1 levels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from octo.checks import Array
from octo.world.layout import NODE

NEXT = NODE - 1


def build(boxes: Array, shapes: Sequence[int]) -> Array:
    """Nodes (2n − 1, NODE) over the boxes (n, 2, 3) m of shapes of these numbers; none of none."""
    nodes = np.empty((max(2 * len(boxes) - 1, 0), NODE))
    # what is to be placed: where, and which boxes
    waiting = [(0, np.arange(len(boxes)))] if len(boxes) else []
    while waiting:
        place, within = waiting.pop()
        nodes[place, :3], nodes[place, 3:NEXT] = _around(boxes[within])
        if len(within) == 1:
            nodes[place, NEXT] = -1.0 - shapes[within[0]]
            continue
        centers = boxes[within].mean(axis=1)
        axis = np.argmax(np.ptp(centers, axis=0))
        half = (len(within) + 1) // 2
        order = within[np.argsort(centers[:, axis], kind="stable")]
        nodes[place, NEXT] = place + 2 * half  # the first half has 2 half − 1 nodes
        waiting += [(place + 2 * half, order[half:]), (place + 1, order[:half])]
    return nodes


def refit(nodes: Array, shape: int, box: Array) -> None:
    """Give the leaf of a shape another box (2, 3) m, and fit the nodes above it, in place."""
    leaf = int(np.flatnonzero(nodes[:, NEXT] == -1.0 - shape)[0])
    way, place = [], 0
    while place != leaf:
        way.append(place)
        second = int(nodes[place, NEXT])
        place = second if leaf >= second else place + 1
    nodes[leaf, :NEXT] = box.ravel()
    for place in reversed(way):
        children = nodes[[place + 1, int(nodes[place, NEXT])], :NEXT].reshape(2, 2, 3)
        nodes[place, :NEXT] = np.ravel(_around(children))


def _around(boxes: Array) -> tuple[Array, Array]:
    """The corners of the box around boxes (n, 2, 3)."""
    return boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
