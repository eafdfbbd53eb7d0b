"""How a solve goes, said on stderr."""

from __future__ import annotations

import sys
import time

from octo.checks import flag
from octo.errors import ProblemError, said
from octo.solver.sqp import Iterate


def check_progress(progress: object, callback: object) -> None:
    """Refuse what cannot say how a solve goes."""
    if not isinstance(progress, str):
        flag("progress", progress)
    if not (callback is None or callable(callback)):
        raise ProblemError(f"callback is {said(callback)}, must be a function of an Iterate")


class Progress:
    """A line on stderr: rewritten in place on a terminal, once every few seconds elsewhere."""

    def __init__(self, doing: str) -> None:
        self.terminal = sys.stderr.isatty()
        self.doing = f"{doing}: " if doing else ""
        self.last = time.perf_counter()

    def __call__(self, at: Iterate | str, final: bool = False) -> None:
        """Of an iterate, or a sentence that stays."""
        now = time.perf_counter()
        if isinstance(at, str):
            start = "\r\033[K" if self.terminal else ""
            print(f"{start}octo: {self.doing}{at}", file=sys.stderr, flush=True)
            return
        if not final and now - self.last < (0.1 if self.terminal else 5.0):
            return
        self.last = now
        line = (
            f"octo: {self.doing}pass {at.number}/{at.passes}, iteration {at.iteration}: {at.words}"
        )
        end = "\n" if final or not self.terminal else ""
        print(f"\r\033[K{line}" if self.terminal else line, end=end, file=sys.stderr, flush=True)
