"""Where lanes_step.c keeps J and the curvature: only what is not zero by structure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.model.character import Character

Integers = NDArray[np.int_]
# of the curvature, by two of the nodes x_next, x, x_prev; a robot has none of the last
BLOCKS = ((0, 0), (0, 1), (0, 2), (1, 1), (2, 2), (1, 2))


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


def reaches(character: Character) -> list[list[int]]:
    """Of each element the degrees of freedom that move one of its points or both; none where it
    couples no two branches: nothing moves one of the points."""
    made = []
    for element in character.elements:
        a, b = (
            character.path[character.body_index(body)] if body is not None else ()
            for body in (element.body_a, element.body_b)
        )
        made.append(sorted({*a, *b}) if a and b else [])
    return made


def mutual_ends(character: Character) -> list[tuple[int, int]]:
    """The bodies of each contact between bodies: the sphere's, and the solid's."""
    return [(character.contacts[c].body, character.solids[s].body) for c, s in character.touches]


def mutual_reaches(character: Character) -> list[list[int]]:
    """The same as ``reaches`` of each contact between bodies."""
    ends = ((character.path[a], character.path[b]) for a, b in mutual_ends(character))
    return [sorted({*a, *b}) if a and b else [] for a, b in ends]


def of_robot(character: Character) -> tuple[Integers, int, Integers, Integers]:
    """Places, numbers that pairs alone couple, and the slots of lanes_step.c.

    Returns
    -------
    places (n, n): of i and j in a run of slots, -1 where they are not coupled; their count beyond
        the related ones; the slots
    of jac (n, 3n) and hess (6, n, n), 0 for what is zero. The last block of hess is that of x and
    x_prev, which is zero in FD and not in terms over contacts.
    """
    n, start = character.nx, 0
    places = np.full((n, n), -1)
    for j, path in enumerate(paths(character)):
        places[path[::-1], j] = start + np.arange(len(path))
        start += len(path)
    above, below = np.nonzero(places >= 0)
    at = 1 + places[above, below]
    jac, hess = np.zeros((n, 3, n), dtype=int), np.zeros((6, n, n), dtype=int)
    for node in range(3):
        jac[below, node, above] = at + (3 + node) * start
        jac[above, node, below] = at + node * start
    for block, (upper, lower) in enumerate(((0, 0), (1, 3), (2, 4), (5, 5), (6, 6), (7, 8))):
        hess[block, below, above] = at + lower * start
        hess[block, above, below] = at + upper * start
    places = np.maximum(places, places.T)
    if any(reaches(character)) or any(mutual_reaches(character)):
        return places, _of_elements(character, start, jac, hess), jac, hess
    count = start
    for dofs, _ in loops(character):
        for i in dofs:
            for j in dofs:
                if places[i, j] < 0:
                    places[i, j] = places[j, i] = count
                    jac[i, 0, j], hess[0, i, j] = 1 + 5 * start + count, 1 + 8 * start + count
                    jac[j, 0, i], hess[0, j, i] = jac[i, 0, j], hess[0, i, j]
                    count += 1
    return places, count - start, jac, hess


def _of_elements(character: Character, start: int, jac: Integers, hess: Integers) -> int:
    """Slots of what pairs, elements and contacts between bodies couple beyond the related ones, and
    their count: no two entries of jac share one, and of hess H00 and H11 their equal ones."""
    used = [6 * start, 9 * start]

    def slot(table: Integers, which: int, *entries: tuple[int, int, int]) -> None:
        if table[entries[0]] == 0:
            used[which] += 1
            for entry in entries:
                table[entry] = used[which]

    both = [dofs for dofs, _ in loops(character)]
    coupled = [*reaches(character), *mutual_reaches(character)]
    for dofs, nodes in [*((d, 1) for d in both), *((d, 2) for d in coupled)]:
        for i in dofs:
            for j in dofs:
                slot(hess, 1, (0, i, j), (0, j, i))
                for node in range(nodes):
                    slot(jac, 0, (i, node, j))
                if nodes == 2:
                    slot(hess, 1, (1, i, j))
                    slot(hess, 1, (3, i, j), (3, j, i))
    return max(used[0] - 6 * start, used[1] - 9 * start)


def table(jac: Integers, hess: Integers) -> str:
    """C text of the slots, by the numbers' place in rows of jac and of hess."""
    kind = "unsigned short" if max(jac.max(), hess.max()) < 1 << 16 else "unsigned"
    return "\n".join([f"typedef {kind} octo_slot;", one_table("jac", jac), one_table("hess", hess)])


def one_table(name: str, values: Integers) -> str:
    entries = ", ".join(str(int(v)) for v in values.ravel())
    return f"static const octo_slot octo_{name}_slot[] = {{{entries}}};"
