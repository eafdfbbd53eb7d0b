"""Sequences of launches between two copies to the host: run one by one at first, then captured in a
CUDA graph and replayed.

A graph holds addresses. So what a sequence reads and writes stays where it is: numbers that change
from run to run are in arrays, and everything it allocates in its first run is what it finds in
every later one (``Workspace``).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from octo.errors import DeviceError

T = TypeVar("T")
SWITCH = "OCTO_GPU_GRAPH"  # "0" in the environment: every kernel is launched on its own


class NoGraph(Exception):
    """Why a driver or CuPy refuses to capture."""


class Graph(Protocol):
    """What was captured."""

    def launch(self) -> None: ...


@dataclass(eq=False)
class Counts:
    """What a device was asked for: kernels launched one by one, kernels that graphs launched,
    launches of graphs, captures."""

    launches: int = 0
    replayed: int = 0
    graphs: int = 0
    captures: int = 0
    capture_seconds: float = 0.0


class Here(threading.local):
    """What a thread is doing with a device: solves in several threads share it."""

    def __init__(self) -> None:
        self.workspace: Workspace | None = None
        self.capturing = False
        self.captured = 0  # kernels of the sequence that is being captured


class Workspace:
    """Arrays in the order in which a sequence asks for them: the same ones in every run."""

    def __init__(self, device: Any):
        self._device, self._arrays, self._next = device, list[Any](), 0

    def begin(self) -> None:
        self._next = 0

    def empty(self, shape: tuple[int, ...], dtype: Any) -> Any:
        if self._next == len(self._arrays):
            self._device.illegal("an allocation")
            self._arrays.append(self._device.fresh(shape, dtype))
        array = self._arrays[self._next]
        if array.shape != tuple(map(int, shape)) or array.dtype != dtype:
            raise DeviceError(
                f"a sequence asked for {shape} where it had {array.shape}: its launches must not "
                "change"
            )
        self._next += 1
        return array


class Sequence(Generic[T]):
    """``launches`` over fixed arrays, and what it returns: the same arrays every time; ``plain``
    ones are never captured, for they also reckon with arrays of their own."""

    def __init__(self, device: Any, launches: Callable[[], T], plain: bool = False):
        self._device, self._launches, self._workspace = device, launches, Workspace(device)
        self._plain = plain
        self._graph: Graph | None = None
        self._made: T
        self._ran = False

    def __call__(self) -> T:
        """The first run compiles and allocates; the second is captured, where the device has
        graphs."""
        device = self._device
        if self._graph is None and self._ran and device.graphs and not self._plain:
            began = time.perf_counter()
            try:
                self._graph = device.capture(self._run)
                device.counts.captures += 1
                device.counts.capture_seconds += time.perf_counter() - began
            except NoGraph as why:
                device.without_graphs(why)
        if self._graph is None:
            self._made, self._ran = self._run(), True
        else:
            self._graph.launch()
            device.counts.graphs += 1
        return self._made

    def _run(self) -> T:
        with self._device.within(self._workspace):
            return self._launches()
