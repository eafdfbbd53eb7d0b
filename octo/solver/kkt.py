"""The KKT system of Eq. 12, factored once and solved many times: [[H + diag(sigma), Aᵀ], [A, 0]]
[dv; lam] = rhs.

Two ways that agree: the window elimination in compiled C (the CPU's fast way) and block cyclic
reduction over NumPy or CuPy (the paper's, and the way of a machine without a compiler).
"""

from __future__ import annotations

from typing import Literal, Protocol, get_args

import numpy as np

from octo import native
from octo.arrays import Array, array_module
from octo.errors import UnknownNameError
from octo.solver import elimination
from octo.solver.blocks import check_blocks
from octo.solver.cyclic_reduction import CyclicReductionFactor

Method = Literal["auto", "elimination", "cyclic_reduction"]
METHODS: tuple[Method, ...] = get_args(Method)


class KKTFactor(Protocol):
    """What a factored batch offers; every array has a leading batch axis.

    negative: eigenvalues or pivots that should be positive and are not (one or more where `stop`
    left early); first_bad: unit of the first one, −1 for none or unknown; usable: can solve;
    inertia_ok: the Hessian is positive definite on the null space of the constraints; residual
    (batch, count): the relative residual last computed by ``solve``.
    """

    negative: Array
    usable: Array
    inertia_ok: Array
    residual: Array

    @property
    def first_bad(self) -> Array: ...

    def solve(
        self,
        rhs_v: Array,
        rhs_c: Array | None = None,
        *,
        refine: int = 3,
        tolerance: float = 1e-10,
        check: bool = False,
    ) -> tuple[Array, Array]:
        """dv (batch, K, nc[, count]), lam (batch, K, ma[, count]) of the right-hand side (rhs_v,
        rhs_c)."""


def prepare(nc: int, ma: int, method: Method = "auto") -> None:
    """Compile the elimination for units of nc variables and ma rows, where it will be used and is
    not there yet."""
    if method != "cyclic_reduction" and native.compiler() is not None:
        elimination.library(nc, ma)


def factorize(
    H: Array,
    A: Array,
    sigma: float | Array | None = None,
    *,
    method: Method = "auto",
    stop: bool = True,
    threads: int = 1,
) -> KKTFactor:
    """Factor the KKT matrix of a batch; H (batch, K, 3, nc, nc), A (batch, K, 3, ma, nc), held by
    reference.

    sigma: None, a number, (batch,), (batch, K) or (batch, K, nc), added to the diagonal of H.
    method: "auto" takes the elimination for NumPy arrays where there is a compiler, cyclic
    reduction otherwise. stop: leave a member at its first wrong pivot (it is then not `usable`);
    cyclic reduction always goes on. threads: of the elimination, over the members of the batch; two
    for each member where there are as many.
    """
    if method not in METHODS:
        raise UnknownNameError("method", method, METHODS)
    if method == "auto":
        on_cpu = array_module(H) is np
        method = "elimination" if on_cpu and native.compiler() is not None else "cyclic_reduction"
    if method == "elimination":
        return elimination.factorize(H, A, sigma, stop=stop, threads=threads)
    check_blocks(H, A)
    return CyclicReductionFactor(H, A, sigma)
