"""What octo's device code is written against: arrays, modules of kernels, launches. CUDA is one,
the CPU stands in for it.

A kernel's arguments are device arrays, None (a null pointer), Python ints (int) and floats
(double).
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from octo.errors import DeviceError
from octo.gpu.sequence import Counts, Graph, Here, NoGraph, Workspace

Array = Any  # an array of the device
LOG = logging.getLogger("octo")
WIDE = 256  # threads of a block


class Kernel(Protocol):
    """One ``__global__`` function."""

    def __call__(
        self, grid: tuple[int, ...], threads: int, *arguments: Any, shared: int = 0
    ) -> None:
        """Launch ``grid`` blocks (up to three numbers) of ``threads`` threads with ``shared`` bytes
        of shared memory."""


class Module:
    """A compiled text; ``make`` finds a kernel by its name."""

    def __init__(self, make: Callable[[str], Kernel]):
        self.kernel = functools.cache(make)


class Device(Protocol):
    """Where arrays live and kernels run."""

    xp: Any  # the array module: numpy's functions
    shared_limit: int  # bytes of shared memory a block may have
    graphs: bool  # whether sequences of launches are captured
    counts: Counts
    here: Here
    module: Callable[[str], Module]  # ``load``, once for each text

    def __init__(self, graphs: bool):
        self.graphs, self.counts, self.here = graphs, Counts(), Here()
        self.module = functools.cache(self.load)

    def binary(self, text: str) -> Path:
        """Compile CUDA text, or take it from the cache: where its machine code is."""

    def load(self, text: str) -> Module:
        """A compiled text and its kernels."""

    def compile(self, texts: Sequence[str]) -> None:
        """Compile texts side by side, into the cache."""
        with ThreadPoolExecutor() as pool:
            list(pool.map(self.binary, texts))

    def launched(self) -> None:
        """Count one kernel."""
        if self.here.capturing:
            self.here.captured += 1
        else:
            self.counts.launches += 1

    def threads(self, wanted: int) -> int:
        """Threads of a block: what the caller wishes, or what this device has."""

    def array(self, values: Any, dtype: Any = np.float64) -> Array:
        """A contiguous copy on the device."""

    def fresh(self, shape: tuple[int, ...], dtype: Any) -> Array:
        """Uninitialised memory of its own."""

    def empty(self, shape: tuple[int, ...], dtype: Any = np.float64) -> Array:
        """Uninitialised memory; within a sequence, what it had there the time before."""
        workspace = self.here.workspace
        return self.fresh(shape, dtype) if workspace is None else workspace.empty(shape, dtype)

    @contextmanager
    def within(self, workspace: Workspace) -> Iterator[None]:
        """``empty`` takes from ``workspace``."""
        before, self.here.workspace = self.here.workspace, workspace
        workspace.begin()
        try:
            yield
        finally:
            self.here.workspace = before

    def capture(self, launches: Callable[[], Any]) -> Graph:
        """What ``launches`` launches, recorded and not run; raises NoGraph where that is
        refused."""

    def illegal(self, what: str) -> None:
        """Refuse what a capture cannot hold."""
        if self.here.capturing:
            raise DeviceError(f"{what} while a sequence is captured: it would not be in the graph")

    def without_graphs(self, why: NoGraph) -> None:
        """Launch one by one from now on, and say so."""
        self.graphs = False
        LOG.warning("no CUDA graphs, kernels are launched one by one: %s", why)

    def write(self, values: NDArray[Any], array: Array) -> None:
        """Host ``values`` into an array of the device. The host does not wait."""

    def copy(self, source: Array, target: Array) -> None:
        """One contiguous array of the device into another of its shape and type. The host does not
        wait."""
        self.illegal("a copy")
        same = source.shape == target.shape and source.dtype == target.dtype
        if not (same and source.flags.c_contiguous and target.flags.c_contiguous):
            what = f"{source.dtype} {source.shape}", f"{target.dtype} {target.shape}"
            raise TypeError(f"{what[0]} cannot be copied to {what[1]} as it lies in memory")
        self.move(source, target)

    def move(self, source: Array, target: Array) -> None:
        """``copy`` of what is the same piece of memory for both."""

    def synchronize(self) -> None:
        """Wait until everything launched is done."""

    def address(self, array: Array) -> int:
        """Where an array is, for kernels."""

    def free_bytes(self) -> int:
        """Memory that is left."""

    def host(self, array: Array) -> NDArray[Any]:
        """A copy on the host: waits for the device."""


class Kernels:
    """The kernels of a text, and how they are launched."""

    def __init__(self, device: Device, text: str):
        self.device, self.text, self._module = device, text, device.module(text)

    def kernel(self, name: str) -> Kernel:
        return self._module.kernel(name)

    def each(
        self,
        name: str,
        grid: tuple[int, ...],
        *arguments: Any,
        threads: int = WIDE,
        shared: int = 0,
    ) -> None:
        """A kernel over the blocks of a grid."""
        self.kernel(name)(grid, self.device.threads(threads), *arguments, shared=shared)

    def flat(self, name: str, count: int, *arguments: Any, threads: int = WIDE) -> None:
        """A kernel over ``count`` things, one a thread."""
        blocks = min(-(-count // self.device.threads(threads)), 65535)
        self.each(name, (blocks,), count, *arguments, threads=threads)


def source(name: str) -> str:
    """The text of one of octo's .cu or .cuh files."""
    return (resources.files("octo.gpu") / name).read_text(encoding="utf-8")
