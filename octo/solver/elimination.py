"""Window elimination: the KKT matrix factored unit by unit, backward in time (elimination.c), the
CPU's fast way.

With two threads for a problem one of them comes forward in time to meet the other. The answer is
then the same up to rounding; with any other number of threads it is the same to the last bit.

A unit's constraint rows are solved for as many of its variables as they have rank; what is left of
the Hessian is eliminated by Cholesky, so its pivots are those of the Hessian on the null space of
the constraints. Hence the inertia: the KKT matrix has K·ma negative eigenvalues, and no more,
exactly when all those pivots are positive.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo import native
from octo.errors import DeviceError, ShapeError
from octo.solver.blocks import check_blocks

Floats = NDArray[np.float64]
# K·nc² from which two threads for one problem save more than starting the second costs
SHARED_WORK = 40_000
# bytes, from which the C library is asked to give back what it keeps of them too: that takes
# milliseconds
_MUCH = 2**24
_trim: Any = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's
_POOLED = 4  # memories kept for the next factorisation of the same shape


def _signatures() -> dict[str, tuple[Any, list[Any]]]:
    """What the C functions return and take."""
    P, N, D, size = ctypes.c_void_p, ctypes.c_int, ctypes.c_double, ctypes.c_ssize_t
    problem = [*[N] * 4, *[P] * 3, N]  # sizes, then H, A and sigma
    return {
        **dict.fromkeys(("octo_unit_bytes", "octo_window_bytes", "octo_unit_room"), (size, [])),
        **dict.fromkeys(("octo_receding_bytes", "octo_normal_bytes"), (size, [])),
        "octo_scratch_room": (size, [size]),
        "octo_factor_batch": (None, [*problem, N, *[P] * 4]),
        "octo_solve_batch": (None, [*problem, *[P] * 3, N, P, P, N, D, N, *[P] * 4]),
        "octo_receding_start": (None, [P, N, N, *[P] * 7]),
        "octo_receding_eliminate": (N, [P, N, N, P, P]),
        "octo_receding_solve": (None, [P] * 3),
        "octo_receding_gain": (None, [P] * 2),
        "octo_normal_factor": (None, [*[N] * 3, *[P] * 3]),
        "octo_normal_solve": (None, [*[N] * 3, *[P] * 3, N, P, N, *[P] * 3]),
    }


@functools.cache
def library(nc: int, ma: int) -> ctypes.CDLL | None:
    """The compiled elimination for units of nc variables and ma rows; None without a compiler."""
    folder = importlib.resources.files(__package__)
    names = ("companion.c", "elimination.c", "elimination_solve.c", "receding.c", "normal.c")
    parts = [(folder / name).read_text(encoding="utf-8") for name in names]
    made = native.load("\n".join([native.threads(), *parts]), (f"-DNC={nc}", f"-DMA={ma}"))
    if made is None:
        return None
    for name, (returned, taken) in _signatures().items():
        if ma or not name.startswith("octo_normal_"):  # without rows there is no AAᵀ
            function = getattr(made, name)
            function.restype, function.argtypes = returned, taken
    return made


def aligned(doubles: int) -> Floats:
    """Uninitialised float64 memory on a 64-byte boundary."""
    raw = np.empty(doubles + 8)
    skip = (-raw.ctypes.data % 64) // 8
    return raw[skip : skip + doubles]


def _split(batch: int, threads: int, K: int, nc: int) -> int:
    """Units that a second thread eliminates from the front, where there are two threads for each
    problem; else 0."""
    return (K - 2) // 2 if threads >= 2 * batch and K >= 8 and K * nc * nc >= SHARED_WORK else 0


class Memory:
    """What a factor is stored in; reused, because first touching megabytes costs as much as
    factoring."""

    def __init__(self, made: ctypes.CDLL, batch: int, K: int, threads: int):
        self.units = aligned((made.octo_unit_bytes() * batch * K + 7) // 8)
        self.store = aligned(made.octo_unit_room() * batch * K)
        self.windows = aligned(made.octo_window_bytes() // 8 * 2 * threads)
        self.scratch_room: int = made.octo_scratch_room(K) * threads
        self.at = [address(array) for array in (self.units, self.store, self.windows)]
        self._scratch: Floats | None = None

    def scratch(self, count: int) -> int:
        """Address of the solves' scratch for `count` right-hand sides."""
        if self._scratch is None or self._scratch.size < self.scratch_room * count:
            self._scratch = aligned(self.scratch_room * count)
        return address(self._scratch)


# changed by single operations: threads, and what ends in any of them, share it
_pool: dict[tuple[int, ...], list[Memory]] = {}


def _pooled(key: tuple[int, ...]) -> Memory | None:
    """A memory that no factor is stored in."""
    try:
        return _pool[key].pop()
    except (KeyError, IndexError):
        return None


def release() -> None:
    """Give back the memories that are kept for the next factorisation: at the end of a solve there
    is none."""
    kept = [memory for free in list(_pool.values()) for memory in list(free)]
    _pool.clear()
    much = sum(memory.units.nbytes + memory.store.nbytes for memory in kept) > _MUCH
    if much and _trim is not None:
        _trim(0)


