"""One BLAS thread for products of small blocks: its threads wait for one another longer than they
work."""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Callable, Iterator
from typing import Any

from threadpoolctl import ThreadpoolController

Limit = Callable[[], contextlib.AbstractContextManager[Any]]

_lock = threading.Lock()
_inside = 0  # threads of Python that are inside a limit
# the limits that hold, in the order in which they were set
_held: dict[str, contextlib.AbstractContextManager[Any]] = {}


@contextlib.contextmanager
def shared(name: str, limit: Limit) -> Iterator[None]:
    """``limit()`` holds inside; of several threads' the last one to leave sets everything back to
    what it was at first.

    A limit sets back what it found: two that overlap without this leave the second one's finding,
    the first one's limit.
    """
    global _inside
    with _lock:
        if name not in _held:
            made = limit()
            made.__enter__()
            _held[name] = made
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            while _inside == 0 and _held:
                _held.popitem()[1].__exit__(None, None, None)


@functools.cache
def _controller() -> Any:
    """threadpoolctl's handle on the BLAS that is loaded."""
    return ThreadpoolController()


def one_thread() -> contextlib.AbstractContextManager[Any]:
    """``with one_thread():`` BLAS has one thread inside (25 µs)."""
    return shared("blas", lambda: _controller().limit(limits=1, user_api="blas"))
