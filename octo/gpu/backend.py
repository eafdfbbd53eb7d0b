"""The solver's backend on a device: products, factorisations and projections by kernels."""

from __future__ import annotations

from typing import Any

from octo.gpu.device import Array, Device
from octo.gpu.linear import DeviceBlocks, DeviceFactor, DeviceNormal, Linear
from octo.problem.compiled import Model
from octo.solver.backend import Backend
from octo.solver.options import SqpOptions


class DeviceBackend(Backend):
    """What ``sqp.run`` asks of a device. ``linear_solver`` and ``threads`` are the CPU's: here it is cyclic reduction always."""

    name = "cuda"

    def __init__(self, device: Device):
        self.device = device
        self._linear: dict[tuple[int, int], Linear] = {}

    def linear(self, nc: int, ma: int) -> Linear:
        """The kernels for units of nc variables and ma rows, compiled when first asked for."""
        if (nc, ma) not in self._linear:
            self._linear[nc, ma] = Linear(self.device, nc, ma)
        return self._linear[nc, ma]

    def blocks(self, model: Model) -> DeviceBlocks:
        return DeviceBlocks(model.H, model.A, model.b, model.C, self._of(model.A))

    def factorize(self, H: Array, A: Array, sigma: Any, options: SqpOptions, threads: int) -> DeviceFactor:
        return DeviceFactor(self._of(A), H, A, self.device.array(sigma))

    def normal(self, A: Array, threads: int = 1) -> Any:
        return DeviceNormal(self._of(A), A)

    def _of(self, A: Array) -> Linear:
        return self.linear(int(A.shape[4]), int(A.shape[3]))
