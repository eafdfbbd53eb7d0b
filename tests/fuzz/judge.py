"""What may come of a case: an answer, or one line that refuses it."""

from __future__ import annotations

import contextlib
import io
import os
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octo.cli.main import main
from octo.errors import OctoError
from octo.result.solution import Solution
from tests.fuzz.values import flaw_of_message

CODES = (0, 1, 2, 130)


class Fault(Exception):
    """A case that octo did not stand: what kind, and where."""


class Slow(KeyboardInterrupt):
    """The processor time of a case is over: what Ctrl-C would do."""


def where(error: BaseException) -> str:
    """The deepest line of octo in a traceback, and the error."""
    frames = [
        frame for frame in traceback.extract_tb(error.__traceback__) if "/octo/" in frame.filename
    ]
    place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "outside of octo"
    text = " ".join(str(error).split())[:200].encode("ascii", "backslashreplace").decode()
    return f"{type(error).__name__} at {place}: {text}"


def call(made: Callable[[], Any], *, may_run: bool = False) -> Any:
    """What a call gives; None where it was refused, or where one that may take long was stopped."""
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            found = made()
    except OctoError as error:
        flaw = flaw_of_message(str(error))
        if flaw:
            raise Fault(f"{flaw}: {' '.join(str(error).split())[:300]}") from error
        return None
    except Slow as error:
        if may_run:
            return None
        raise Fault(f"too slow, {where(error)}") from error
    except Exception as error:
        raise Fault(f"traceback, {where(error)}") from error
    for solution in found if isinstance(found, list) else [found]:
        if isinstance(solution, Solution):
            check(solution)
    return found


def check(solution: Solution) -> None:
    """A solution that says it is converged must be one."""
    if not solution.converged:
        return
    arrays = (
        solution.x,
        solution.u,
        solution.contact_force,
        np.array([solution.energy, solution.violation, solution.dt]),
    )
    if not all(np.isfinite(array).all() for array in arrays):
        raise Fault(f"wrong: {solution.status.label}, but not finite")
    if (
        not solution.violation <= max(1e-2 * solution.weight, 1e-6)
        and solution.status.label != "simulated"
    ):
        raise Fault(
            f"wrong: {solution.status.label} with a violation of {solution.violation:.2g} N of "
            f"{solution.weight:.2g} N"
        )


def command(words: Sequence[str], folder: Path, *, may_run: bool = True) -> int:
    """The exit code of a command in ``folder``, whose words on stderr and files were looked at."""
    out, err = io.StringIO(), io.StringIO()
    before = set(os.listdir(folder))
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(words)
    except SystemExit as error:  # --help and --version
        code = error.code if isinstance(error.code, int) else -1
        if code:
            raise Fault(f"exit with {error.code!r}") from error
    except Slow as error:
        if may_run:
            return 130
        raise Fault(f"too slow, {where(error)}") from error
    except Exception as error:
        raise Fault(f"traceback, {where(error)}") from error
    said = err.getvalue()
    if code not in CODES:
        raise Fault(f"exit code {code}")
    if "Traceback" in said:
        raise Fault(f"traceback on stderr: {said[-300:]}")
    if code == 2:
        last = said.rstrip("\n").rpartition("\n")[2]
        flaw = (
            flaw_of_message(last)
            if last.startswith("octo: error: ")
            else "no line that begins with octo: error"
        )
        if flaw:
            raise Fault(f"{flaw}: {last[:300]!r}")
        if set(os.listdir(folder)) - before:
            raise Fault(f"left behind by a refusal: {sorted(set(os.listdir(folder)) - before)}")
    for path in folder.rglob("solution.npz"):
        if path.parent.name not in before and code in (0, 1):
            call(lambda path=path: Solution.load(path))  # type: ignore[misc]
    return code
