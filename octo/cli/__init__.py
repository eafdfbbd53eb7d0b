"""The command line, ``octo COMMAND``: octo.cli.main has the list of commands.

Exit codes: 0 converged or done, 1 ran but did not converge (all files written), 2 refused, 130
interrupted.
"""

from __future__ import annotations

import contextlib
import os
import sys
from typing import NoReturn, TextIO

from octo.interrupts import like_ctrl_c


def run() -> NoReturn:
    """The command ``octo``. SIGTERM stops it as Ctrl-C does."""
    like_ctrl_c()
    try:
        show_what_can_be_shown()
        # here, so that Ctrl-C while NumPy and CasADi load is no traceback either
        from octo.cli.main import main

        code = main()
    except KeyboardInterrupt as stop:
        print(f"\nocto: interrupted, {str(stop) or 'nothing was written'}", file=sys.stderr)
        code = 130
    except SystemExit as stop:  # --help and --version
        code = int(stop.code or 0)
    except OSError as error:
        if error.filename is not None:
            raise
        code = unprinted(error, 2)
    sys.exit(flushed(code))


def show_what_can_be_shown() -> None:
    """Of letters that the console has not got it gets a "?"; a stream that was closed is one that
    nobody reads."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  (until the end)
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def flushed(code: int) -> int:
    """The exit code, where all that was printed has left the process; else that of a command that
    was refused."""
    try:
        sys.stdout.flush()
    except OSError as error:
        code = unprinted(error, code)
    with contextlib.suppress(OSError):
        sys.stderr.flush()
        return code
    silence(sys.stderr)
    return code


def unprinted(error: OSError, code: int) -> int:
    """The exit code where the console does not take what is printed."""
    silence(sys.stdout)
    if isinstance(error, BrokenPipeError):  # `octo robots | head`: the reader has left
        return code
    with contextlib.suppress(OSError):
        print(
            f"octo: error: what was to be printed cannot be written: {error.strerror}",
            file=sys.stderr,
        )
    return code or 2


def silence(stream: TextIO) -> None:
    """Let what is left of a stream go nowhere: Python would try it again at its end."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
