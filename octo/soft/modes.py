"""The lowest modes of a free body: eigenvectors of its stiffness, without its rigid motions."""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any

import numpy as np
import scipy.linalg
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh, splu

from octo.checks import Array, whole
from octo.errors import ModelError, ValueRangeError
from octo.files import reason

RIGID = 6
SMALL = 600  # coordinates, of a model whose eigenvectors are found as those of a dense matrix
MORE = 4  # modes beyond those asked for: several of one frequency are then found together
SHIFT = 1e-3  # of E/(ρL²), below zero: what is factored is positive definite
NONE = 1e-9  # of E/(ρL²): an eigenvalue that is none; the lowest of a beam of 1 : 1000 is 4e-5
ALIKE = 1e-6  # relative, of eigenvalues that are one


def lowest(
    stiffness: Any, mass: Any, nodes: Array, count: int, label: str = "mesh"
) -> tuple[Array, Array]:
    """The lowest elastic modes of a free body.

    Their signs, and which of several modes of one frequency come first, follow from the shape
    alone: a mode goes along with the polynomial of the place (of degree 2 or 3) that it is most
    like.

    Parameters
    ----------
    stiffness, mass: (3n, 3n) N/m and kg, sparse.
    nodes: (n, 3) m.
    count: how many.
    label: what messages call the mesh.

    Returns
    -------
    (count,) rad²/s², ascending, and (3n, count) kg^-½, of which products with the mass are 1 and 0.

    Raises
    ------
    ValueRangeError: more modes than the mesh has. ModelError: parts that hang together at a point
    or an edge only, which move without a force.
    """
    size = 3 * len(nodes)
    whole("modes", count)
    if count > size - RIGID:
        raise ValueRangeError(
            f"modes is {count}, must be at most {size - RIGID}: {label} has {len(nodes)} nodes of "
            f"3 coordinates, less {RIGID} rigid motions"
        )
    unit = _unit(stiffness, mass, nodes)
    found = min(count + MORE, size - RIGID)
    values, vectors = _pairs(stiffness, mass, found + RIGID, SHIFT * unit, label)
    still = int((values < NONE * unit).sum())
    if still > RIGID:
        raise ModelError(
            f"{label} moves in {still} ways without a force, where a body has {RIGID}: parts of it "
            "hang together at a point or an edge only"
        )
    rigid = rigid_motions(mass, nodes)
    vectors = vectors[:, np.argsort(np.square(rigid.T @ (mass @ vectors)).sum(axis=0))[:found]]
    vectors -= rigid @ (rigid.T @ (mass @ vectors))
    small = vectors.T @ (stiffness @ vectors), vectors.T @ (mass @ vectors)
    values, turn = scipy.linalg.eigh(*(0.5 * (part + part.T) for part in small))
    vectors = _settled(values, vectors @ turn, mass, nodes)
    return values[:count], np.ascontiguousarray(vectors[:, :count])


def rigid_motions(mass: Any, nodes: Array) -> Array:
    """(3n, 6) kg^-½, three translations and three rotations, products with the mass 1 and 0."""
    moved = np.tile(np.eye(3), (len(nodes), 1, 1))
    turned = np.cross(np.eye(3), (nodes - nodes.mean(axis=0))[:, None])  # (n, 3 axes, 3)
    both = np.concatenate([moved, turned], axis=1).transpose(0, 2, 1).reshape(-1, RIGID)
    for _ in range(2):  # once more for the rounding of the first time
        lower = np.linalg.cholesky(both.T @ (mass @ both))
        both = scipy.linalg.solve_triangular(lower, both.T, lower=True).T
    return np.asarray(both)


def _unit(stiffness: Any, mass: Any, nodes: Array) -> float:
    """About E/(ρL²) (1/s²): what a stretch by the same strain everywhere has."""
    span = nodes - nodes.mean(axis=0)
    stretch = np.ravel(span * np.eye(3)[np.argmax(np.ptp(nodes, axis=0))])
    return float((stretch @ (stiffness @ stretch)) / (stretch @ (mass @ stretch)))


def _pairs(stiffness: Any, mass: Any, count: int, shift: float, label: str) -> tuple[Array, Array]:
    """The lowest eigenvalues (count,) and vectors, rigid ones included."""
    size = stiffness.shape[0]
    if size <= SMALL or 3 * count >= size:
        within = (0, count - 1)
        dense = stiffness.toarray(), mass.toarray()
        values, vectors = scipy.linalg.eigh(*dense, subset_by_index=within)
        return values, vectors
    inverse = factors(stiffness + shift * mass)
    operator = LinearOperator(stiffness.shape, matvec=inverse.solve, dtype=float)
    start = np.random.default_rng(0).standard_normal(size)
    given = {"M": mass, "sigma": -shift, "OPinv": operator, "v0": start, "maxiter": 100 * count}
    try:
        values, vectors = eigsh(stiffness, k=count, **given)
    except ArpackNoConvergence as error:
        raise ModelError(f"{label} has modes that were not found: {reason(error)}") from error
    order = np.argsort(values)
    return values[order], vectors[:, order]


def factors(matrix: Any) -> Any:
    """SuperLU of a sparse matrix that is symmetric and positive definite: without pivots, and in
    the order for such."""
    return splu(
        matrix.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def _settled(values: Array, vectors: Array, mass: Any, nodes: Array) -> Array:
    """The vectors with their signs settled, and turned among those of one eigenvalue."""
    fields = _fields(nodes)
    fields /= np.sqrt(np.einsum("ij,ij->j", fields, mass @ fields))
    fields *= 0.99 ** np.arange(fields.shape[1])  # of two that are as like, the first
    like = vectors.T @ (mass @ fields)  # (k, fields)
    made = np.empty_like(vectors)
    starts = np.flatnonzero(np.diff(values, prepend=-np.inf) > ALIKE * np.abs(values))
    for first, end in zip(starts, [*starts[1:], len(values)], strict=True):
        left, group = like[first:end].copy(), vectors[:, first:end]
        for k in range(first, end):
            most = left[:, np.argmax(np.square(left).sum(axis=0))]
            way = most / np.linalg.norm(most)
            made[:, k] = group @ way
            left -= np.outer(way, way @ left)
    return made


def _fields(nodes: Array) -> Array:
    """(3n, 51) displacements that are products of two and three coordinates along each axis, and
    three without any symmetry, for modes that are like none of those."""
    place = nodes - nodes.mean(axis=0)
    place = place / np.abs(place).max()
    terms = [
        np.prod(place[:, list(axes)], axis=1)
        for degree in (2, 3)
        for axes in combinations_with_replacement(range(3), degree)
    ]
    noise = np.random.default_rng(1).standard_normal((3 * len(nodes), 3))
    along = np.einsum("kn,ab->nbka", np.array(terms), np.eye(3)).reshape(3 * len(nodes), -1)
    return np.concatenate([along, noise], axis=1)
