"""Ctrl-C and SIGTERM: both stop a command in the same way, and neither stops it while it writes
what it found.

Nor while symbols are built: CasADi asks the arguments of its operators for their ``shape``, in
Python, and takes whatever is raised there for an answer, a KeyboardInterrupt too.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def like_ctrl_c() -> None:
    """Let what ends a process from outside raise KeyboardInterrupt, where it would have ended it at
    once."""
    for number in STOPS:
        if signal.getsignal(number) is signal.SIG_DFL:  # nohup, for one, has SIGHUP ignored
            signal.signal(number, signal.default_int_handler)


@contextlib.contextmanager
def postponed() -> Iterator[None]:
    """Inside, the first of these signals waits for the end; a second one is not made to wait.

    A decorator too: ``@postponed()``.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def remember(number: int, frame: FrameType | None) -> None:
        came.append(number)
        if len(came) > 1:
            raise KeyboardInterrupt

    handled = [number for number in STOPS if signal.getsignal(number) is signal.default_int_handler]
    for number in handled:
        signal.signal(number, remember)
    try:
        yield
    finally:
        for number in handled:
            signal.signal(number, signal.default_int_handler)
    if came:
        raise KeyboardInterrupt
