"""Tables in C, and those of the costs that the lanes' C text alone works from (sparse_rows.c,
contacts.c)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from octo.dynamics.codegen import Links, integers
from octo.dynamics.crowd import members_of, singles_of
from octo.model.character import Character
from octo.problem.contact_model import ContactFunctions

FEW = 6  # entries, above which a row written out costs less than its products


def tables_text(
    sizes: Mapping[str, int], tables: Mapping[str, ArrayLike], anew: bool = False
) -> str:
    """Sizes as macros, ``anew`` where others may have defined them, and index tables as constant
    arrays."""
    undef = "#undef {0}\n" if anew else ""
    lines = [f"{undef.format(name)}#define {name} {value}" for name, value in sizes.items()]
    return "\n".join([*lines, *(integers(name, table) for name, table in tables.items())])


def row_tables(rows: NDArray[np.intp], columns: NDArray[np.intp], n: int) -> str:
    """How each row over the state enters the model of E, from where its derivatives are not zero.

    Rows of few entries, such as a posture's, are added to H entry by entry; rows of one torque
    alone, such as effort and torque limits, are summed by torque; all others are written out over a
    step's three nodes.

    Parameters
    ----------
    rows, columns (NZ,): of the derivatives over (x_next, x, x_prev, u). n: coordinates.
    """
    few, torque, dense = [], [], []
    for row in np.unique(rows):
        entries = np.flatnonzero(rows == row)
        of_torques = int((columns[entries] >= 3 * n).sum())
        if of_torques == len(entries) == 1:
            torque += list(entries)
        elif of_torques == 0 and len(entries) <= FEW:
            few.append(entries)
        else:
            dense.append(entries)
    places: dict[tuple[int, int], int] = {}
    products = []
    for entries in few:
        for a in entries:
            for b in entries:
                i, j = int(columns[a]), int(columns[b])
                if i // n <= j // n:  # H's blocks from the diagonal on
                    products.append((int(a), int(b), places.setdefault((i, j), len(places))))
    sizes = {
        "NPRODUCT": len(products),
        "NPLACE": len(places),
        "NFEW": sum(map(len, few)),
        "NALONE": len(torque),
        "NDENSE": len(dense),
        "NENTRY": sum(map(len, dense)),
    }
    tables: dict[str, ArrayLike] = {
        "product": products,
        "square_place": [*places],
        "few_entry": [z for entries in few for z in entries],
        "single_entry": torque,
        "dense_start": np.cumsum([0, *map(len, dense)]),
        "dense_row": [rows[entries[0]] for entries in dense],
        "dense_entry": [z for entries in dense for z in entries],
    }
    return tables_text(sizes, tables)


def contact_tables(functions: ContactFunctions, robot: Character) -> str:
    """The contacts that have a term by link, and those that the dynamics find to carry nothing
    (-1 where a term is not zero then)."""
    links, bodies = Links(robot), [robot.contacts[k].body for k in functions.spheres]
    of = np.array([links.of[body] for body in bodies], dtype=int)
    order = np.argsort(of, kind="stable")
    live = [k for k in singles_of(robot) if links.of[robot.contacts[k].body] >= 0]
    known = {k: place for place, k in enumerate([*live, *members_of(robot)])}
    resting = [
        known.get(k, -1) if rests else -1
        for k, rests in zip(functions.spheres, functions.resting, strict=True)
    ]
    start = np.searchsorted(of[order], range(len(links.first) + 1))
    tables: dict[str, ArrayLike] = {"order": order, "start": start, "resting": resting}
    return tables_text({}, {f"cost_contact_{name}": table for name, table in tables.items()})
