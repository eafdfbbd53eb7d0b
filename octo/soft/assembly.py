"""Mass and stiffness of tetrahedra, by scikit-fem.

Elements are quadratic: those of four nodes bend far too stiffly. A clamped beam, 20 times as long
as high, in 30 × 2 × 2 blocks sags by 45 % of what beam theory says with those, and by 99.4 % with
quadratic ones, which follow curved surfaces too, as a ball's.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import scipy.sparse as sp

from octo.errors import MissingExtraError
from octo.soft.material import Material
from octo.soft.tetrahedra import Tetrahedra
from octo.world.spline import Indices

# Products of two shape functions have degree 4, and the determinant of a curved element has 3: its
# mass is exact. Of scikit-fem 12 the points of order 8 are the first that integrate degree 7: from
# order 5 on they hold one degree less than they say. A straight one's stiffness has degree 2.
MASS_ORDER, STIFFNESS_ORDER = 8, 4


def library(name: str, what: str) -> Any:
    """A library of the extra ``soft``, which ``what`` needs."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise MissingExtraError(what, "soft") from None


def assembled(mesh: Tetrahedra, material: Material) -> tuple[Any, Any]:
    """The stiffness (3n, 3n) N/m of the nodes' coordinates, x y z of the first node before those of
    the second; and the mass (n, n) kg of one coordinate, which is that of all three. Both sparse.
    """
    skfem = library("skfem", "a soft body")
    shape, order = placed(skfem, mesh)
    back = np.argsort(order)

    def basis(degree: int) -> Any:
        return skfem.Basis(shape, skfem.ElementTetP2(), intorder=degree)

    fine, coarse = basis(MASS_ORDER), basis(STIFFNESS_ORDER)

    def products(a: int, b: int) -> Any:
        """(n, n) ∫ ∂N_i/∂x_a ∂N_j/∂x_b."""
        form = skfem.BilinearForm(lambda u, v, w: v.grad[a] * u.grad[b])
        return form.assemble(coarse)[back][:, back]

    mass = skfem.BilinearForm(lambda u, v, w: u * v).assemble(fine)[back][:, back]
    slopes = {(a, b): products(a, b) for a in range(3) for b in range(a, 3)}
    slopes |= {(b, a): slopes[a, b].T for a, b in [(0, 1), (0, 2), (1, 2)]}
    lame, shear = material.lame
    both = shear * (slopes[0, 0] + slopes[1, 1] + slopes[2, 2])
    blocks = [
        [
            lame * slopes[a, b] + shear * slopes[b, a] + (both if a == b else 0.0 * both)
            for b in range(3)
        ]
        for a in range(3)
    ]
    stiffness = sp.csr_array(sp.block_array(blocks))
    n = len(mesh.nodes)
    inner = np.arange(3 * n).reshape(3, n).T.ravel()  # node by node
    return stiffness[inner][:, inner], sp.csr_array(material.density * mass)


def placed(skfem: Any, mesh: Tetrahedra) -> tuple[Any, Indices]:
    """The mesh as scikit-fem has it, and which of the nodes each of its own is."""
    corners, own = np.unique(mesh.cells[:, :4], return_inverse=True)
    straight = skfem.MeshTet1(
        np.ascontiguousarray(mesh.nodes[corners].T), np.ascontiguousarray(own.reshape(-1, 4).T)
    )
    places = np.concatenate([straight.t, len(corners) + straight.t2e])  # (10, E)
    order = np.empty(len(mesh.nodes), dtype=np.int64)
    order[places.ravel()] = mesh.cells.T.ravel()
    nodes = np.ascontiguousarray(mesh.nodes[order].T)
    return skfem.MeshTet2(nodes, straight.t), order
