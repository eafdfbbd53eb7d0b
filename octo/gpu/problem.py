"""A batch of problems on a device: ``evaluate`` and ``linearize`` by kernels."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from octo.arrays import host
from octo.gpu.device import Array, Device
from octo.gpu.program import NARROW, PARTS, SMALL, TILED, TOGETHER, WARP, Program
from octo.gpu.step_pairs import Numbers
from octo.gpu.tables import gathers, pair_gathers
from octo.gpu.worlds import placed
from octo.problem.compiled import CompiledProblem, Evaluation, Model
from octo.problem.neighbours import anchors

BATCHED = ("p", "q", "row_scale", "constant", "lower", "upper", "anchor", "carry", "rest")


class DeviceProblem:
    """``problem`` with its numbers and its iterates on ``device``; what is described stays on the
    host."""

    def __init__(self, problem: CompiledProblem, device: Device, like: DeviceProblem | None = None):
        self.host, self.device, self.xp = problem, device, device.xp
        self.program: Program = Program(problem, device) if like is None else like.program
        p, self._worlds = placed(problem, device)
        self.p = device.array(p)
        self.q, self.row_scale, self.constant, self.lower, self.upper = (
            device.array(getattr(problem, name)) for name in BATCHED[1:6]
        )
        between = bool(problem.functions.between)
        self.anchor = device.array(
            anchors(problem.plan, problem.data) if between else np.zeros((problem.batch, 1))
        )
        self.carry: Array | None = None if problem.carry is None else device.array(problem.carry)
        # of the nodes where nothing moves
        self.rest: Array | None = None
        if self.program.kept is not None:
            self.rest = device.array(np.zeros(problem.constant.shape))
        self._tables: dict[str, Array] = (
            like._tables if like is not None and like._fits(problem) else self._upload()
        )
        self.arrays = problem.arrays
        own = problem
        self.problems, self.functions, self.dynamics = own.problems, own.functions, own.dynamics
        self.batch, self.steps, self.n, self.K = len(self.p), own.steps, own.n, own.K
        self.nc, self.ma, self.m = own.nc, own.ma, own.m
        self.weight, self.threads = own.weight, own.threads

    def _fits(self, problem: CompiledProblem) -> bool:
        same = problem.basis == self.host.basis and problem.steps == self.host.steps
        return same and np.array_equal(problem.fixed, self.host.fixed)

    def _upload(self) -> dict[str, Array]:
        """The stencil and its gather tables on the device."""
        stencil, device = self.host.stencil, self.device
        dummy = np.zeros((stencil.units, stencil.parts), dtype=np.int32)
        dummy[self.host.fixed] = 1
        for place in self.host.idle:
            dummy[place] = 1
        rows = stencil.test_row
        tests = np.where(rows >= 0, rows * stencil.parts + stencil.test_part, -1)
        slots = {"slot_unit": stencil.unit, "slot_part": stencil.part}
        whole = {**slots, "test_row": tests, "dummy": dummy}
        arrays = {name: device.array(values, np.int32) for name, values in whole.items()}
        arrays["slot_value"] = device.array(stencil.coefficient)
        arrays["test_value"] = device.array(stencil.test_coefficient)
        own = gathers(stencil, self.host.steps, self.host.n)
        if self.program.pairs is not None:
            own |= pair_gathers(stencil, self.host.steps, self.carry is not None)
        for name, gather in own.items():
            for part in ("first", "source"):
                arrays[f"{name}_{part}"] = device.array(getattr(gather, part), np.int32)
            arrays[f"{name}_value"] = device.array(gather.value)
        return arrays

    def take(self, members: Any) -> DeviceProblem:
        """A batch of some members, by index (host or device); everything else is shared."""
        part: DeviceProblem = object.__new__(DeviceProblem)
        part.__dict__.update({k: v for k, v in self.__dict__.items() if k != "scratch"})
        chosen = self.xp.asarray(members)
        for name in BATCHED:
            whole = getattr(self, name)
            setattr(part, name, None if whole is None else self.xp.ascontiguousarray(whole[chosen]))
        part.batch = len(part.p)
        if self.arrays:
            part.arrays = self.arrays.take(host(chosen))
        return part

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (batch, N, rows) of the bounded rows."""
        return self.lower, self.upper

    def set_row_weights(
        self, weights: Array, shifts: Array, multipliers: Array | None = None
    ) -> None:
        """As :meth:`CompiledProblem.set_row_weights`, of arrays on the device; nothing is
        checked."""
        values = (weights, shifts, shifts if multipliers is None else multipliers)
        for place, own in zip(self.functions.row_weights, values, strict=True):
            self.q[:, :, place] = own

    def release(self) -> None:
        """Gives back what ``linearize`` writes on its way; the next one takes it anew."""
        self.__dict__.pop("scratch", None)

    def unknowns(self, nodes: Any) -> Array:
        """(batch, K, nc) unknowns, on the device, of a trajectory (batch, N+2, n) on the host."""
        return self.device.array(self.host.unknowns(np.asarray(nodes)))

    # -- what a solver calls -----------------------------------------------------------------------

    def evaluate(self, unknowns: Array) -> Evaluation:
        """E and C at ``unknowns`` (batch, K, nc)."""
        device = self.device
        made = Evaluation(
            unknowns,
            *(device.empty(shape) for name, shape in self.shapes().items() if name != "unknowns"),
        )
        self.evaluate_into(made)
        return made

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Of the arrays of an evaluation, in its order."""
        batch, steps, n = self.batch, self.steps, self.n
        return {
            "unknowns": (batch, self.K, self.nc),
            "nodes": (batch, steps + 2, n),
            "fd": (batch, steps, n),
            "terms": (batch, steps, self.program.terms),
            "rows": (batch, steps, len(self.functions.bounded)),
            "C": (batch, self.K, self.ma),
            "summary": (batch, 4),
        }

    def evaluate_into(self, at: Evaluation) -> None:
        """Everything of ``at`` from its unknowns."""
        program, tables = self.program, self._tables
        self._fill_nodes(self.constant, at.unknowns, at.nodes)
        kin = self._kin(at.nodes)
        self._each_step("octo_value", SMALL, 8 * program.work, at.nodes, kin, self.p, at.fd)
        room = 8 * (program.rows + program.arguments)
        terms = (at.nodes, kin, self.p, self.q, at.fd, at.terms, at.rows)
        self._each_step("octo_terms", SMALL, room, *terms, together=TOGETHER)
        if program.between is not None:
            program.between.values(self.anchor, at.unknowns, self.q, at.terms)
        if program.pairs is not None:
            program.pairs.values(self._pair_numbers(at), at.terms)
        self.arrays.values(at.unknowns, at.nodes, at.terms)
        if self.ma:
            sums = [tables[f"tests_{part}"] for part in ("first", "source", "value")]
            rows = (self.steps, self.K * self.host.stencil.parts, *sums, self.row_scale, at.fd)
            program.flat("octo_constraints", at.C.size, *rows, at.C)
        own = (self.steps, self.K * self.ma, at.terms, at.C, at.summary)
        program.each("octo_summary", (self.batch,), *own, threads=PARTS, shared=32 * PARTS)

    def linearize(self, at: Evaluation, lam: Array | None, curved: Array | None = None) -> Model:
        """As :meth:`CompiledProblem.linearize`; ``curved`` are integers on the device."""
        program, scratch = self.program, self.scratch
        kin = self._kin(at.nodes)
        self._derive_costs(at, lam, curved, kin)
        pairs = None if program.pairs is None else program.pairs.derived(self._pair_numbers(at))
        if pairs is not None and lam is not None:
            pairs.pull(scratch["lam"])
        dynamics = (at.nodes, kin, self.p)
        if lam is None:
            self._each_step(
                "octo_jacobian", NARROW, 8 * program.work, *dynamics, scratch["fd"], scratch["jac"]
            )
        else:
            out = (scratch["lam"], scratch["fd"], scratch["jac"], scratch["curvature"])
            self._each_step("octo_curvature", NARROW, 8 * program.work, *dynamics, *out)
        slopes = (scratch["r"], scratch["cost_jac"], scratch["jac"])
        curvature = None if lam is None else scratch["curvature"]
        squares = (scratch["hess"], scratch["gradient"])
        given = (program.held, *dynamics, self.q, *slopes, curvature)
        self._each_step("octo_step_model", TILED, program.room, *given, *squares)
        if program.bends is not None and lam is not None:
            numbers = (at.nodes, self.p, self.q, at.fd)
            program.bends.add(curved, numbers, scratch["jac"], scratch["second"], scratch["hess"])
        if program.touch:
            own = (int(lam is not None), curved, kin, scratch["touch"], *squares)
            self._each_step("octo_touch", TILED, program.touching, *own)
        if pairs is not None:
            pairs.chain(scratch["jac"], lam is not None, curved)
        kept = self._kept_rows()
        if self.carry is not None:
            grid, carried = (2, 10, self.batch), (self.steps, self.carry, scratch["jac"], *squares)
            room = 8 * self.n**2
            program.each("octo_carry_back", grid, *carried, threads=SMALL, shared=room)
        model = self._gather(at, lam is not None, curved)
        model.R = kept
        if pairs is not None:
            pairs.add(self._tables, model.H, model.b)
        self.arrays.add(at.unknowns, at.nodes, model.H, model.b)
        return model

    def row_products(self, model: Model, delta: Array) -> Array:
        """As :meth:`CompiledProblem.row_products`."""
        products = self.device.empty((self.batch, self.steps, len(self.functions.bounded)))
        if self.program.kept is None:
            return products
        moved = self.device.empty((self.batch, self.steps + 2, self.n))
        self._fill_nodes(self.rest, delta, moved)
        room = 8 * (3 * self.n + len(self.program.kept.motors))
        self._each_step("octo_row_products", SMALL, room, model.R, moved, products)
        return products

    def row_forces(self, model: Model, weights: Array) -> Array:
        """As :meth:`CompiledProblem.row_forces`."""
        if self.program.kept is None:
            return self.xp.zeros((self.batch, self.K, self.nc))
        window = self.device.empty((self.batch, self.steps, 3 * self.n))
        room = 8 * (3 * self.n + len(self.program.kept.motors))
        self._each_step("octo_row_forces", SMALL, room, model.R, weights, self.carry, window)
        forces = self.device.empty((self.batch, self.K, self.nc))
        own = (self._tables[f"gradient_{part}"] for part in ("first", "source", "value"))
        given = (self.steps, self.host.stencil.parts, *own, window, forces)
        self.program.each("octo_gather_forces", (self.K, self.batch), *given, threads=SMALL)
        return forces

    def _kept_rows(self) -> Array | None:
        """R of a model, out of the slopes in ``scratch``."""
        if self.program.kept is None:
            return None
        kept = self.device.empty((self.batch, self.steps, max(self.program.kept.size, 1)))
        slopes = (self.scratch["cost_jac"], self.scratch["jac"])
        self._each_step("octo_keep_rows", SMALL, 0, self.q, *slopes, kept)
        return kept

    def _pair_numbers(self, at: Evaluation) -> Numbers:
        return at.nodes, at.fd, self.p, self.q, self.carry

    def _derive_costs(
        self, at: Evaluation, lam: Array | None, curved: Array | None, kin: Array
    ) -> None:
        """Residuals of the terms, their derivatives, and the multipliers of each step's FD."""
        tables, room = self._tables, 8 * self.program.arguments
        sizes = (self.K * self.host.stencil.parts, tables["test_row"].shape[1])
        tests = (tables["test_row"], tables["test_value"])
        given = (at.nodes, kin, self.p, self.q, self.row_scale, at.fd, lam, curved)
        out = [self.scratch[name] for name in ("r", "cost_jac", "touch", "lam")]
        self._each_step(
            "octo_cost_derivatives", SMALL, room, *sizes, *tests, *given, *out, together=TOGETHER
        )

    def gradient(self, at: Evaluation) -> tuple[Array, Array]:
        """As :meth:`CompiledProblem.gradient`, out of a whole model."""
        model = self.linearize(at, None)
        return model.b, model.A

    def term_values(self, at: Evaluation) -> Array:
        """(batch, terms) the parts of E."""
        return at.terms.sum(axis=1)

    # -- launches ----------------------------------------------------------------------------------

    def _gather(self, at: Evaluation, exact: bool, curved: Array | None) -> Model:
        device, tables, scratch = self.device, self._tables, self.scratch
        shape, sizes = (self.batch, self.K), (self.steps, self.host.stencil.parts)
        H = device.empty((*shape, 3, self.nc, self.nc))
        A = device.empty((*shape, 3, self.ma, self.nc))
        b = device.empty((*shape, self.nc))
        columns = ("first", "source", "value")
        hessian, gradient, jacobian = (
            [tables[f"{n}_{part}"] for part in columns] for n in ("hessian", "gradient", "jacobian")
        )
        groups = -(-self.n * (self.n + 1) // SMALL)
        own = (tables["dummy"], scratch["hess"], scratch["gradient"], H, b)
        grid = (self.K * groups, 3, self.batch)
        gathered = (*sizes, groups, *hessian, *gradient, *own)
        self.program.each("octo_gather_hessian", grid, *gathered, threads=SMALL)
        if self.program.between is not None:
            between = (self.anchor, at.unknowns, self.q, tables["dummy"])
            self.program.between.add(*between, H, b)
            if exact:
                self.program.between.bend(*between, curved, H)
        if self.ma:
            rows, grid = (*jacobian, self.row_scale, scratch["jac"], A), (self.K, 3, self.batch)
            self.program.each("octo_gather_constraints", grid, *sizes, *rows, threads=SMALL)
        return Model(H, A, b, at.C)

    def _fill_nodes(self, constant: Array | None, unknowns: Array, nodes: Array) -> None:
        """What the unknowns make of the nodes, whose ``constant`` part they do not move."""
        tables = self._tables
        sizes = (self.steps, self.K, tables["slot_unit"].shape[1], self.host.stencil.parts)
        slots = (tables["slot_unit"], tables["slot_part"], tables["slot_value"])
        given = (constant, self.carry, unknowns, nodes)
        self.program.flat("octo_nodes", nodes.size, *sizes, *slots, *given)

    def _kin(self, nodes: Array) -> Array:
        program, grid = self.program, (self.steps + 2, self.batch)
        kin = self.device.empty((*nodes.shape[:2], max(program.kin, 1)))
        room = 8 * (2 * self.n + program.kin)
        program.each("octo_kin_of_nodes", grid, nodes, kin, threads=WARP, shared=room)
        looks = self.dynamics.looks * nodes.shape[0] * nodes.shape[1]
        if looks:
            program.flat("octo_looks", looks, nodes.shape[1], self.p, kin)
        return kin

    def _each_step(
        self, name: str, threads: int, shared: int, *arguments: Any, together: int = 1
    ) -> None:
        """A kernel with a block for ``together`` steps of each problem; ``shared`` bytes a step."""
        grid = (-(-self.steps // together), self.batch)
        room = together * shared
        self.program.each(name, grid, self.steps, *arguments, threads=threads, shared=room)

    @cached_property
    def scratch(self) -> dict[str, Array]:
        """What linearize writes on its way to H and A."""
        program, n = self.program, self.n
        sizes: dict[str, tuple[int, ...]] = {
            "r": (program.rows,),
            "cost_jac": (program.entries,),
            "touch": (program.touch,),
            "lam": (n,),
            "fd": (n,),
            "jac": (n, 3 * n),
            "curvature": (program.curvature, n, n),
            "hess": (6, n, n),
            "gradient": (3 * n,),
            "second": (0 if program.bends is None else program.bends.size,),
        }
        items = (self.batch, self.steps)
        return {
            name: self.device.empty((*items, *(max(s, 1) for s in shape)))
            for name, shape in sizes.items()
        }
