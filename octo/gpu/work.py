"""What the solve of one batch keeps at its place on the device, and the sequences of launches
between two copies to the host.

An iteration is: a model; for each weight a factorisation, after which one flag of each member comes
to the host; for each step its solution and the trial of its first length, after which the numbers
that decide about all of it come in one copy; more trials. A solution whose residual is coarse is
refined and tried again. Where the last step's was, a refinement of the members that the device
finds coarse goes with the next step at once: the numbers are the same, the copies fewer. The batch
stays whole: members that a launch is not for are marked in ``active`` and its blocks leave at once,
so that neither the addresses nor the grids change until a member leaves the solve.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Numbers, every, some
from octo.gpu.device import Array
from octo.gpu.factor import DeviceFactor, Solving
from octo.gpu.linear import Linear
from octo.gpu.normal import NormalSequences
from octo.gpu.problem import DeviceProblem
from octo.gpu.sequence import Sequence
from octo.gpu.slab import FIELDS, Slab, SlabEvaluation
from octo.problem.compiled import Evaluation, Model
from octo.solver.factors import Attempt, Three

# steps of a batch: up to here a trial of all its members takes a GPU no longer than one of some of
# them
TOGETHER = 4096
TOLERANCE = 1e-10  # of a solution's relative residual
BESIDE = 8  # numbers of each member that may come to the host with a trial
REFINEMENTS = 3  # at most, while a residual is coarse


class Work:
    """Of one placed batch. ``place`` says where the steps start; everything else is sequences over
    fixed arrays."""

    def __init__(self, problem: DeviceProblem, linear: Linear):
        device, batch, K = problem.device, problem.batch, problem.K
        self.problem, self.linear, self.device = problem, linear, device
        iterate = {"summary": (batch, 4), "sizes": (batch, K), **problem.shapes()}
        step = {"delta": (batch, K, problem.nc), "lam": (batch, K, problem.ma)}
        numbers = {"units": (batch, K, 3), "first": (batch, 1), "residual": (batch, 1)}
        beside = {"beside": (BESIDE, batch)}
        self.at = SlabEvaluation(Slab.fresh(device, iterate))
        self.trial = Slab.fresh(device, {**step, **numbers, **beside, **iterate})
        self.tried = SlabEvaluation(self.trial)
        self._iterate, self._found = self.trial.part("summary"), self.trial.part("beside", "sizes")
        self.decisive = self.trial.part("units", "sizes")  # about a step and its trial
        self.lam = device.empty((batch, K, problem.ma))
        self.rhs_c = device.empty((batch, K, problem.ma))
        self.weight, self.bounds = device.empty((batch, K)), device.empty((batch, 2))
        self.active = device.empty((batch,), np.int32)
        self.curved = device.empty((batch,), np.int32)
        self.parts = {name: self.trial[name] for name in (*step, *numbers, *beside, "sizes")}
        self.plain = False  # whether rhs_c is −C of the model
        self._placed: tuple[Any, Any] = (None, None)
        self._written: dict[str, NDArray[Any]] = {}
        self.models = {exact: Modelled(self, exact) for exact in (True, False)}
        self._evaluate = Sequence(device, self.launch_trial, bool(problem.arrays))

    @property
    def together(self) -> bool:
        """Whether a trial of some members costs no less than that of all of them."""
        return self.problem.batch * self.problem.steps <= TOGETHER

    def place(self, at: Evaluation, lam: Array) -> None:
        """Steps start at ``at``, with multipliers ``lam``."""
        if self._placed[0] is not at:
            if isinstance(at, SlabEvaluation):  # at the end of a trial's slab, as in this one
                own = self.at.slab.flat
                self.device.copy(at.slab.flat[-own.size :], own)
            else:
                for name in FIELDS:
                    self.device.copy(getattr(at, name), getattr(self.at, name))
        if self._placed[1] is not lam:
            self.device.copy(lam, self.lam)
        self._placed = (at, lam)

    def write(self, name: str, values: NDArray[Any]) -> None:
        """``values``, which nobody changes any more, into the fixed array of that name, where they
        are others than before."""
        before = self._written.get(name)
        if before is None or before.tobytes() != values.tobytes():
            self._written[name] = values
            self.device.write(values, getattr(self, name))

    def linearize(
        self, at: Evaluation, lam: Array, exact: bool, curved: NDArray[np.bool_]
    ) -> Model:
        self.place(at, lam)
        self.write("curved", curved.astype(np.int32))
        # allocated before the first sequence, which would take it for its own
        _ = self.problem.scratch
        return self.models[exact].linearize()

    def of(self, name: str, array: Array) -> Modelled | None:
        """What belongs to the model that ``linearize`` gave, by its H or its A; None for
        another's."""
        for own in self.models.values():
            if own.model is not None and getattr(own.model, name) is array:
                return own
        return None

    def close(self) -> None:
        """Give everything back; graphs and arrays refer to one another."""
        for own in self.models.values():
            own.close()
        self.__dict__.clear()

    def evaluate(self, unknowns: Array) -> Evaluation:
        """A trial, in arrays of its own; its numbers come to the host when they are asked for."""
        self.device.copy(unknowns, self.tried.unknowns)
        self._evaluate()
        return SlabEvaluation(self._iterate.copy())

    def evaluate_with(
        self, unknowns: Array, numbers: list[Array]
    ) -> tuple[Evaluation, list[NDArray[np.float64]]]:
        """A trial, and up to BESIDE ``numbers`` (batch,) in the same copy."""
        if numbers:
            self.device.copy(self.device.xp.stack(numbers), self.parts["beside"][: len(numbers)])
        self.device.copy(unknowns, self.tried.unknowns)
        self._evaluate()
        found = self._found.host(self.device)
        return self.evaluated(self._iterate.copy(), found), list(found["beside"][: len(numbers)])

    @staticmethod
    def evaluated(slab: Slab, numbers: Slab) -> Evaluation:
        """An evaluation whose numbers are on the host already."""
        made = SlabEvaluation(slab)
        made.__dict__.update(numbers=numbers["summary"], unit_sizes=numbers["sizes"])
        return made

    def launch_trial(self) -> None:
        """Everything of ``tried`` from its unknowns."""
        self.problem.evaluate_into(self.tried)
        self.linear.unit_sizes(self.tried.C, self.parts["sizes"])


