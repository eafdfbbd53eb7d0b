"""One iteration of Algorithm 1 for a receding horizon, with nothing but the C entry points between
two measurements.

The trajectory is the problem's in the basis Nodes, with x_{-1} and x_0 as two units more that are
measured, not solved for. The step FD_i touches x_{i-1}, x_i, x_{i+1}, so all that the measurement
enters are the steps 0 and 1: the others are linearised and eliminated before it arrives (Diehl,
Bock and Schlöder 2005, real-time iteration), and what is left is exact.
"""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.errors import DeviceError
from octo.problem.basis import Nodes
from octo.problem.compiled import CompiledProblem
from octo.problem.native_steps import task_of
from octo.solver import elimination
from octo.solver.elimination import address, aligned
from octo.solver.regularisation import FLOOR, GROW

PAST = 2  # units that are measured
RETRIES = 12  # factors of GROW on sigma until exact curvature has the right inertia


class RecedingHorizon:
    """Linearise, factor and solve one problem over and over in memory that is allocated once.

    Parameters
    ----------
    compiled: one problem in the basis Nodes. Its p and q are read at every call: changing them in
        place changes the problem.

    Attributes
    ----------
    nodes: (N+2, n) rad and m, x_{-1}, x_0 … x_N: where the model is taken. The caller writes it.
    fd: (N, n) N m or N, FD at ``nodes``. terms: (N, terms), of E. C: (N, m), scaled; of the last
        :meth:`evaluate`.
    rows: (N, rows) of the terms that are bounded, of the last :meth:`evaluate`.
    step: (N, n) rad and m, of the last :meth:`solve`, of x_1 … x_N. lam: (N, m), its multipliers.
    sigma: (1,) the regularisation weight.
    """

    def __init__(self, compiled: CompiledProblem, sigma: float = 1e-6):
        library = compiled.library
        nodes = isinstance(compiled.basis, Nodes)
        one = nodes and compiled.batch == 1 and not compiled.ends.any()
        if library is None or not one:
            raise DeviceError(
                "a receding horizon needs a C compiler, the basis 'nodes' and one problem with a "
                "free end"
            )
        self.compiled, self._library = compiled, library
        N, n, m = compiled.steps, compiled.n, compiled.m
        K = N + PAST
        self.steps, self.sigma = N, np.array([sigma])
        self.nodes, self.fd = np.zeros((N + 2, n)), np.zeros((N, n))
        self.terms = np.zeros((N, len(compiled.functions.references.terms)))
        self.rows = np.zeros((N, len(compiled.functions.bounded)))
        self._H = aligned(K * 3 * n * n)
        self._A = aligned(max(K * 3 * m * n, 1))
        self._b = np.zeros((K, n))
        self._C = np.zeros((K, max(m, 1)))
        self._lam = np.zeros((K, m))
        self._step = np.zeros((K, n))
        self._residual = np.zeros((K, max(m, 1)))
        self.step, self.lam, self.C = self._step[PAST:], self._lam[PAST:], self._residual[PAST:, :m]
        self.guess = np.zeros((K, m))  # multipliers that exact curvature is taken at
        self._weights = np.zeros(K)
        self._task, self._kept = self._make_task(N)  # of two chunks
        self._task_at = ctypes.addressof(self._task)
        library.octo_join_parts.argtypes = [ctypes.c_void_p]
        for function in (library.octo_linearize_part, library.octo_evaluate):
            function.argtypes = [ctypes.c_void_p, ctypes.c_int]
        self._prepare_factor(K, n, m)

    def _make_task(self, N: int) -> tuple[ctypes.Structure, list[NDArray]]:
        """octo_task with every node a unit, in two chunks: the steps 0 and 1, which see the
        measurement, and the others."""
        compiled = self.compiled
        count = N + PAST
        unit = np.arange(count, dtype=np.int32)
        chunks = [np.array(v, dtype=np.int32) for v in ([0, PAST, N], [0, 2 * PAST], [0, 2 * PAST])]
        if N <= PAST:
            raise DeviceError(f"steps is {N}, must be at least {PAST + 1} for a receding horizon")
        tables: list[NDArray] = [
            *chunks,
            *(unit, np.zeros(count, np.int32), np.ones(count)),
            *(unit[PAST:].copy(), np.zeros(N, np.int32), np.ones(N)),
        ]
        n, m = compiled.n, compiled.m
        halo = np.zeros((2, 6 * n * n + 3 * m * n + 2 * n + m))
        task = task_of(
            (1, N, count, 1, 1, n, m, 2), tables, (compiled.p, compiled.q, compiled.row_scale), halo
        )
        task.nodes, task.fd = self.nodes.ctypes.data, self.fd.ctypes.data
        task.h, task.a, task.b = (array.ctypes.data for array in (self._H, self._A, self._b))
        return task, [*tables, halo]

    def _prepare_factor(self, K: int, n: int, m: int) -> None:
        made = elimination.library(n, m)
        assert made is not None
        self._factor_library = made
        self._memory = elimination.Memory(made, 1, K, 1)
        self._state = np.zeros(made.octo_receding_bytes() // 8 + 1)
        self._state_at = address(self._state)
        blocks = (address(array) for array in (self._H, self._A, self._weights))
        memory = (*self._memory.at, self._memory.scratch(1))
        made.octo_receding_start(self._state_at, K, PAST, *blocks, *memory)
        self._at = {name: address(getattr(self, f"_{name}")) for name in ("b", "C", "step", "lam")}
        self._gain = np.zeros((n, 2 * n))
        # the units behind the measured steps stand eliminated, and nothing after them
        self._ahead = False

    @property
    def energy(self) -> float:
        """E at the last :meth:`evaluate`."""
        return float(self.terms.sum())

    def prepare(self, exact: bool = False) -> bool:
        """What does not depend on x_0 and x_{-1}; with ``exact`` the curvature at ``guess`` too.
        False: wrong inertia."""
        if exact:
            self.evaluate()
        self._linearize(1, exact)
        self._weights[:] = self.sigma[0] + FLOOR
        self._ahead = self._eliminate(self.steps + PAST - 1, 2 * PAST)
        return self._ahead

    def feedback(self, exact: bool = False, usable: bool = True) -> bool:
        """The rest, and ``step`` and ``lam``. False: there is no factor with a sensible weight.

        Once more after the same :meth:`prepare`, it eliminates every unit anew.

        Parameters
        ----------
        usable: what :meth:`prepare` returned.
        """
        if exact:
            self.evaluate()
        self._linearize(0, exact)
        self._library.octo_join_parts(self._task_at)
        last = self.steps + PAST - 1
        done = usable and self._eliminate(2 * PAST - 1 if self._ahead else last, PAST)
        self._ahead = False
        for _ in range(RETRIES):
            if done or not exact:
                break
            self.sigma *= GROW
            self._weights[:] = self.sigma[0] + FLOOR
            done = self._eliminate(last, PAST)
        if done:
            found = (self._at["step"], self._at["lam"])
            self._factor_library.octo_receding_solve(self._state_at, *found)
        return done

    def _linearize(self, chunk: int, exact: bool) -> None:
        task = self._task
        task.lam = address(self.guess) if exact else None
        task.terms, task.c = None, self._at["C"]
        if self._library.octo_linearize_part(self._task_at, chunk):
            raise MemoryError("octo_linearize could not allocate its work arrays")

    def _eliminate(self, first: int, last: int) -> bool:
        at = (self._state_at, first, last, self._at["b"], self._at["C"])
        return bool(self._factor_library.octo_receding_eliminate(*at))

    def evaluate(self) -> None:
        """``fd``, ``terms`` and ``C`` at ``nodes``."""
        task = self._task
        task.terms, task.c = address(self.terms), address(self._residual)
        task.rows = address(self.rows) if self.rows.size else None
        self._library.octo_evaluate(self._task_at, 1)

    def evaluate_first(self) -> None:
        """The same of the steps 0 and 1 alone, which see the measurement."""
        self._task.chunks = 1
        self.evaluate()
        self._task.chunks = 2

    def gain(self) -> Array:
        """(n, 2n) the derivative of the next x_1 with respect to (x_0, x_{-1}), of the last
        factor."""
        self._factor_library.octo_receding_gain(self._state_at, address(self._gain))
        return self._gain
