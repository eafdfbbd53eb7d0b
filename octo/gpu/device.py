"""What octo's device code is written against: arrays, modules of kernels, launches. CUDA is one,
the CPU stands in for it.

A kernel's arguments are device arrays, None (a null pointer), Python ints (int) and floats
(double).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from importlib import resources
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from octo.gpu.sequence import Counts, Graph, NoGraph, Workspace

Array = Any  # an array of the device


class Kernel(Protocol):
    """One ``__global__`` function."""

    def __call__(
        self, grid: tuple[int, ...], threads: int, *arguments: Any, shared: int = 0
    ) -> None:
        """Launch ``grid`` blocks (up to three numbers) of ``threads`` threads with ``shared`` bytes
        of shared memory."""


class Module(Protocol):
    """A compiled text."""

    def kernel(self, name: str) -> Kernel: ...


class Device(Protocol):
    """Where arrays live and kernels run."""

    xp: Any  # the array module: numpy's functions
    shared_limit: int  # bytes of shared memory a block may have
    graphs: bool  # whether sequences of launches are captured
    counts: Counts

    def module(self, text: str) -> Module:
        """Compile CUDA text, or take it from the cache."""

    def compile(self, texts: Sequence[str]) -> None:
        """Compile texts side by side, into the cache."""

    def threads(self, wanted: int) -> int:
        """Threads of a block: what the caller wishes, or what this device has."""

    def array(self, values: Any, dtype: Any = np.float64) -> Array:
        """A contiguous copy on the device."""

    def empty(self, shape: tuple[int, ...], dtype: Any = np.float64) -> Array:
        """Uninitialised memory; within a sequence, what it had there the time before."""

    def within(self, workspace: Workspace) -> AbstractContextManager[None]:
        """``empty`` takes from ``workspace``."""

    def capture(self, launches: Callable[[], Any]) -> Graph:
        """What ``launches`` launches, recorded and not run; raises NoGraph where that is
        refused."""

    def without_graphs(self, why: NoGraph) -> None:
        """Launch one by one from now on, and say so."""

    def write(self, values: NDArray[Any], array: Array) -> None:
        """Host ``values`` into an array of the device. The host does not wait."""

    def copy(self, source: Array, target: Array) -> None:
        """One contiguous array of the device into another of its shape and type. The host does not
        wait."""

    def synchronize(self) -> None:
        """Wait until everything launched is done."""

    def free_bytes(self) -> int:
        """Memory that is left."""

    def host(self, array: Array) -> NDArray[Any]:
        """A copy on the host: waits for the device."""


def source(name: str) -> str:
    """The text of one of octo's .cu or .cuh files."""
    return (resources.files("octo.gpu") / name).read_text(encoding="utf-8")
