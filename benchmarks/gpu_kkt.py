"""The KKT matrices of a walk, factored by octo's kernels in float64 and in float32, by CuPy's
libraries, and as one dense matrix.

``python benchmarks/gpu.py`` measures them on a GPU. ``PYTHONPATH=. python benchmarks/gpu_kkt.py``
says on the CPU, where the same kernels are executed, what accuracy each has: what float32 with
residuals and refinement in float64 reaches.
"""

from __future__ import annotations

import argparse
import importlib
import json
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import octo
from octo.arrays import host
from octo.gpu.device import source
from octo.gpu.linear import Reduction, sizes
from octo.problem.compiled import CompiledProblem, Model
from octo.solver import sqp
from octo.solver.backend import Backend
from octo.solver.blocks import SBT, interleave
from octo.solver.cyclic_reduction import ROUNDING, SHIFT, ReducedSBT, _equilibration
from octo.solver.factors import HostFactors
from octo.solver.options import SqpOptions
from octo.starts import first_nodes

TOLERANCE = 1e-10  # of a solution's relative residual, as in the solver
REFINEMENTS = 10
SINGLE = (1e-6, 1e-4)  # in the place of ROUNDING and SHIFT in float32, whose digits are 6e-8
DENSE = 12000  # unknowns up to which the whole matrix is factored as one


@dataclass(frozen=True)
class System:
    """A KKT system that a solve has used, the scale (1, D, B) that equilibrates it, and its
    right-hand side (1, D, B, 1)."""

    matrix: SBT
    scale: Any
    rhs: Any
    constraints: int

    @property
    def equilibrated(self) -> SBT:
        s = self.scale
        diagonal = self.matrix.diagonal * s[..., :, None] * s[..., None, :]
        return SBT(diagonal, self.matrix.lower * s[:, 1:, :, None] * s[:, :-1, None, :])

    def condition(self) -> float:
        """‖M‖₂ ‖M⁻¹‖₂ of the equilibrated matrix, by iteration: from below."""
        matrix, v = self.equilibrated, np.random.default_rng(0).standard_normal(self.rhs.shape)
        reduced = ReducedSBT(matrix, 0)
        sizes = []
        for times in (matrix.times, reduced.solve):
            w = v
            for _ in range(40):
                w = times(w / np.linalg.norm(w))
            sizes.append(float(np.linalg.norm(w)))
        return sizes[0] * sizes[1]


class _Recording(Backend):
    """The CPU's backend; keeps the systems whose inertia is right."""

    def __init__(self) -> None:
        self.systems: list[System] = []

    def factors(
        self, problem: CompiledProblem, model: Model, at: Any, lam: Any, options: SqpOptions
    ) -> HostFactors:
        keep, blocks = self.systems, self.blocks(model)

        class Recorded(HostFactors):
            def add(self, members: Any, weight: Any) -> Any:
                good = super().add(members, weight)
                if good[0]:
                    matrix = blocks.sbt(np.asarray(weight))
                    rhs = interleave(-blocks.b[..., None], -blocks.C[..., None])
                    keep.append(System(matrix, _equilibration(matrix), rhs, problem.K * problem.ma))
                return good

        return Recorded(blocks, lam, options, problem.threads)


def systems(problem: octo.Problem, iterations: int) -> list[System]:
    """Of a solve of one problem on the CPU, the last one of each iteration."""
    compiled, recording = CompiledProblem([problem]), _Recording()
    compiled.prepare()
    nodes = first_nodes(problem, 0, None)[None]
    sqp.run(
        compiled,
        compiled.unknowns(nodes),
        None,
        SqpOptions(max_iterations=iterations),
        None,
        recording,
    )
    return recording.systems


