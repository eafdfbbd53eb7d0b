"""The solver's backend on a device: products, factorisations and projections by kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.errors import DeviceError
from octo.gpu.device import Array, Device
from octo.gpu.linear import DeviceBlocks, DeviceFactor, DeviceNormal, Linear
from octo.gpu.problem import DeviceProblem, bytes_of
from octo.problem.compiled import CompiledProblem, Model
from octo.solver.backend import Backend
from octo.solver.blocks import KKTBlocks
from octo.solver.options import SqpOptions


class DeviceBackend(Backend):
    """What ``sqp.run`` asks of a device. ``linear_solver`` and ``threads`` are the CPU's: here it is cyclic reduction always.

    timed: seconds by stage mean something, because every stage is waited for.
    """

    name = "cuda"

    def __init__(self, device: Device, timed: bool = False):
        self.device, self.timed = device, timed
        self._linear: dict[tuple[int, int], Linear] = {}
        self._last: DeviceProblem | None = None

    def place(self, problem: CompiledProblem) -> DeviceProblem:
        """``problem`` on the device; one with the same generated code shares what was compiled for the one before.

        Raises
        ------
        DeviceError: the device has too little memory, or the robot is too large for its shared memory.
        """
        if self._last is not None:
            self._last.release()  # before what is free is measured: the passes of a solve come one after another
        last = self._last if self._last is not None and self._last.host.functions is problem.functions else None
        self._check_memory(problem)
        self._last = DeviceProblem(problem, self.device, last)
        return self._last

    def _check_memory(self, problem: CompiledProblem) -> None:
        each, free = bytes_of(problem), self.device.free_bytes()
        if each * problem.batch > free:
            raise DeviceError(
                f"{problem.batch} problems of {each / 1e6:.0f} MB need {each * problem.batch / 1e9:.2g} GB, "
                f"the GPU has {free / 1e9:.2g} GB free: solve {max(1, free // each)} at a time"
            )

    def array(self, values: NDArray[np.float64] | None) -> Array | None:
        return None if values is None else self.device.array(values)

    def prepare(self, problem: CompiledProblem, options: SqpOptions) -> None:
        """Compiles every kernel, or takes it from the cache."""
        self.place(problem)
        self.linear(problem.nc, problem.ma)

    def finish(self) -> None:
        if self.timed:
            self.device.synchronize()

    def linear(self, nc: int, ma: int) -> Linear:
        """The kernels for units of nc variables and ma rows, compiled when first asked for."""
        if (nc, ma) not in self._linear:
            self._linear[nc, ma] = Linear(self.device, nc, ma)
        return self._linear[nc, ma]

    def blocks(self, model: Model) -> DeviceBlocks:
        return DeviceBlocks(model.H, model.A, model.b, model.C, self._of(model.A))

    def step_numbers(self, blocks: KKTBlocks, delta: Array, lam: Array) -> tuple[Any, Any, Any]:
        units = self.device.host(self._of(blocks.A).step_numbers(blocks.A, blocks.b, delta, lam))
        return units[:, :, 0], units[:, :, 1].max(axis=1), units[:, :, 2].sum(axis=1)

    def factorize(self, H: Array, A: Array, sigma: Any, options: SqpOptions, threads: int) -> DeviceFactor:
        return DeviceFactor(self._of(A), H, A, self.device.array(sigma))

    def normal(self, A: Array, threads: int = 1) -> Any:
        return DeviceNormal(self._of(A), A)

    def _of(self, A: Array) -> Linear:
        return self.linear(int(A.shape[4]), int(A.shape[3]))