class Modelled:
    """The sequences of one kind of model: with the curvature of the constraints, or without."""

    def __init__(self, work: Work, exact: bool):
        self._work, self._exact = work, exact
        self.model: Model | None = None
        device = work.device
        plain = bool(work.problem.arrays)
        self._linearize = Sequence(device, self._launch_linearize, plain)
        self._factor = Sequence(device, self._launch_factor)
        self._attempt, self._refined, self._again = (
            Sequence(device, partial(self._launch_step, begin, refined), plain)
            for begin, refined in ((True, False), (True, True), (False, True))
        )
        self._step: Solving | None = None  # (−b, rhs_c) and what is known of its solution
        self._coarse = False  # whether the last step's solution was, before it was refined
        self._solve = Sequence(device, self._launch_solve)
        self._rhs: tuple[Array, Array] | None = None
        self._normal: NormalSequences | None = None

    def close(self) -> None:
        if self._normal is not None:
            self._normal.close()
        self.__dict__.clear()

    def linearize(self) -> Model:
        self.model, self._work.plain = self._linearize(), True
        return self.model

    def normal(self) -> NormalSequences:
        """AAᵀ of the model, factored."""
        if self._normal is None:
            self._normal = NormalSequences(self._work.linear, self._own.A)
        self._normal.factor()
        return self._normal

    def factor(self) -> NDArray[np.bool_]:
        """Factor the active members with their weights: where the inertia of each member is
        right."""
        self.factored = self._factor()
        return self._work.device.host(self.factored.good).astype(bool)

    def attempt(self, rhs_c: Array | None) -> Attempt:
        """The step of the right-hand side (−b, rhs_c) and the trial of its first length."""
        work, refinements = self._work, int(self._coarse)
        if rhs_c is not None:
            work.device.copy(rhs_c, work.rhs_c)
        assert rhs_c is not None or work.plain, "−C was asked for after another right-hand side"
        work.plain = rhs_c is None
        if self._step is None:
            out = tuple(work.parts[name] for name in ("delta", "lam", "first", "residual"))
            rhs_v = work.device.empty(self._own.b.shape)
            self._step = Solving.of(work.linear, rhs_v, work.rhs_c, TOLERANCE, out)
        (self._refined if self._coarse else self._attempt)()
        numbers = work.decisive.host(work.device)
        coarse = numbers["first"] > TOLERANCE  # NaN: there is no factor
        self._coarse = some(coarse)
        while True:
            if refinements:
                coarse &= numbers["residual"] > TOLERANCE
            if refinements == REFINEMENTS or not some(coarse):
                break
            self._again()
            numbers = work.decisive.host(work.device)
            refinements += 1
        slab, units = work.trial.copy(), numbers["units"]
        tried = work.evaluated(slab, numbers)
        return Attempt(slab["delta"], slab["lam"], lambda: _numbers(units), tried)

    def untried(self, rhs_c: Array) -> Attempt:
        """The step without its trial, which some members want only."""
        work, model = self._work, self._own
        delta, lam = self.solve(-model.b, rhs_c)
        units = work.device.empty((*model.b.shape[:2], 3))

        def numbers() -> Three:
            work.linear.step_numbers(model.A, model.b, delta, work.lam, units)
            return _numbers(work.device.host(units))

        return Attempt(delta, lam, numbers)

    def solve(self, rhs_v: Array, rhs_c: Array) -> tuple[Array, Array]:
        """Any right-hand side; NaN for members without a factor."""
        device = self._work.device
        if self._rhs is None:
            self._rhs = device.empty(rhs_v.shape), device.empty(rhs_c.shape)
        for source, target in zip((rhs_v, rhs_c), self._rhs, strict=True):
            device.copy(source, target)
        solving = self._solve()
        return solving.v.copy(), solving.lam.copy()

    def _launch_linearize(self) -> Model:
        work = self._work
        if work.linear.ma:
            work.linear.negative(work.at.C, work.rhs_c)
        return work.problem.linearize(work.at, work.lam if self._exact else None, work.curved)

    def _launch_factor(self) -> DeviceFactor:
        work, model = self._work, self._own
        return DeviceFactor(work.linear, model.H, model.A, work.weight, work.active)

    def _launch_step(self, begin: bool, refined: bool) -> None:
        """A solution, a refinement of what there is, the numbers of the step, and its trial."""
        work, parts, model, step = self._work, self._work.parts, self._own, self._step
        assert step is not None
        if begin:
            work.linear.negative(model.b, step.rhs_v)
            self.factored.begin(step, self.factored.good)
        if refined:
            self.factored.refine(step, self.factored.good)
        delta, units = parts["delta"], parts["units"]
        work.linear.step_numbers(model.A, model.b, delta, work.lam, units)
        work.linear.advance(work.bounds, units, work.at.unknowns, delta, work.tried.unknowns)
        work.launch_trial()

    def _launch_solve(self) -> Solving:
        assert self._rhs is not None
        solving = Solving.of(self._work.linear, *self._rhs, TOLERANCE)
        self.factored.begin(solving, self.factored.good)
        for _ in range(REFINEMENTS):
            self.factored.refine(solving, self.factored.good)
        return solving

    @property
    def _own(self) -> Model:
        assert self.model is not None
        return self.model


