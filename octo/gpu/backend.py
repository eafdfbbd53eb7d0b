"""The solver's backend on a device: products, factorisations and projections by kernels."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.errors import DeviceError
from octo.gpu.device import Array, Device
from octo.gpu.linear import DeviceBlocks, Linear, text
from octo.gpu.normal import DeviceNormal
from octo.gpu.problem import DeviceProblem
from octo.gpu.program import bytes_of
from octo.gpu.work import DeviceFactors, Work
from octo.problem.compiled import CompiledProblem, Evaluation, Model
from octo.problem.phased import Compiled
from octo.solver.backend import Backend
from octo.solver.options import SqpOptions
from octo.solver.subproblem import Three, Two


class _Own(threading.local):
    """Of a thread that solves: the problem placed last, and the batch that is worked on."""

    last: DeviceProblem | None = None
    at_work: tuple[DeviceProblem, Work] | None = None


class DeviceBackend(Backend):
    """What ``sqp.run`` asks of a device. ``linear_solver`` and ``threads`` are the CPU's: here it
    is cyclic reduction always.

    timed: seconds by stage mean something, because every stage is waited for.
    """

    name = "cuda"

    def __init__(self, device: Device, timed: bool = False):
        self.device, self.timed = device, timed
        self._linear: dict[tuple[int, int], Linear] = {}
        self._own = _Own()

    def place(self, problem: Compiled) -> DeviceProblem:
        """``problem`` on the device; one with the same generated code shares what was compiled for
        the one before.

        Raises
        ------
        DeviceError: the device has too little memory, the robot is too large for its shared
            memory, its units have extra unknowns, its duration is free, or these are phases.
        """
        problem = _single(problem)
        if problem.problems[0].duration is not None:
            raise DeviceError("duration is free, must be fixed on a GPU: solve with device='cpu'")
        if problem.arrays.only_here:
            raise DeviceError(
                f"{problem.arrays.only_here[0]} is written in NumPy's arrays, which a GPU does not "
                "evaluate: solve with device='cpu', or let it take CuPy's and say anywhere = True"
            )
        if problem.plan.extra or problem.plan.extra_rows:
            raise DeviceError(
                f"units have {problem.plan.extra} extra unknowns and {problem.plan.extra_rows} "
                "extra rows, must have none on a GPU: solve with device='cpu'"
            )
        # before what is free is measured: the passes of a solve come one after another
        self._release()
        before = self._own.last
        if before is not None:
            before.release()
        last = before if before is not None and before.host.functions is problem.functions else None
        self._check_memory(problem)
        self._own.last = DeviceProblem(problem, self.device, last)
        return self._own.last

    def _check_memory(self, problem: CompiledProblem) -> None:
        each, free = bytes_of(problem), self.device.free_bytes()
        if each * problem.batch > free:
            need = f"{problem.batch} problems of {each / 1e6:.0f} MB need"
            raise DeviceError(
                f"{need} {each * problem.batch / 1e9:.2g} GB, the GPU has {free / 1e9:.2g} GB "
                f"free: solve {max(1, free // each)} at a time"
            )

    def array(self, values: NDArray[np.float64] | None) -> Array | None:
        return None if values is None else self.device.array(values)

    def prepare(self, problem: Compiled, options: SqpOptions) -> None:
        """Compiles every kernel, or takes it from the cache."""
        if options.soft:
            raise DeviceError(
                f"soft constraints (step={options.step!r}) are not solved on a GPU yet: solve with "
                "device='cpu'"
            )
        own = text(_single(problem).nc, problem.ma, self.device.shared_limit)
        with ThreadPoolExecutor(1) as pool:
            beside = pool.submit(self.device.compile, [own])
            self.place(problem)
            beside.result()
        self.linear(problem.nc, problem.ma)

    def finish(self) -> None:
        if self.timed:
            self.device.synchronize()

    def linear(self, nc: int, ma: int) -> Linear:
        """The kernels for units of nc variables and ma rows, compiled when first asked for."""
        if (nc, ma) not in self._linear:
            self._linear[nc, ma] = Linear(self.device, nc, ma)
        return self._linear[nc, ma]

    def blocks(self, model: Model) -> DeviceBlocks:
        return DeviceBlocks(model.H, model.A, model.b, model.C, self._of(model.A))

    def linearize(
        self,
        problem: Any,
        at: Evaluation,
        lam: Array,
        exact: bool,
        curved: NDArray[np.bool_] | None = None,
    ) -> Model:
        members = np.ones(problem.batch, dtype=bool) if curved is None else curved
        return self.work(problem).linearize(at, lam, exact, members)

    def evaluate(self, problem: Any, unknowns: Array) -> Evaluation:
        return self.work(problem).evaluate(unknowns)

    def evaluate_with(
        self, problem: Any, unknowns: Array, numbers: list[Array]
    ) -> tuple[Evaluation, list[NDArray[np.float64]]]:
        return self.work(problem).evaluate_with(unknowns, numbers)

    def two_by_two(self, hessian: Three, gradient: Two, radius: Array) -> Two:
        batch, device = len(radius), self.device
        out = device.empty((batch,)), device.empty((batch,))
        any_linear = next(iter(self._linear.values()))
        any_linear.flat("octo_two_by_two", batch, *hessian, *gradient, radius, *out)
        return out

    def together(self, problem: Any) -> bool:
        return self.work(problem).together

    def factors(
        self, problem: Any, model: Model, at: Evaluation, lam: Array, options: SqpOptions
    ) -> DeviceFactors:
        work = self.work(problem)
        own = work.of("H", model.H)
        assert own is not None, "the model is not the last one of this problem"
        return DeviceFactors(work, own, at, lam)

    def normal(self, A: Array, threads: int = 1) -> Any:
        at_work = self._own.at_work
        own = None if at_work is None else at_work[1].of("A", A)
        return DeviceNormal(self._of(A), A) if own is None else own.normal()

    def work(self, problem: DeviceProblem) -> Work:
        """What is kept for the solve of a placed batch; that of another batch is given back."""
        at_work = self._own.at_work
        if at_work is None or at_work[0] is not problem:
            self._release()
            made = Work(problem, self.linear(problem.nc, problem.ma))
            at_work = self._own.at_work = (problem, made)
        return at_work[1]

    def _release(self) -> None:
        if self._own.at_work is not None:
            problem, work = self._own.at_work
            self._own.at_work = None
            self.device.synchronize()  # an interrupt may have left a graph under way
            work.close()
            problem.release()

    def _of(self, A: Array) -> Linear:
        return self.linear(int(A.shape[4]), int(A.shape[3]))


def _single(problem: Compiled) -> CompiledProblem:
    """``problem``, which must be one, not phases of one."""
    if not isinstance(problem, CompiledProblem):
        raise DeviceError("phases are not solved on a GPU: solve with device='cpu'")
    return problem
