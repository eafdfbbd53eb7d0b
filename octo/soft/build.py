"""From what a user gives to the numbers of a reduced body, made once and kept by content."""

from __future__ import annotations

import hashlib
import logging
import os
from pathlib import Path
from typing import Any

import numpy as np

from octo import cache
from octo.checks import Array
from octo.errors import ProblemError, UsageError, said
from octo.soft.material import Material
from octo.soft.model import Model
from octo.soft.read import load_mesh
from octo.soft.stvk import gram
from octo.soft.tetrahedra import Tetrahedra

LOG = logging.getLogger("octo")
ELASTICITY = ("linear", "stvk")
VERSION = 1  # of how bodies are made: what was kept by another one is made anew
SLOW = 8000  # elements; 16,800 of a beam take 200 s


def solid_of(mesh: Any, scale: float | None, edge: float | None, name: str | None) -> Tetrahedra:
    """What was given as tetrahedra."""
    if isinstance(mesh, Tetrahedra):
        if scale is not None or edge is not None:
            raise UsageError("scale and edge are of a file: a Tetrahedra has its own")
        if name is None:
            return mesh
        return Tetrahedra(mesh.nodes, mesh.cells, name=name)
    unit = 1.0 if scale is None else scale
    if isinstance(mesh, (str, os.PathLike)):
        return load_mesh(mesh, scale=unit, edge=edge, name=name)
    if not isinstance(mesh, (tuple, list)) or len(mesh) != 2:
        raise ProblemError(
            f"mesh is {said(mesh)}, must be a file's path, (points, tetrahedra) or a Tetrahedra"
        )
    if edge is not None:
        raise UsageError("edge is of a surface in a file: tetrahedra have their own")
    return Tetrahedra(mesh[0], mesh[1], unit, "mesh" if name is None else name)


def kept(solid: Tetrahedra, material: Material, count: int, law: str) -> dict[str, Array]:
    """Points, modes, inertia and eigenvalues, and the matrix of St. Venant–Kirchhoff's ``law``,
    from octo's cache where they were made before."""
    shape = solid.nodes.shape, solid.cells.shape
    key_of = repr((VERSION, material, count, law, *shape)).encode()
    parts = [np.ascontiguousarray(array).tobytes() for array in (solid.nodes, solid.cells)]
    key = hashlib.sha256(b"\0".join([key_of, *parts])).hexdigest()[:24]

    def make(path: Path) -> None:
        if len(solid.cells) > SLOW:
            LOG.warning(
                "%s has %d elements: its modes take minutes, once; %d show as much as a rule",
                *(solid.label, len(solid.cells), SLOW // 4),
            )
        model = Model(solid, material.young, material.poisson, material.density)
        arrays: dict[str, Any] = reduced(model, count, law)
        np.savez(path, **arrays)

    with np.load(cache.path_of(f"soft-{key}.npz", make)) as held:
        return dict(held)


def reduced(model: Model, count: int, law: str = "linear") -> dict[str, Array]:
    """What of a full model a body keeps.

    Parameters
    ----------
    model: a ``Model``.
    count: how many modes.
    law: of ELASTICITY.

    Returns
    -------
    points (P, 3) m from the centre of mass, modes (P, count, 3) kg^-½, inertia (3·count + 4, same)
    and values (count,) rad²/s²; of "stvk" also stvk (m, m).
    """
    values, shapes = model.modes(count)
    place = model.nodes - model.center
    spread = [place, shapes.reshape(len(place), -1), np.ones((len(place), 1))]
    every = np.concatenate(spread, axis=1)  # (n, 3r + 4), Y at the nodes
    inertia = every.T @ (model.node_mass @ every)
    used = model.mesh.surface[0]
    made = {
        "points": place[used],
        "modes": shapes[used],
        "inertia": 0.5 * (inertia + inertia.T),
        "values": values,
    }
    if law == "stvk":
        made["stvk"] = gram(model.mesh, model.material, shapes)
    return made