def _numbers(units: Numbers) -> Three:
    """Those of an Attempt, from what ``Linear.step_numbers`` says of each unit."""
    return units[:, :, 0], units[:, :, 1].max(axis=1), units[:, :, 2].sum(axis=1)


class DeviceFactors:
    """``octo.solver.factors.Factors`` on a device: the batch is factored in place, whole, some
    members or all of them."""

    def __init__(self, work: Work, own: Modelled, at: Evaluation, lam: Array):
        self._work, self._own = work, own
        work.place(at, lam)

    def clear(self) -> None:
        """Nothing: what is factored again replaces what was."""

    def add(self, members: NDArray[np.bool_], weight: NDArray[np.float64]) -> NDArray[np.bool_]:
        self._work.write("weight", weight)
        self._work.write("active", members.astype(np.int32))
        return self._own.factor() & members

    def solve(self, rhs_v: Array, rhs_c: Array) -> tuple[Array, Array]:
        return self._own.solve(rhs_v, rhs_c)

    def attempt(
        self,
        rhs_c: Array | None,
        limit: Numbers | float,
        cap: float,
        members: NDArray[np.bool_] | None = None,
    ) -> Attempt:
        some_of_them = members is not None and not every(members)
        if rhs_c is not None and some_of_them and not self._work.together:
            return self._own.untried(rhs_c)
        bounds = np.empty((self._work.problem.batch, 2))
        bounds[:, 0], bounds[:, 1] = limit, cap
        self._work.write("bounds", bounds)
        return self._own.attempt(rhs_c)