def reduction_text(B: int, dtype: Any, shared: int) -> str:
    """The CUDA text of the reduction of blocks of B, in float64 or in float32."""
    kernels = source("reduction.cu").replace("NAME_BLOCK", str(B)).replace("NAME", "kkt")
    text = "\n".join(
        [sizes(B // 2, 0, shared), *map(source, ("common.cuh", "pivots.cu", "linear.cu")), kernels]
    )
    if np.dtype(dtype) == np.float64:
        return text
    text = re.sub(r"\bdouble\b", "float", text)
    return re.sub(r"(?<![\w.])(\d+\.\d*(?:e[-+]?\d+)?)(?![\w.])", r"\1f", text)


class _Kernels:
    """What ``Reduction`` asks of ``Linear``, for blocks of B: the kernels in float64 or in
    float32."""

    def __init__(self, device: Any, B: int, dtype: Any):
        self._device, self._B, self._dtype = device, B, np.dtype(dtype)
        self._kernel = device.module(reduction_text(B, dtype, device.shared_limit)).kernel
        self.device, self.shared_limit = self, device.shared_limit

    def threads(self, wanted: int) -> int:
        return int(self._device.threads(wanted))

    def empty(self, shape: tuple[int, ...], dtype: Any = None) -> Any:
        return self._device.empty(shape, self._dtype if dtype is None else dtype)

    def each(
        self, name: str, grid: tuple[int, ...], *arguments: Any, threads: int = 256, shared: int = 0
    ) -> None:
        own = [self._dtype.type(a) if isinstance(a, float) else a for a in arguments]
        # in float32 half the room, but for PIVOT_BYTES' integers
        room = shared if self._dtype == np.float64 else shared // 2 + 512 + 12 * self._B
        self._kernel(name)(grid, self._device.threads(threads), *own, shared=room)


class _Library:
    """Block cyclic reduction with a library's batched inverses and products: cuBLAS' getrf, getri
    and gemm. No inertia."""

    def __init__(self, xp: Any, diagonal: Any, lower: Any):
        self._xp, self._levels = xp, []
        while diagonal.shape[1] > 1:
            lead = 1 - diagonal.shape[1] % 2
            inverse = xp.linalg.inv(diagonal[:, 1 - lead :: 2])
            left, right = lower[:, lead::2], xp.swapaxes(lower[:, 1 - lead :: 2], -1, -2)
            to_left, to_right = inverse[:, lead:] @ left, inverse @ right
            self._levels.append((lead, inverse, left, right))
            diagonal = diagonal[:, lead::2].copy()
            diagonal[:, : left.shape[1]] -= xp.swapaxes(left, -1, -2) @ to_left
            diagonal[:, 1 - lead :] -= xp.swapaxes(right, -1, -2) @ to_right
            lower = -(xp.swapaxes(right[:, lead:], -1, -2) @ to_left)
        self._last = xp.linalg.inv(diagonal)

    def solve(self, r: Any) -> Any:
        xp, held = self._xp, []
        for lead, inverse, left, right in self._levels:
            w = inverse @ r[:, 1 - lead :: 2]
            held.append(w)
            r = r[:, lead::2].copy()
            r[:, : left.shape[1]] -= xp.swapaxes(left, -1, -2) @ w[:, lead:]
            r[:, 1 - lead :] -= xp.swapaxes(right, -1, -2) @ w
        x = self._last @ r
        for (lead, inverse, left, right), w in zip(
            reversed(self._levels), reversed(held), strict=True
        ):
            reach = right @ x[:, 1 - lead :]
            reach[:, lead:] += left @ x[:, : left.shape[1]]
            both = xp.empty((x.shape[0], x.shape[1] + w.shape[1], *x.shape[2:]), dtype=x.dtype)
            both[:, lead::2] = x
            both[:, 1 - lead :: 2] = w - inverse @ reach
            x = both
        return x


class _Dense:
    """The whole matrix at once: the library's LU, cuSOLVER's getrf and getrs in CuPy."""

    def __init__(self, xp: Any, diagonal: Any, lower: Any):
        self._linalg = importlib.import_module("scipy.linalg" if xp is np else "cupyx.scipy.linalg")
        batch, D, B, _ = diagonal.shape
        whole = xp.zeros((batch, D, B, D, B), dtype=diagonal.dtype)
        for k in range(D):
            whole[:, k, :, k] = diagonal[:, k]
            if k:
                whole[:, k, :, k - 1] = lower[:, k - 1]
                whole[:, k - 1, :, k] = xp.swapaxes(lower[:, k - 1], -1, -2)
        self._xp = xp
        self._factors = [self._linalg.lu_factor(one) for one in whole.reshape(batch, D * B, D * B)]

    def solve(self, r: Any) -> Any:
        flat = r.reshape(r.shape[0], -1, r.shape[3])
        parts = [self._linalg.lu_solve(*pair) for pair in zip(self._factors, flat, strict=True)]
        return self._xp.stack(parts).reshape(r.shape)


def ways(device: Any) -> dict[str, tuple[Any, Callable[[Any, Any], Any]]]:
    """By name the type of the numbers, and what makes of (diagonal, lower) something with
    ``solve``."""

    def octos(dtype: Any, rounding: float, shift: float) -> Callable[[Any, Any], Any]:
        made: dict[int, _Kernels] = {}

        def factor(diagonal: Any, lower: Any) -> Reduction:
            B = int(diagonal.shape[-1])
            if B not in made:
                made[B] = _Kernels(device, B, dtype)
            return Reduction(made[B], "kkt", diagonal, lower, rounding, shift)

        return factor

    xp = device.xp
    return {
        "octo": (np.float64, octos(np.float64, ROUNDING, SHIFT)),
        "octo_float32": (np.float32, octos(np.float32, *SINGLE)),
        "inverses": (np.float64, lambda diagonal, lower: _Library(xp, diagonal, lower)),
        "inverses_float32": (np.float32, lambda diagonal, lower: _Library(xp, diagonal, lower)),
        "eigenvalues": (np.float64, lambda diagonal, lower: ReducedSBT(SBT(diagonal, lower), 0)),
        "dense": (np.float64, lambda diagonal, lower: _Dense(xp, diagonal, lower)),
    }


def accuracy(
    device: Any, system: System, dtype: Any, factor: Callable[[Any, Any], Any]
) -> dict[str, Any]:
    """Relative residuals in float64 after 0, 1, … refinements, the backward error without one, and
    the inertia."""
    equal = system.equilibrated
    reduced = factor(device.array(equal.diagonal, dtype), device.array(_some(equal.lower), dtype))
    x, left, size = np.zeros(system.rhs.shape), system.rhs, np.abs(system.rhs).max()
    residuals, backward = [], np.nan
    for step in range(REFINEMENTS + 1):
        scaled = left * system.scale[..., None]
        top = np.abs(scaled).max() or 1.0
        more = host(reduced.solve(device.array(scaled / top, dtype))).astype(float)
        x = x + top * more * system.scale[..., None]
        left = system.rhs - system.matrix.times(x)
        residuals.append(float(np.abs(left).max() / size))
        if step == 0:
            rows = np.abs(system.matrix.diagonal).sum(axis=3)
            backward = float(np.abs(left).max() / (rows.max() * np.abs(x).max() + size))
        if not np.isfinite(residuals[-1]) or residuals[-1] < 1e-15:
            break
    made: dict[str, Any] = {
        "residuals": residuals,
        "backward_error": backward,
        "refinements": refinements(residuals),
    }
    if isinstance(reduced, Reduction):
        made["wrong_inertia"] = bool(int(host(reduced.counts)[:, :, 0].sum()) != system.constraints)
    return made


def _some(lower: Any) -> Any:
    """At least one block: a kernel is not given an empty array."""
    return lower if lower.shape[1] else np.zeros((lower.shape[0], 1, *lower.shape[2:]))


def refinements(residuals: list[float]) -> int | None:
    """How many it takes to TOLERANCE; None: it is not reached."""
    return next((k for k, value in enumerate(residuals) if value <= TOLERANCE), None)


def along(device: Any, found: list[System], names: tuple[str, ...]) -> list[dict[str, Any]]:
    """The accuracy of some ways on each system of a solve."""
    table, rows = ways(device), []
    for system in found:
        row: dict[str, Any] = {"condition": system.condition()}
        for name in names:
            dtype, factor = table[name]
            row[name] = _tried(
                lambda dtype=dtype, factor=factor, one=system: accuracy(device, one, dtype, factor)
            )
        rows.append(row)
    return rows


def milliseconds(device: Any, system: System, batch: int, repeats: int) -> dict[str, Any]:
    """ms of one factorisation and of one solution of ``batch`` copies of a system by each way, or
    why it cannot be had."""
    equal, unknowns = system.equilibrated, system.rhs.shape[1] * system.rhs.shape[2]

    def timed(dtype: Any, factor: Callable[[Any, Any], Any]) -> dict[str, float]:
        parts = (equal.diagonal, _some(equal.lower), system.rhs)
        diagonal, lower, rhs = (
            device.array(np.repeat(part, batch, axis=0), dtype) for part in parts
        )
        times = []
        for _ in range(repeats + 1):  # the first one warms up
            fresh = diagonal.copy()
            device.synchronize()
            began = time.perf_counter()
            reduced = factor(fresh, lower)
            device.synchronize()
            factored = time.perf_counter()
            reduced.solve(rhs)
            device.synchronize()
            times.append((factored - began, time.perf_counter() - factored))
        middle = 1e3 * np.median(times[1:], axis=0)
        return {"factor_ms": float(middle[0]), "solve_ms": float(middle[1])}

    chosen = {
        name: way
        for name, way in ways(device).items()
        if name != "dense" or unknowns * batch <= DENSE
    }
    return {name: _tried(lambda way=way: timed(*way)) for name, way in chosen.items()}


def _tried(call: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What is measured, or why it is not: CuPy finds no cuBLAS or no cuSOLVER, or a singular block
    has no inverse."""
    try:
        return call()
    except (ImportError, RuntimeError, np.linalg.LinAlgError) as error:
        return {"why_not": str(error).strip().split("\n")[0]}


def measure(device: Any, problem: octo.Problem, short: bool) -> dict[str, Any]:
    """What benchmarks/gpu.py writes of one problem."""
    found = systems(problem, 3 if short else 30)
    names = tuple(name for name in ways(device) if name != "dense")
    rows = along(device, found[:: max(1, len(found) // 3)], names)
    batches = (1, 2) if short else (1, 64)
    times = {
        str(batch): milliseconds(device, found[-1], batch, 1 if short else 10) for batch in batches
    }
    return {"blocks": list(found[-1].rhs.shape[1:3]), "accuracy": rows, "milliseconds": times}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=40, help="of the mammal's walk (default 40)")
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--every", type=int, default=1, help="every so many systems of a solve")
    parser.add_argument("--basis", choices=("nodes", "hermite"), default="nodes")
    parser.add_argument("--json", action="store_true", help="everything, not the summary")
    arguments = parser.parse_args()
    robot, basis = octo.gallery.mammal(), arguments.basis
    problem = octo.Problem(
        robot, steps=arguments.steps, dt=0.025, costs=octo.costs.paper(), basis=basis
    )
    names = ("octo", "octo_float32", "inverses_float32")
    from tests.emulator import EmulatedDevice  # with PYTHONPATH=. alone

    rows = along(
        EmulatedDevice(), systems(problem, arguments.iterations)[:: arguments.every], names
    )
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    conditions = np.array([row["condition"] for row in rows])
    print(
        f"{len(rows)} systems, condition {conditions.min():.1e} to {conditions.max():.1e}, "
        f"median {np.median(conditions):.1e}"
    )
    for name in names:
        parts = [row[name] for row in rows if "residuals" in row[name]]
        took = [part["refinements"] for part in parts]
        counts = {k: took.count(k) for k in sorted({k for k in took if k is not None})}
        first = np.median([part["residuals"][0] for part in parts])
        best = max(min(part["residuals"]) for part in parts)
        print(
            f"{name}: {len(parts)} systems; refinements to {TOLERANCE:g} {counts}, not reached "
            f"{took.count(None)}; wrong inertia "
            f"{sum(part.get('wrong_inertia', False) for part in parts)}; residual without any, "
            f"median {first:.1e}, "
            f"the best of the worst system {best:.1e}"
        )


if __name__ == "__main__":
    main()
