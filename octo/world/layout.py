"""Where everything is in ``World.data``, for Python and for C: one flat array of doubles, without a
pointer.

First the head, then a record of each shape (which kind, where its own numbers begin, its pose),
the shapes without an end, which every point is compared with, the tree over the others (tree.py),
and the shapes' own numbers.
"""

from __future__ import annotations

# the head: how many shapes, how many of them have an end, T of the smooth minimum (m), by how much
# φ changes on a metre at most, and where the records, the shapes without an end, the tree and the
# own numbers begin
COUNT, BOUNDED, SCALE, STEEPEST, RECORDS, ENDLESS, TREE, NUMBERS, HEAD = range(9)
# a record: the rotation is row by row, and none where the shape is not turned
KIND, OWN, TURNED, POSITION, ROTATION, RECORD = 0, 1, 2, 3, 6, 15
WIDTH = 8  # children of a node of the tree, at most: a vector of an AVX-512 processor, two of AVX
MOST = 2**20  # shapes: the tree has at most 7 levels,
STACK = 64  # and a walk leaves WIDTH − 1 nodes or shapes behind on each
FAR = 1e300  # m², of the square of a distance: farther than anything
PAST = 3  # numbers behind the last ones: four are read at once where fewer may be of use
NEAR = 32  # shapes in the smooth minimum at one point, at most: the nearest

NAMES = (
    "COUNT BOUNDED SCALE STEEPEST RECORDS ENDLESS TREE KIND OWN TURNED POSITION ROTATION RECORD "
    "WIDTH STACK FAR NEAR"
)


def text() -> str:
    """The same as macros of C."""
    return "\n".join(f"#define OCTO_WORLD_{name} {globals()[name]}" for name in NAMES.split())
