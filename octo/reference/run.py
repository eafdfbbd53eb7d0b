"""What a run of another solver leaves: a Solution measured like octo's own, and the solver's own
words."""

from __future__ import annotations

import contextlib
import functools
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
import threadpoolctl

from octo.checks import Array
from octo.problem.compiled import CompiledProblem
from octo.reference.library import Library
from octo.result import measure
from octo.result.solution import Solution
from octo.solver import blas
from octo.solver.options import SqpOptions
from octo.solver.status import HISTORY, Status

ITERATIONS = 1500  # of one pass of every solver that is compared
_ALONE = threading.RLock()  # a compiled reference keeps the point that it evaluated last
# of ca.nlpsol, whoever solves
QUIET = {"print_time": False, "calc_lam_p": False, "error_on_fail": False}
OPTIONS = SqpOptions(max_iterations=ITERATIONS)
WARM = ("multipliers", "row_multipliers", "seed")  # arguments of a solve, beside its start


@dataclass(frozen=True, eq=False)
class Run:
    """One solve.

    Attributes
    ----------
    solver: "ipopt" or "fatrop". solution: measured by octo's own functions.
    said: the solver's own word for its end. compiled: no Python and no interpreter ran inside an
        iteration.
    settings: what the solver was told.
    """

    solver: str
    solution: Solution
    said: str
    compiled: bool
    settings: dict[str, Any] = field(default_factory=dict)


@functools.cache
def _know_casadi_blas() -> None:
    """Tell threadpoolctl of the BLAS in CasADi's wheel, which MUMPS calls and whose name it does
    not look for."""

    class CasadiBlas(threadpoolctl.OpenBLASController):
        internal_api = "openblas_of_casadi"
        filename_prefixes = ("libcasadi-tp-openblas",)

    threadpoolctl.register(CasadiBlas)


@contextlib.contextmanager
def one_core() -> Any:
    """Every thread pool that is loaded has one thread inside, IPOPT's too."""
    _know_casadi_blas()
    with blas.shared("all", lambda: threadpoolctl.threadpool_limits(limits=1)):
        yield


class Interruption:
    """Whether Ctrl-C was pressed, or the process told to end, while another solver ran."""

    caught = False


@contextlib.contextmanager
def interruptible(library: Library | None) -> Iterator[Interruption]:
    """Ctrl-C inside ends the solver and is noted: CasADi would swallow it, and call what is left a
    stall or go on.

    So do SIGTERM and SIGHUP where they are handled like it.

    library: of the compiled functions, which are told to fail; without one CasADi is told by an
    exception.
    """
    told = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield told  # no signal comes here
        return

    def note(number: int, frame: Any) -> None:
        told.caught = True
        if library is None:
            raise KeyboardInterrupt
        library.stop()

    before = {signal.SIGINT: signal.getsignal(signal.SIGINT)}
    for number in (signal.SIGTERM, signal.SIGHUP):
        # the command line: they stop as Ctrl-C does
        if signal.getsignal(number) is signal.default_int_handler:
            before[number] = signal.default_int_handler
    for number in before:
        signal.signal(number, note)
    try:
        yield told
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        if library is not None:
            library.stop(False)


@dataclass(frozen=True, eq=False)
class Timed:
    """What CasADi's solver found, s of it by the clock and of the process, and whether it was
    interrupted."""

    found: dict[str, Any]
    seconds: float
    processor: float
    caught: bool


def timed(
    solver: ca.Function, library: Library | None, options: SqpOptions, given: dict[str, Any]
) -> Timed:
    """One solve on one core, from arguments by name, with the compiled functions of ``library``, if
    any."""
    with _ALONE, one_core():
        began, began_processor = time.perf_counter(), time.process_time()
        if library is not None:
            library.activate()
            library.begin(options)
        with interruptible(library) as told:
            found = solver(**given)
        seconds, processor = time.perf_counter() - began, time.process_time() - began_processor
    return Timed(found, seconds, processor, told.caught)


def prepare(compiled: CompiledProblem) -> None:
    """Have octo's own functions compiled, which measure every result: a missing compiler or folder
    is said before a solve."""
    compiled.evaluate(np.zeros((1, compiled.K, compiled.nc)))


def settled(energies: Array, violations: Array, options: SqpOptions) -> bool:
    """octo's rule "acceptable" at the end of a history; ``violations`` in parts of the weight."""
    window = energies[-options.plateau - 1 :]
    still = len(window) > options.plateau and np.ptp(window) <= options.plateau_change * abs(
        window[-1]
    )
    return bool(still and violations[-1] <= options.tolerance)


def history(energies: Array, violations: Array, seconds: Array, **more: Array) -> dict[str, Array]:
    """Columns of a Solution's history; what the solver does not tell is NaN."""
    count = len(energies)
    known: dict[str, Array] = {
        "pass": np.ones(count),
        "iteration": np.arange(float(count)),
        "energy": energies,
        "violation": violations,
        "seconds": seconds,
        "factorizations": np.zeros(count),
        **more,
    }
    return {
        name: np.asarray(known.get(name, np.full(count, np.nan)), dtype=float) for name in HISTORY
    }


def solution_of(
    compiled: CompiledProblem,
    unknowns: Array,
    multipliers: Array,
    status: Status,
    of: Timed,
    **own: Any,
) -> Solution:
    """A Solution from octo's unknowns (1, K, nc) and multipliers (K, ma), evaluated by octo's own
    functions."""
    at = compiled.evaluate(np.ascontiguousarray(unknowns))
    if not bool(at.finite[0]) and status is not Status.INTERRUPTED:
        status = Status.NOT_FINITE
    return Solution(
        **measure.measured(compiled, at, 0),
        multipliers=multipliers,
        status=status,
        factorizations=0,
        device="cpu",
        seconds=of.seconds,
        processor_seconds=of.processor,
        **own,
    )
