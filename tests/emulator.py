"""octo's CUDA kernels executed on the CPU, from the text that NVRTC compiles: POSIX threads for
CUDA threads.

For tests, and to find mistakes without a GPU: it is strict where CUDA is silent. Types, shapes and
contiguity of the arguments are checked, shared and fresh global memory is NaN until it is written.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import re
import shutil
import threading
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo import cache, native
from octo.arrays import host
from octo.errors import DeviceError
from octo.gpu.device import Device, Module

WORDS = Path(__file__).with_name("cuda_on_cpu.h")  # CUDA's, for a C++ compiler
# most kernels compile for longer than they run, so -O0; those of the linear solver run longer
FLAGS = ("-std=c++17", "-O0", "-march=native", "-fno-math-errno", "-fPIC", "-w", "-pthread")
OF_THE_LINEAR_SOLVER = tuple("-O1" if flag == "-O0" else flag for flag in FLAGS)
KERNEL = re.compile(r"__global__\s+void\s+(?:__launch_bounds__\([^)]*\)\s*)?(\w+)\s*\(")
LETTERS = {"d": np.dtype(np.float64), "f": np.dtype(np.float32), "i": np.dtype(np.int32)}
NUMBERS: dict[str, tuple[tuple[type, ...], Any]] = {  # what a kernel may be given by value
    "d": ((float,), ctypes.c_double),
    "f": ((np.float32,), ctypes.c_float),
    "i": ((int, np.integer), ctypes.c_int),
}
SHARED_LIMIT = 227 * 1024  # bytes, of compute capability 9.0


@functools.cache
def compiler() -> str | None:
    """Path of a C++ compiler, None when there is none."""
    return next((path for name in ("g++", "c++", "clang++") if (path := shutil.which(name))), None)


def program(text: str) -> str:
    """The C++ text of a module: CUDA's words, the module, one entry for each kernel."""
    entries = [f"CUDA_ON_CPU_ENTRY({name})" for name in KERNEL.findall(text)]
    return "\n".join([WORDS.read_text(encoding="utf-8"), text, *entries, ""])


def compile_program(text: str, flags: tuple[str, ...], suffix: str) -> Path:
    """The path of what C++ ``text`` becomes, from the cache where it is there."""
    words = compiler()
    if words is None:
        raise DeviceError(
            "no C++ compiler (g++, c++ or clang++): octo's kernels cannot be run on the CPU"
        )
    known = "\0".join((text, *flags, words, native.machine()))
    key = hashlib.sha256(known.encode()).hexdigest()[:24]

    def make(path: Path) -> None:
        written = path.with_name("octo.cpp")
        written.write_text(text, encoding="utf-8")
        native.run_compiler([words, *flags, "-o", str(path), str(written)], path.parent)

    return cache.path_of(f"{key}{suffix}", make)


class Launch(ctypes.Structure):
    """cuda_on_cpu_launch."""

    _fields_ = [
        ("grid", ctypes.c_uint * 3),
        ("threads", ctypes.c_uint),
        ("shared", ctypes.c_ulong),
        ("crews", ctypes.c_uint),
    ]


class EmulatedKernel:
    """A kernel that the CPU executes."""

    def __init__(self, device: EmulatedDevice, library: ctypes.CDLL, text: str, name: str):
        self.device, self.text, self.name = device, text, name
        self._launch = getattr(library, f"launch_of_{name}")
        describe = getattr(library, f"signature_of_{name}")
        describe.restype = ctypes.c_char_p
        self.signature: str = describe().decode()

    def __call__(
        self, grid: tuple[int, ...], threads: int, *arguments: Any, shared: int = 0
    ) -> None:
        limit, wanted = self.device.shared_limit, len(self.signature)
        if len(arguments) != wanted:
            raise TypeError(f"{self.name} has {wanted} arguments, got {len(arguments)}")
        if shared > limit:
            raise ValueError(f"{self.name}: {shared} bytes of shared memory, a block has {limit}")
        if not 0 < threads <= 1024 or min(grid) < 1 or max(grid[1:], default=1) > 65535:
            raise ValueError(f"{self.name}: grid {grid} of {threads} threads is not legal")
        values = [self._value(k, argument) for k, argument in enumerate(arguments)]
        sizes = (*grid, 1, 1)[:3]
        launch = Launch((ctypes.c_uint * 3)(*sizes), threads, shared, self.device.crews)
        self.device.launched()
        if self.device.here.capturing:
            self.device.recording.append(Recorded(self, launch, values, arguments))
        else:
            self.run(launch, values, arguments)

    def run(self, launch: Launch, values: list[Any], arguments: tuple[Any, ...]) -> None:
        """``values`` are what C is given: numbers, and where the arrays are."""
        if self.device.recorder is not None:
            plain = self.device.plain
            arrays = [a if a is None or np.isscalar(a) else plain(a) for a in arguments]
            self.device.recorder(self, launch, arrays)
        addresses = (ctypes.c_void_p * len(values))(*map(ctypes.addressof, values))
        with self.device.lock:  # blockDim and gridDim are one of a library
            self._launch(ctypes.byref(launch), addresses)

    def _value(self, place: int, argument: Any) -> Any:
        letter, where = self.signature[place], f"argument {place} of {self.name}"
        if letter.islower():
            kind, number = NUMBERS[letter]
            if not isinstance(argument, kind):  # CUDA would read other bits
                raise TypeError(f"{where} is {argument!r}, must be a {kind[0].__name__}")
            return number(argument)
        if argument is None:
            return ctypes.c_void_p(None)
        array = self.device.plain(argument)
        if array.dtype != LETTERS[letter.lower()]:
            raise TypeError(f"{where} has type {array.dtype}, must be {LETTERS[letter.lower()]}")
        if not array.flags.c_contiguous:
            raise TypeError(f"{where} is not contiguous")
        return ctypes.c_void_p(array.ctypes.data)


