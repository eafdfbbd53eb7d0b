"""The full finite-element model of a soft body, from which its few modes are taken."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from octo.checks import Array, numbers, room
from octo.errors import ProblemError, ValueRangeError
from octo.soft.assembly import assembled
from octo.soft.material import Material
from octo.soft.modes import factors, lowest
from octo.soft.tetrahedra import Tetrahedra

GRAVITY = (0.0, 0.0, -9.81)  # m/s²
FILL = 15.0  # doubles to the 1.5th power of the coordinates: the factors of beams up to 75,000
LINE = 1e-6  # m, off a line: nodes that lie on it


@dataclass(frozen=True, eq=False)
class Model:
    """Quadratic finite elements of linear elasticity, all coordinates of all nodes.

    Parameters
    ----------
    mesh: a ``Tetrahedra``.
    young: Pa, Young's modulus.
    poisson: Poisson's ratio.
    density: kg/m³.

    Raises
    ------
    ValueRangeError: a material that is out of range. ProblemError: a mesh too large for this
        machine's memory. MissingExtraError, when it is first used: scikit-fem is not installed.
    """

    mesh: Tetrahedra
    young: float
    poisson: float
    density: float

    def __post_init__(self) -> None:
        if not isinstance(self.mesh, Tetrahedra):
            raise ProblemError("mesh of a soft model must be a Tetrahedra")
        _ = self.material  # checked
        size = 3.0 * len(self.mesh.nodes)
        room(f"factors of {self.mesh.label} with {len(self.mesh.cells)} elements", FILL * size**1.5)

    @cached_property
    def _matrices(self) -> tuple[Any, Any]:
        return assembled(self.mesh, self.material)

    @property
    def material(self) -> Material:
        """What it is made of."""
        return Material(self.young, self.poisson, self.density)

    @property
    def nodes(self) -> Array:
        """(n, 3) m."""
        return self.mesh.nodes

    @property
    def stiffness(self) -> Any:
        """(3n, 3n) N/m, sparse: x, y, z of the first node, then those of the second."""
        return self._matrices[0]

    @property
    def node_mass(self) -> Any:
        """(n, n) kg, sparse: the consistent mass of one coordinate."""
        return self._matrices[1]

    @cached_property
    def mass(self) -> Any:
        """(3n, 3n) kg, sparse: that of all three."""
        return sp.csr_array(sp.kron(self.node_mass, sp.eye_array(3)))

    @cached_property
    def center(self) -> Array:
        """(3,) m, the centre of mass."""
        weight = np.asarray(self.node_mass.sum(axis=0)).ravel()
        return np.asarray(weight @ self.nodes / weight.sum())

    def modes(self, count: int) -> tuple[Array, Array]:
        """The lowest modes of the free body.

        Parameters
        ----------
        count: how many.

        Returns
        -------
        (count,) rad²/s² and (n, count, 3) kg^-½ at the nodes.
        """
        values, vectors = lowest(self.stiffness, self.mass, self.nodes, count, self.mesh.label)
        return values, vectors.reshape(-1, 3, count).transpose(0, 2, 1)

    def sag(self, fixed: ArrayLike, acceleration: ArrayLike = GRAVITY) -> Array:
        """Displacements (n, 3) m at rest under its own weight, some nodes held.

        Parameters
        ----------
        fixed: (k,) numbers of the nodes that are held, or (n,) True where they are.
        acceleration: (3,) m/s², of gravity.
        """
        weights = np.repeat(np.asarray(self.node_mass.sum(axis=1)).reshape(-1, 1), 3, axis=1)
        pull = np.ravel(weights * numbers("acceleration", acceleration, (3,)))
        free = np.flatnonzero(~np.repeat(self._held(fixed), 3))
        moved = np.zeros(len(pull))
        moved[free] = factors(self.stiffness[free][:, free]).solve(pull[free])
        return moved.reshape(-1, 3)

    def _held(self, fixed: ArrayLike) -> NDArray[np.bool_]:
        """(n,) whether a node is held."""
        given, n = numbers("fixed", fixed), len(self.nodes)
        held = np.zeros(n, dtype=bool)
        if np.asarray(fixed).dtype == bool and given.shape == (n,):
            held |= given > 0.0
        elif given.ndim == 1 and not (given % 1.0).any() and ((given >= 0) & (given < n)).all():
            held[given.astype(np.int64)] = True
        else:
            raise ValueRangeError(f"fixed must be numbers of nodes, whole ones from 0 to {n - 1}")
        off = self.nodes[held] - self.nodes[held].sum(axis=0) / max(held.sum(), 1)
        if len(off) < 3 or np.linalg.svd(off, full_matrices=False)[1][1] < LINE:
            raise ProblemError("fixed must be three nodes at least, not on one line: it would turn")
        return held
