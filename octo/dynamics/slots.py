"""Where lanes_step.c keeps the numbers of J and of the curvature: nothing but what is not zero by
structure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.model.character import Character

Integers = NDArray[np.int_]


def paths(character: Character) -> list[list[int]]:
    """Of each degree of freedom j its ancestors from the root on, and j."""
    owner = [b for b, body in enumerate(character.bodies) for _ in body.joints]
    return [[i for i in character.path[b] if i <= j] for j, b in enumerate(owner)]


def loops(character: Character) -> list[tuple[list[int], int]]:
    """Of each pair the degrees of freedom that move one of its spheres alone, and how many of them
    move the first."""
    made = []
    for a, b in character.pairs:
        one, other = (character.path[character.contacts[k].body] for k in (a, b))
        first = [j for j in one if j not in other]
        made.append((first + [j for j in other if j not in one], len(first)))
    return made


def of_robot(character: Character) -> tuple[Integers, int, Integers, Integers]:
    """Places, numbers that pairs alone couple, and the slots of lanes_step.c.

    Returns
    -------
    places (n, n): of i and j in a run of slots, -1 where they are not coupled; their count beyond
        the related ones; the slots
    of jac (n, 3n) and hess (5, n, n), 0 for what is zero.
    """
    n, start = character.nx, 0
    places = np.full((n, n), -1)
    for j, path in enumerate(paths(character)):
        places[path[::-1], j] = start + np.arange(len(path))
        start += len(path)
    above, below = np.nonzero(places >= 0)
    at = 1 + places[above, below]
    jac, hess = np.zeros((n, 3, n), dtype=int), np.zeros((5, n, n), dtype=int)
    for node in range(3):
        jac[below, node, above] = at + (3 + node) * start
        jac[above, node, below] = at + node * start
    for block, (upper, lower) in enumerate(((0, 0), (1, 3), (2, 4), (5, 5), (6, 6))):
        hess[block, below, above] = at + lower * start
        hess[block, above, below] = at + upper * start
    places = np.maximum(places, places.T)
    count = start
    for dofs, _ in loops(character):
        for i in dofs:
            for j in dofs:
                if places[i, j] < 0:
                    places[i, j] = places[j, i] = count
                    jac[i, 0, j], hess[0, i, j] = 1 + 5 * start + count, 1 + 6 * start + count
                    jac[j, 0, i], hess[0, j, i] = jac[i, 0, j], hess[0, i, j]
                    count += 1
    return places, count - start, jac, hess


def of_past(character: Character, first: int) -> Integers:
    """(n, n) slots from ``first`` on of a block that couples the present node with the previous
    one; 0 for what is zero."""
    block, start = np.zeros((character.nx, character.nx), dtype=int), 0
    related = paths(character)
    count = sum(map(len, related))
    for j, path in enumerate(related):
        at = first + start + np.arange(len(path))
        block[j, path[::-1]], block[path[::-1], j] = at + count, at
        start += len(path)
    return block


def table(jac: Integers, hess: Integers) -> str:
    """C text of the slots, by the numbers' place in rows of jac and of hess."""
    kind = "unsigned short" if max(jac.max(), hess.max()) < 1 << 16 else "unsigned"
    return "\n".join([f"typedef {kind} octo_slot;", one_table("jac", jac), one_table("hess", hess)])


def one_table(name: str, values: Integers) -> str:
    return (
        f"static const octo_slot octo_{name}_slot[] = "
        f"{{{', '.join(str(int(v)) for v in values.ravel())}}};"
    )
