"""Where everything is in ``World.data``, for Python and for C: one flat array of doubles, without a
pointer.

First the head, then a record of each shape (which kind, where its own numbers begin, its pose),
the shapes without an end, which every point is compared with, the tree over the others (tree.py),
and the shapes' own numbers.
"""

from __future__ import annotations

# the head: how many shapes, how many of them have an end, T of the smooth minimum (m), and where
# the records, the shapes without an end and the tree begin
COUNT, BOUNDED, SCALE, RECORDS, ENDLESS, TREE, HEAD = range(7)
# a record: the rotation is row by row, and none where the shape is not turned
KIND, OWN, TURNED, POSITION, ROTATION, RECORD = 0, 1, 2, 3, 6, 15
NODE = 7  # of the tree: lowest corner, highest corner, and where to go on
DEPTH = 32  # levels of the tree, at most
MOST = 2**20  # shapes, so that it has no more than 22
NEAR = 32  # shapes in the smooth minimum at one point, at most: the nearest

NAMES = (
    "COUNT BOUNDED SCALE RECORDS ENDLESS TREE KIND OWN TURNED POSITION ROTATION RECORD NODE DEPTH "
    "NEAR"
)


def text() -> str:
    """The same as macros of C."""
    return "\n".join(f"#define OCTO_WORLD_{name} {globals()[name]}" for name in NAMES.split())
