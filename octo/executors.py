"""Work that is sent to other processes: octo's own, or those of an executor of
``concurrent.futures``."""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from octo import native
from octo.errors import ProblemError, said
from octo.interrupts import STOPS, postponed

T = TypeVar("T")
R = TypeVar("R")
AHEAD = 256  # tasks that are sent and not done: a cluster has enough, a queue is not the memory's
PLAIN = "executor=concurrent.futures.ThreadPoolExecutor(1)"
UNSENT = f"write functions at the top of a module, or give {PLAIN}"
log = logging.getLogger(__name__)
_stop: Any = None  # an event of the process that sent the work, in processes of octo's own


@dataclass(frozen=True)
class Failed:
    """What went wrong in a worker, in words."""

    words: str


def check_executor(executor: object) -> None:
    """Refuse what work cannot be sent to."""
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise ProblemError(f"executor is {said(executor)}, must be a concurrent.futures.Executor")


def stopped() -> bool:
    """Whether the process that sent this one its work has stopped; asked by a worker."""
    return _stop is not None and bool(_stop.is_set())


def run(
    call: str,
    tasks: Sequence[T],
    work: Callable[[T], R | Failed | None],
    take: Callable[[T, R], None],
    executor: Executor | None = None,
) -> None:
    """Do all tasks, and take what comes of each here, one by one as they end.

    Where a process of octo's own is killed the tasks that were under way are sent again.

    Parameters
    ----------
    call: who asks, as "octo.library". work: of a worker, at the top of a module; None where it was
        told to stop. executor: is left open; None for as many new processes as there are cores,
        that begin with nothing of this one.

    Raises
    ------
    ProblemError: a task failed or cannot be sent, or the processes end at once. KeyboardInterrupt:
        what was done is taken, workers are told to stop.
    """
    left = list(tasks)
    while left:
        job = _Job(work, take, list(left))
        with _processes(executor, len(left)) as (own, stop):
            try:
                job.run(own)
                return
            except BrokenExecutor:
                left = job.left
                if executor is not None or len(left) == len(job.tasks):
                    raise ProblemError(
                        f"the processes ended before their work did: call {call} under "
                        "if __name__ == '__main__': in a script, and write functions of yours in a "
                        "module that they can import; or give executor="
                    ) from None
                log.warning("a process was killed: what it did is done again")
            finally:  # nothing is left to do, or something went wrong
                if stop is not None:
                    stop.set()
                job.cancel()


class _Job(Generic[T, R]):
    """Tasks on their way through one executor."""

    def __init__(
        self, work: Callable[[T], R | Failed | None], take: Callable[[T, R], None], tasks: list[T]
    ):
        self.work, self.take, self.tasks = work, take, tasks
        self.sent = 0
        self.under_way: dict[Future[Any], T] = {}

    @property
    def left(self) -> list[T]:
        """What is not done."""
        return [*self.under_way.values(), *self.tasks[self.sent :]]

    def run(self, executor: Executor) -> None:
        try:
            while self.left:
                while self.sent < len(self.tasks) and len(self.under_way) < AHEAD:
                    self._send(executor)
                done, _ = wait(self.under_way, return_when=FIRST_COMPLETED)
                for future in [own for own in self.under_way if own in done]:  # in their order
                    self._keep(future)
        except KeyboardInterrupt:
            for future in [own for own in self.under_way if own.done()]:
                self._keep(future)
            raise

    def cancel(self) -> None:
        for future in self.under_way:
            future.cancel()

    def _send(self, executor: Executor) -> None:
        task = self.tasks[self.sent]
        future = executor.submit(self.work, task)
        if not isinstance(future, Future):
            raise ProblemError(
                f"executor.submit returned {said(future)}, must return a concurrent.futures.Future:"
                " of a Dask client take client.get_executor()"
            )
        self.under_way[future] = task
        self.sent += 1

    def _keep(self, future: Future[Any]) -> None:
        """Take what a worker found."""
        try:
            found = future.result()
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise ProblemError(
                f"the problems cannot be sent to another process: {error}; {UNSENT}"
            ) from error
        if isinstance(found, Failed):
            raise ProblemError(found.words)
        with postponed():  # taken once, whole
            task = self.under_way.pop(future)
            if found is not None:
                self.take(task, found)


@contextmanager
def _processes(given: Executor | None, tasks: int) -> Iterator[tuple[Executor, Any]]:
    """The user's, or processes of octo's own with what stops them."""
    if given is not None:
        yield given, None
        return
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    workers = min(native.cores(), tasks)
    with ProcessPoolExecutor(workers, context, _begin, (stop,)) as own:
        yield own, stop


def _begin(stop: Any) -> None:
    """In a new process of octo's own: the process that sends the work says when to stop."""
    global _stop
    _stop = stop
    for number in STOPS[:1]:  # Ctrl-C in a terminal reaches all processes
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(
        target=_end_with, args=(multiprocessing.parent_process(),), daemon=True
    ).start()


def _end_with(parent: Any) -> None:
    """End this process when that one is gone: a killed one tells nobody to stop."""
    parent.join()
    os._exit(1)