def address(array: NDArray) -> int:
    """Where the array's numbers are; a fifth of the time of ``array.ctypes.data``."""
    return int(array.__array_interface__["data"][0])


class EliminationFactor:
    """A factored batch. Holds H, A and sigma by reference: they must not change while it is used.

    negative (batch,): non-positive pivots met; first_bad (batch,): the unit of the first one (with
    two threads a problem: of one of them), -1 for none; dependent (batch,): constraint rows that
    depend on others (their multiplier is 0); usable (batch,): can solve.
    """

    def __init__(
        self, H: Floats, A: Floats, sigma: Floats | None, *, stop: bool = True, threads: int = 1
    ):
        batch, K, _, nc, _ = H.shape
        made = library(nc, A.shape[3])
        if made is None:
            raise DeviceError(
                "the window elimination needs a C compiler; use the method 'cyclic_reduction'"
            )
        self.shape = (batch, K, nc, int(A.shape[3]))
        self._library, self._key = made, (*self.shape, threads)
        self._sizes = (batch, threads, K, _split(batch, threads, K, nc))
        self._held = (H, A, sigma)
        self._memory = _pooled(self._key) or Memory(made, batch, K, threads)
        weights = (None, 0) if sigma is None else (address(sigma), int(sigma.ndim == 3))
        self._problem = (address(H), address(A), *weights)
        self._verdict = verdict = np.empty((batch, 4), dtype=np.int32)
        made.octo_factor_batch(
            *self._sizes, *self._problem, int(stop), *self._memory.at, address(verdict)
        )
        self.negative, self.first_bad, self.dependent = verdict[:, 0], verdict[:, 1], verdict[:, 2]
        self.usable = verdict[:, 3] != 0
        self.inertia_ok: NDArray[np.bool_] = self.usable & (self.negative == 0)
        self.residual: Floats = np.full((batch, 1), np.nan)

    def __del__(self) -> None:
        if hasattr(self, "_memory"):
            free = _pool.setdefault(self._key, [])
            if len(free) < _POOLED:
                free.append(self._memory)
            for key in list(_pool)[: -2 * _POOLED]:
                _pool.pop(key, None)

    def solve(
        self,
        rhs_v: Floats,
        rhs_c: Floats | None = None,
        *,
        refine: int = 3,
        tolerance: float = 1e-10,
        check: bool = False,
    ) -> tuple[Floats, Floats]:
        """dv (batch, K, nc[, count]), lam (batch, K, ma[, count]) of KKT [dv; lam] = [rhs_v;
        rhs_c].

        rhs_c None is zero. At most `refine` refinements, while the relative residual exceeds
        `tolerance` (each wins four digits or more: Nodes rarely needs one, Hermite one or two);
        `residual` (batch, count) is then the last one computed, that of the answer itself with
        `check`. A member that is not `usable` gets NaN.
        """
        batch, K, nc, ma = self.shape
        count = rhs_v.shape[3] if rhs_v.ndim == 4 else 1
        rhs_v = _checked("rhs_v", rhs_v, (batch, K, nc, count))
        if rhs_c is not None:
            rhs_c = _checked("rhs_c", rhs_c, (batch, K, ma, count))
        dv, lam = np.empty(rhs_v.shape), np.empty((batch, K, ma, *rhs_v.shape[3:]))
        self.residual = np.full((batch, count), np.nan)
        rhs = (address(rhs_v), None if rhs_c is None else address(rhs_c))
        self._library.octo_solve_batch(
            *(*self._sizes, *self._problem, *self._memory.at[:2], address(self._verdict)),
            *(count, *rhs, refine, tolerance, int(check)),
            *(self._memory.scratch(count), address(dv), address(lam), address(self.residual)),
        )
        return dv, lam


def _checked(name: str, array: Floats, shape: tuple[int, ...]) -> Floats:
    if array.shape != shape and array.shape != shape[:3]:
        raise ShapeError(name, array.shape, shape)
    return np.ascontiguousarray(array, dtype=np.float64)


def factorize(
    H: Floats,
    A: Floats,
    sigma: float | Floats | None = None,
    *,
    stop: bool = True,
    threads: int = 1,
) -> EliminationFactor:
    """Factor [[H + diag(sigma), Aᵀ], [A, 0]]; H (batch, K, 3, nc, nc), A (batch, K, 3, ma, nc).

    sigma: None, a number, (batch,), (batch, K) or (batch, K, nc). With `stop` a member is left at
    its first non-positive pivot (its unit is `first_bad`); without, they are counted and the factor
    can still solve.
    """
    H, A = np.ascontiguousarray(H, dtype=np.float64), np.ascontiguousarray(A, dtype=np.float64)
    check_blocks(H, A)
    if sigma is not None:
        weight = np.asarray(sigma, dtype=np.float64)
        if weight.ndim < 2:
            weight = np.broadcast_to(weight.reshape(-1, 1), H.shape[:2])
        if weight.shape not in (H.shape[:2], (*H.shape[:2], H.shape[3])):
            raise ShapeError("sigma", weight.shape, "(batch, K) or (batch, K, nc)")
        sigma = np.ascontiguousarray(weight)
    return EliminationFactor(H, A, sigma, stop=stop, threads=threads)
