"""Sequences of launches between two copies to the host: run one by one at first, then captured in a
CUDA graph and replayed.

A graph holds addresses. So what a sequence reads and writes stays where it is: numbers that change
from run to run are in arrays, and everything it allocates in its first run is what it finds in
every later one (``Workspace``).
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from octo.errors import DeviceError

T = TypeVar("T")
LOG = logging.getLogger("octo")
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


class Sequenced:
    """The part of a device that runs sequences. graphs: whether they are captured."""

    def __init__(self, graphs: bool):
        self.graphs, self.counts, self.here = graphs, Counts(), Here()

    def launched(self) -> None:
        """Count one kernel."""
        if self.here.capturing:
            self.here.captured += 1
        else:
            self.counts.launches += 1

    def fresh(self, shape: tuple[int, ...], dtype: Any) -> Any:
        """Uninitialised memory of its own."""
        raise NotImplementedError

    def capture(self, launches: Callable[[], Any]) -> Graph:
        """What ``launches`` launches, recorded and not run; raises NoGraph where that is
        refused."""
        raise NotImplementedError

    def empty(self, shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
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

    def illegal(self, what: str) -> None:
        """Refuse what a capture cannot hold."""
        if self.here.capturing:
            raise DeviceError(f"{what} while a sequence is captured: it would not be in the graph")

    def check_copy(self, source: Any, target: Any) -> None:
        """Refuse to copy what is not the same piece of memory for both."""
        self.illegal("a copy")
        same = source.shape == target.shape and source.dtype == target.dtype
        if not (same and source.flags.c_contiguous and target.flags.c_contiguous):
            what = f"{source.dtype} {source.shape}", f"{target.dtype} {target.shape}"
            raise TypeError(f"{what[0]} cannot be copied to {what[1]} as it lies in memory")

    def without_graphs(self, why: NoGraph) -> None:
        """Launch one by one from now on, and say so."""
        self.graphs = False
        LOG.warning("no CUDA graphs, kernels are launched one by one: %s", why)


class Workspace:
    """Arrays in the order in which a sequence asks for them: the same ones in every run."""

    def __init__(self, device: Sequenced):
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
    """``launches`` over fixed arrays, and what it returns: the same arrays every time."""

    def __init__(self, device: Any, launches: Callable[[], T]):
        self._device, self._launches, self._workspace = device, launches, Workspace(device)
        self._graph: Graph | None = None
        self._made: T
        self._ran = False

    def __call__(self) -> T:
        """The first run compiles and allocates; the second is captured, where the device has
        graphs."""
        device = self._device
        if self._graph is None and self._ran and device.graphs:
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