class Recorded:
    """A launch in a graph: it has the addresses of its arrays, and does not keep them. One that is
    gone when the graph runs is a mistake that a GPU would not notice."""

    def __init__(
        self, kernel: EmulatedKernel, launch: Launch, values: list[Any], arguments: tuple[Any, ...]
    ):
        self._kernel, self._launch, self._values = kernel, launch, values
        self._arguments = arguments if kernel.device.recorder is not None else ()
        arrays = [kernel.device.plain(a) for a in arguments if a is not None and not np.isscalar(a)]
        self._memory = [weakref.ref(_memory(array)) for array in arrays]

    def __call__(self) -> None:
        if any(memory() is None for memory in self._memory):
            raise DeviceError(f"a graph launches {self._kernel.name} on an array that is gone")
        self._kernel.run(self._launch, self._values, self._arguments)


def _memory(array: NDArray[Any]) -> NDArray[Any]:
    """The array that owns the memory of a view."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


class EmulatedGraph:
    """Launches of one sequence, replayed."""

    def __init__(self, device: EmulatedDevice, launches: list[Recorded]):
        self._device, self._launches = device, launches

    def launch(self) -> None:
        self._device.illegal("the launch of a graph")
        for launch in self._launches:
            launch()
        self._device.counts.replayed += len(self._launches)


class EmulatedDevice(Device):
    """The CPU in the place of a GPU.

    Parameters
    ----------
    threads: of every block, whatever the caller wishes. crews: blocks at the same time.
    xp: the array module; NumPy, or one that is stricter: its ``capturing`` says when its functions
        must not be called.
    recorder: called with (kernel, launch, arguments) before every launch.
    graphs: sequences are captured and replayed, as on a GPU.
    """

    def __init__(
        self,
        threads: int = 1,
        crews: int = 1,
        xp: Any = np,
        recorder: Any = None,
        graphs: bool = True,
    ):
        super().__init__(graphs)
        self._threads, self.crews, self.xp, self.recorder = threads, crews, xp, recorder
        self.shared_limit = SHARED_LIMIT
        self.memory = 2**62
        self.lock = threading.RLock()
        self.recording: list[Recorded] = []

    def binary(self, text: str) -> Path:
        flags = OF_THE_LINEAR_SOLVER if "octo_kkt_pivots" in KERNEL.findall(text) else FLAGS
        return compile_program(program(text), (*flags, "-shared"), ".so")

    def load(self, text: str) -> Module:
        library = ctypes.CDLL(str(self.binary(text)))
        return Module(lambda name: EmulatedKernel(self, library, text, name))

    def threads(self, wanted: int) -> int:
        return self._threads

    def array(self, values: Any, dtype: Any = np.float64) -> Any:
        self.illegal("an allocation")
        return self.xp.array(np.array(values, dtype=dtype, order="C"))

    def fresh(self, shape: tuple[int, ...], dtype: Any) -> Any:
        self.illegal("an allocation")
        fill: Any = np.nan if np.dtype(dtype).kind == "f" else -(2**31) + 7
        return self.xp.full(shape, fill, dtype=dtype)

    def write(self, values: NDArray[Any], array: Any) -> None:
        self.illegal("a copy from the host")
        plain = self.plain(array)
        if (values.shape, values.dtype) != (plain.shape, plain.dtype):  # CuPy refuses both
            raise TypeError(
                f"{values.dtype} {values.shape} cannot be written to {plain.dtype} {plain.shape}"
            )
        plain[...] = values

    def move(self, source: Any, target: Any) -> None:
        self.plain(target)[...] = self.plain(source)

    def capture(self, launches: Callable[[], Any]) -> EmulatedGraph:
        """As CUDA's: launches are recorded and not run. What CUDA refuses then, or would do wrong
        in silence, raises."""
        self.illegal("another capture")
        strict = None if self.xp is np else self.xp
        with self.lock:
            self.recording, self.here.capturing = [], True
            if strict is not None:
                strict.capturing = True
            try:
                launches()
            finally:
                self.here.capturing = False
                if strict is not None:
                    strict.capturing = False
            return EmulatedGraph(self, self.recording)

    def synchronize(self) -> None:
        """Nothing is ever under way."""
        self.illegal("waiting for the device")

    def address(self, array: Any) -> int:
        return int(array.ctypes.data)

    def free_bytes(self) -> int:
        return self.memory

    def host(self, array: Any) -> NDArray[Any]:
        self.illegal("a copy to the host")
        return np.array(host(array))  # also where both are NumPy's: what lies on a device changes

    @staticmethod
    def plain(array: Any) -> NDArray[Any]:
        """The NumPy array behind a device array."""
        return array if isinstance(array, np.ndarray) else array.get_view()
