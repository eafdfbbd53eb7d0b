"""The GPU through CuPy: modules that NVRTC compiled once for this machine, kernels, arrays."""

from __future__ import annotations

import functools
import hashlib
import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo import cache
from octo.arrays import host
from octo.errors import DeviceError, MissingExtraError
from octo.gpu import nvrtc
from octo.gpu.device import Array, Device, Module
from octo.gpu.sequence import SWITCH, NoGraph

INSTALL = "pip install 'octo-trajopt[cuda13]' or '[cuda12]'"
UNASKED = 48 * 1024  # bytes of shared memory that a kernel may have without asking
THREAD_LOCAL = 1  # cudaStreamCaptureModeThreadLocal


@functools.cache
def reason() -> str | None:
    """Why this machine cannot solve on a GPU, in a few words; None where it can."""
    try:
        cupy = importlib.import_module("cupy")
    except Exception as error:  # besides ImportError, whatever a half-installed CUDA makes it raise
        return f"CuPy cannot be imported ({_first_line(error)}): {INSTALL}"
    try:
        count = int(cupy.cuda.runtime.getDeviceCount())
    except cupy.cuda.runtime.CUDARuntimeError as error:
        return f"there is no CUDA GPU or its driver is too old ({_first_line(error)})"
    if count == 0:
        return "there is no CUDA GPU"
    try:
        compiler = nvrtc.version()
    except MissingExtraError:
        return f"NVRTC is missing: {INSTALL}"
    driver = int(cupy.cuda.runtime.driverGetVersion()) // 1000
    if int(compiler.split(".")[0]) > driver:
        versions = f"the driver is for CUDA {driver} and NVRTC is {compiler}"
        return f"{versions}: its machine code would not load"
    return None


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0]


class CudaKernel:
    """A kernel of a cubin."""

    def __init__(self, device: CudaDevice, function: Any):
        self._device, self._function, self._shared = device, function, UNASKED

    def __call__(
        self, grid: tuple[int, ...], threads: int, *arguments: Any, shared: int = 0
    ) -> None:
        if shared > self._shared:
            self._function.max_dynamic_shared_size_bytes = shared
            self._shared = shared
        self._function(grid, (threads,), tuple(map(_argument, arguments)), shared_mem=shared)
        self._device.launched()


def _argument(value: Any) -> Any:
    """As CuPy passes it: octo's kernels take int and double, and null pointers."""
    if value is None:
        return np.uint64(0)
    if isinstance(value, float):
        return np.float64(value)
    if isinstance(value, (int, np.integer)):
        return np.int32(value)
    return value


class CudaGraph:
    """A captured sequence of ``size`` kernels; it runs on the current stream."""

    def __init__(self, device: CudaDevice, graph: Any, size: int):
        self._device, self._graph, self._size = device, graph, size

    def launch(self) -> None:
        self._graph.launch()
        self._device.counts.replayed += self._size


class CudaDevice(Device):
    """The GPU that CuPy calls current.

    Raises
    ------
    DeviceError: there is none, or something that it needs is missing.
    """

    def __init__(self) -> None:
        why = reason()
        if why is not None:
            raise DeviceError(f"device 'cuda' cannot be used: {why}; try device 'cpu'")
        super().__init__(graphs=os.environ.get(SWITCH) != "0")
        self.xp = importlib.import_module("cupy")
        gpu = self.xp.cuda.Device()
        self.architecture = f"sm_{gpu.compute_capability}"
        self.shared_limit = int(gpu.attributes["MaxSharedMemoryPerBlockOptin"])
        self.name: str = self.xp.cuda.runtime.getDeviceProperties(gpu.id)["name"].decode()

    def binary(self, text: str) -> Path:
        return cubin(text, self.architecture, self.xp.__version__)

    def load(self, text: str) -> Module:
        module = self.xp.RawModule(path=str(self.binary(text)))
        return Module(lambda name: CudaKernel(self, module.get_function(name)))

    def threads(self, wanted: int) -> int:
        return wanted

    def array(self, values: Any, dtype: Any = np.float64) -> Array:
        return self.xp.asarray(np.ascontiguousarray(values, dtype=dtype))

    def fresh(self, shape: tuple[int, ...], dtype: Any) -> Array:
        self.illegal("an allocation")
        return self.xp.empty(shape, dtype=dtype)

    def write(self, values: NDArray[Any], array: Array) -> None:
        self.illegal("a copy from the host")
        # with a stream it is asynchronous in every CuPy
        array.set(values, stream=self.xp.cuda.get_current_stream())

    def move(self, source: Array, target: Array) -> None:
        target.data.copy_from_device_async(source.data, source.nbytes)

    def host(self, array: Array) -> NDArray[Any]:
        self.illegal("a copy to the host")
        return host(array)

    def capture(self, launches: Callable[[], Any]) -> CudaGraph:
        """On a stream of its own, for the legacy default stream cannot be captured; nothing runs
        meanwhile.

        Of this thread, whatever a graph cannot hold (cudaMalloc, a synchronous copy) is refused by
        CUDA itself.
        """
        self.illegal("another capture")
        try:
            with self.xp.cuda.Stream(non_blocking=True) as stream:
                stream.begin_capture(THREAD_LOCAL)
                self.here.capturing, self.here.captured = True, 0
                try:
                    launches()
                finally:
                    self.here.capturing = False
                    # also where a launch was refused: the stream must leave the capture
                    graph = stream.end_capture()
        except (RuntimeError, NotImplementedError) as error:  # CuPy's errors of CUDA are the former
            raise NoGraph(_first_line(error)) from error
        return CudaGraph(self, graph, self.here.captured)

    def synchronize(self) -> None:
        """Wait until everything launched is done."""
        self.xp.cuda.get_current_stream().synchronize()

    def address(self, array: Array) -> int:
        return int(array.data.ptr)

    def free_bytes(self) -> int:
        """What the GPU and CuPy's pool have left."""
        free, _ = self.xp.cuda.runtime.memGetInfo()
        return int(free) + int(self.xp.get_default_memory_pool().free_bytes())


def cubin(text: str, architecture: str, cupy_version: str = "") -> Path:
    """Path of the machine code of ``text``: from the cache, by text, architecture, options and the
    versions of CuPy and NVRTC."""
    key = "\0".join((text, architecture, *nvrtc.OPTIONS, cupy_version, nvrtc.version()))
    name = f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.cubin"
    return cache.path_of(
        name, lambda path: path.write_bytes(nvrtc.compile_text(text, architecture).cubin)
    )


@functools.cache
def device() -> CudaDevice:
    """The GPU, once per process."""
    return CudaDevice()
