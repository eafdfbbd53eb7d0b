"""E, C and their model without a compiler: CasADi's virtual machine for the derivatives, NumPy for
the blocks.

The same formulas as assemble.c in slower words; it is also what the native code is tested against.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.dynamics import symbolic
from octo.dynamics.evaluate import RobotDynamics
from octo.interrupts import postponed
from octo.problem.basis import block, node_forces, scatter, slots_of
from octo.problem.contact_model import BLOCKS, contact_inputs
from octo.problem.data import Data
from octo.problem.evaluation import Blocks, Evaluation
from octo.problem.mapped import add_bends, by_term, live_rows, rows_over, squares
from octo.problem.neighbours import NeighbourTerms
from octo.problem.pair_blocks import PairTerms
from octo.problem.plan import Plan
from octo.problem.program import Program
from octo.world.jet import SIZES


class Interpreted:
    """Residuals of all terms over all steps, their derivatives, and the blocks of Eq. 9."""

    def __init__(self, program: Program, plan: Plan, data: Data):
        self.program, self.plan, self.data = program, plan, data
        pairs, alone = program.functions.pairs, data.carry is None and plan.steps == 1
        self.pairs: PairTerms | None = None
        if pairs is not None and not alone:  # a single step has none before it
            self.pairs = PairTerms(pairs, plan, program.dynamics.actuated)

    def select(self, data: Data) -> Interpreted:
        """For other numbers; what is built stays built."""
        made: Interpreted = object.__new__(Interpreted)
        made.__dict__.update(self.__dict__, data=data)
        return made

    @cached_property
    def _inputs(self) -> list[ca.SX]:
        """x_next, x, x_prev, u, p, q of one step, and v where stages are called."""
        return list(self.program.functions.state.sx_in())

    @cached_property
    def _jets(self) -> list[ca.SX]:
        """What a world says of those contacts, one after the other, at x_next and at x."""
        if not self._places_of_jets:
            return []
        size = SIZES[-1] * len(self._places_of_jets)
        return [ca.SX.sym(name, size) for name in ("jets", "jets_now")]

    @cached_property
    def _places_of_jets(self) -> list[int]:
        """Of those contacts, among all that touch the terrain; none where it is no world."""
        dynamics, functions = self.program.dynamics, self.program.functions
        if not isinstance(dynamics, RobotDynamics) or not dynamics.on_world:
            return []
        return [dynamics.character.terrain_contacts.index(c) for c in functions.contact_spheres]

    def _with_jets(self, k: int, given: list[Array]) -> list[Array]:
        """A member's arguments, with those jets over the steps behind them."""
        dynamics = self.program.dynamics
        if not self._places_of_jets or not isinstance(dynamics, RobotDynamics):
            return given
        made = [dynamics.jets(self.data.p[k], np.asarray(node).T) for node in given[:2]]
        own = [jets[:, self._places_of_jets, -SIZES[-1] :] for jets in made]
        return [*given, *(jets.reshape(len(jets), -1).T for jets in own)]

    @cached_property
    @postponed()
    def _contacts(self) -> list[tuple[int, list[ca.SX], Array]]:
        """Of each contact that has a term: its body, the inputs of the terms' functions, and
        ``use``."""
        dynamics, functions = self.program.dynamics, self.program.functions
        p, q = self._inputs[4:6]
        if functions.contact is None or not isinstance(dynamics, RobotDynamics):
            return []
        robot, made = dynamics.character, []
        poses = [symbolic.body_poses(robot, node) for node in self._inputs[:3]]
        for k, index in enumerate(functions.contact.spheres):
            jets = [ca.vertsplit(node, SIZES[-1])[k] for node in self._jets]
            inputs = [*contact_inputs(robot, index, poses), p, q, *jets]
            use = functions.contact.use[k].astype(float)
            made.append((robot.contacts[index].body, inputs, use))
        return made

    @cached_property
    @postponed()
    def _values(self) -> tuple[ca.Function, NDArray[np.intp], Array]:
        """All residuals of one step, with the term of each and its mask."""
        functions = self.program.functions
        parts, terms = [functions.state(*self._inputs)], [*functions.state_terms]
        mask = [1.0] * self._squares + [0.0] * len(functions.bounded)
        for _, inputs, use in self._contacts:
            assert functions.contact is not None
            parts.append(functions.contact.value(*inputs))
            terms += functions.contact.terms
            mask += use.tolist()
        r = ca.densify(ca.vertcat(*parts))
        return (
            ca.Function("residuals", [*self._inputs, *self._jets], [r], {"cse": True}),
            np.array(terms, dtype=np.intp),
            np.array(mask),
        )

    @postponed()
    def _touch(self, exact: bool) -> ca.Function:
        """Of the inputs: gradient (3n,) and second derivative (3n, 3n) of the terms over
        contacts."""
        n, functions, dynamics = self.plan.n, self.program.functions, self.program.dynamics
        gradient, hess = ca.SX(3 * n, 1), ca.SX(3 * n, 3 * n)
        assert isinstance(dynamics, RobotDynamics)
        robot = dynamics.character
        of_nodes = [symbolic.joint_twists(robot, node) for node in self._inputs[:3]]
        for body, inputs, use in self._contacts:
            assert functions.contact is not None
            function = functions.contact.exact if exact else functions.contact.model
            made = function(*inputs, ca.DM(use))
            path = [int(j) for j in robot.path[body]]
            twists = [
                ca.horzcat(ca.SX(6, 0), *(ca.vertcat(*of_node[j]) for j in path))
                for of_node in of_nodes
            ]
            places = [[node * n + j for j in path] for node in range(3)]
            for node in range(3):
                gradient[places[node]] += twists[node].T @ made[6 * node : 6 * node + 6]
            for k, (a, b) in enumerate(BLOCKS):
                block = (
                    twists[a].T @ ca.reshape(made[18 + 36 * k : 54 + 36 * k], 6, 6).T @ twists[b]
                )
                if a == b:  # rows are ancestors
                    block = ca.triu2symm(ca.triu(block))
                hess[places[a], places[b]] += block
                if a != b:
                    hess[places[b], places[a]] += block.T
        inputs, out = [*self._inputs, *self._jets], [ca.densify(gradient), ca.densify(hess)]
        # without "cse", which takes 30 times longer and leaves nine in ten instructions
        return ca.Function("touch", inputs, out)

    @cached_property
    def _between(self) -> NeighbourTerms | None:
        functions = self.program.functions
        return NeighbourTerms(self.plan, functions) if functions.between else None

    @cached_property
    def _touches(self) -> dict[bool, ca.Function]:
        """By whether they are exact."""
        return {}

    def _arguments(self, k: int, nodes: Array, fd: Array) -> list[Array]:
        """Of a member, for the functions of a step mapped over the steps."""
        steps, calls = self.plan.steps, self.program.functions.calls
        window = [nodes[k, first : first + steps].T for first in (2, 1, 0)]
        p = np.repeat(self.data.p[k][:, None], steps, axis=1)
        q = self.data.q[k][:, : self._inputs[5].numel()]
        given = [*window, fd[k][:, self.program.dynamics.actuated].T, p, q.T]
        arguments = [argument.map(steps) for argument in calls.arguments]
        return [*given, *calls.evaluate(arguments, given)]

    def evaluate(
        self, unknowns: Array, nodes: Array, fd: Array, terms: Array, rows: Array, C: Array
    ) -> None:
        """Fills FD (batch, N, n), each step's share of each term (batch, N, terms), the values of
        the bounded rows (batch, N, rows) and C."""
        fd[:] = self.program.dynamics.evaluate(nodes, self.data.p)[0]
        self.fill_terms(nodes, fd, terms, rows)
        if self.pairs is not None:
            self.pairs.add_values(self.data, nodes, fd, terms)
        C[:] = self.plan.reduce(fd[:, :, self.program.dynamics.unactuated], self.data.row_scale)
        if self._between is not None:
            self._between.values(self.data, unknowns, terms)

    def fill_terms(self, nodes: Array, fd: Array, out: Array, rows: Array) -> None:
        """coefficient·|r|² of each term, and r of the bounded rows."""
        value, terms, mask = self._values
        first = self._squares
        for k in range(len(nodes)):
            given = self._with_jets(k, self._arguments(k, nodes, fd))
            r = rows_over(value, given, self.plan.steps)
            rows[k] = r[:, first : first + rows.shape[-1]]
            weighted = squares(self.data.q[k][:, terms] * mask, r)
            out[k] = by_term(weighted, terms, out.shape[-1])

    @property
    def _squares(self) -> int:
        """How many rows over the state are squares of E: the first ones."""
        functions = self.program.functions
        return len(functions.state_terms) - len(functions.bounded)

    def linearize(
        self, at: Evaluation, lam: Array | None, curved: NDArray[np.bool_] | None, out: Blocks
    ) -> None:
        """Fills H, if any, A, b, C, and R, if any."""
        dynamics, plan, n = self.program.dynamics, self.plan, self.plan.n
        scale = self.data.row_scale
        given = [self._arguments(k, at.nodes, at.fd) for k in range(len(at.nodes))]
        weight, shift, multiplier, jac = self._rows(given)
        pull = np.zeros_like(at.fd)
        pull[..., dynamics.actuated] = np.einsum("kir,kirj->kij", multiplier, jac[..., 3 * n :])
        whole = np.full(len(shift), lam is not None)
        if curved is not None:
            whole &= np.asarray(curved, dtype=bool)
        pairs = None
        if self.pairs is not None:
            pairs = self.pairs.slopes(self.data, at.nodes, at.fd, whole)
            pull[..., dynamics.actuated] += self.pairs.pull(self.data, pairs)
        if lam is not None:
            tested = lam[..., : plan.tested]
            rows = np.matmul(
                plan.test_matrix.T, tested.reshape(len(lam), plan.K * plan.stencil.parts, plan.m)
            )
            pull[..., dynamics.unactuated] = rows * scale[:, None]
        order = 1 if lam is None else 2
        _, fd_jac, hess = dynamics.evaluate(at.nodes, self.data.p, pull, order)
        assert fd_jac is not None
        slopes = fd_jac  # before they are carried back
        kept = self.program.kept
        if kept is not None and out[4] is not None:
            own = jac[:, :, self._squares :]
            out[4][:] = kept.packed(own, fd_jac[:, :, dynamics.actuated])
        chained = jac[..., : 3 * n] + jac[..., 3 * n :] @ fd_jac[:, :, dynamics.actuated]
        step_hess = np.einsum("kir,kira,kirb->kiab", weight, chained, chained)
        if hess is not None:
            step_hess += hess
        gradient = np.einsum("kir,kira->kia", shift, chained)
        if self.program.functions.curvature is not None:
            self._add_bends(given, whole, fd_jac[:, :, dynamics.actuated], step_hess)
        if self._contacts:
            self._add_contacts(given, whole, gradient, step_hess)
        if self.data.carry is not None:
            fd_jac = fd_jac.copy()
            self._carry_back(self.data.carry, step_hess, gradient, fd_jac)
        constraints = fd_jac[:, :, dynamics.unactuated] * scale[:, None, :, None]
        H = out[0]
        if H is None:  # it costs little beside the rest
            H = np.empty((len(at.nodes), plan.K, 3, plan.nc, plan.nc))
        self._scatter(step_hess, gradient, constraints, (H, out[1], out[2]))
        if self.pairs is not None and pairs is not None:
            self.pairs.add_blocks(self.data, pairs, slopes, H, out[2])
        out[3][:] = plan.reduce(at.fd[:, :, dynamics.unactuated], scale)
        if self._between is not None:
            self._between.add(self.data, at.unknowns, whole, H, out[2])

    def row_products(self, kept: Array, moved: Array, out: Array) -> None:
        """Fills R Δ (batch, N, rows), of R of a model and the step of the nodes."""
        slopes = self.program.kept
        assert slopes is not None
        out[:] = slopes.products(kept, moved)

    def row_forces(self, kept: Array, weights: Array, out: Array) -> None:
        """Fills Rᵀ w (batch, K, nc), of R of a model and weights (batch, N, rows)."""
        slopes, (batch, steps), n = self.program.kept, kept.shape[:2], self.plan.n
        assert slopes is not None
        nodes = np.zeros((batch, steps + 2, n))
        for node, own in enumerate(np.split(slopes.forces(kept, weights), 3, axis=-1)):
            nodes[:, 2 - node : 2 - node + steps] += own
        out[:] = node_forces(self.plan.stencil, nodes, self.plan.nc, self.data.carry)

    def _rows(self, given: list[list[Array]]) -> tuple[Array, Array, Array, Array]:
        """What the rows over the state add to the model, D r' r'ᵀ, d r' and curvature of y r: D, d
        and y (batch, N, rows), of squares 2c, 2cr and 2cr, and r' to (z, u). given: each member's
        arguments."""
        functions = self.program.functions
        terms = np.array(functions.state_terms, dtype=np.intp)
        weight, first = 2.0 * self.data.q[:, :, terms], self._squares
        of_weights, *others = functions.row_weights
        weight[..., first:] = self.data.q[:, :, of_weights]
        r, jac = live_rows(functions.state_jac, functions.state_sparsity, given, weight)
        shift = weight * r
        live, multiplier = weight[..., first:] != 0.0, shift.copy()
        for values, place in zip((shift, multiplier), others, strict=True):
            values[..., first:] = np.where(live, self.data.q[:, :, place], 0.0)
        return weight, shift, multiplier, jac

    def _add_bends(
        self, given: list[list[Array]], curved: NDArray[np.bool_], torque_jac: Array, hess: Array
    ) -> None:
        """Adds [I; U]ᵀ S [I; U] of exact terms to the members ``curved``; U: ``torque_jac``
        (batch, N, nu, 3n)."""
        own, size = self.program.functions.curvature, 3 * self.plan.n
        assert own is not None
        # bounded rows have their weights in q
        inputs = [[*a[:5], q.T, *a[6:]] for a, q in zip(given, self.data.q, strict=True)]
        eye = np.broadcast_to(np.eye(size), (*hess.shape[:2], size, size))
        chain = np.concatenate([eye, torque_jac], axis=2)
        add_bends(own, inputs, curved, chain, hess)

    def _add_contacts(
        self, given: list[list[Array]], curved: NDArray[np.bool_], gradient: Array, hess: Array
    ) -> None:
        size, steps = 3 * self.plan.n, self.plan.steps
        for k, exact in enumerate(curved.tolist()):
            if exact not in self._touches:
                self._touches[exact] = self._touch(exact)
            slope, flat = self._touches[exact].map(steps)(*self._with_jets(k, given[k]))
            gradient[k] += np.asarray(slope).T
            hess[k] += np.asarray(flat).reshape(size, steps, size).transpose(1, 0, 2)

    def _carry_back(self, carry: Array, hess: Array, gradient: Array, jac: Array) -> None:
        """A cycle's first two steps: slopes with respect to x_{-1} and x_0 become those with
        respect to what they are made of."""
        n = self.plan.n
        for i in (0, 1):
            for node in range(1 + i, 3):
                own = block(node, n)
                gradient[:, i, own] = np.matmul(gradient[:, i, None, own], carry)[:, 0]
                jac[:, i, :, own] = np.matmul(jac[:, i, :, own], carry)
                hess[:, i, :, own] = np.matmul(hess[:, i, :, own], carry)
                hess[:, i, own] = np.matmul(np.swapaxes(carry, 1, 2), hess[:, i, own])

    def _scatter(
        self, hess: Array, gradient: Array, rows: Array, out: tuple[Array, Array, Array]
    ) -> None:
        H, A, b = out
        s, n, m = self.plan.stencil, self.plan.n, self.plan.m
        H[:], A[:], b[:] = 0.0, 0.0, 0.0
        for i in range(self.plan.steps):
            slots = slots_of(s, i)
            scatter(slots, n, hess[:, i], gradient[:, i], H, b)
            for k in np.flatnonzero(s.test_row[i] >= 0):
                row, first, scale = (
                    s.test_row[i, k],
                    s.test_part[i, k] * m,
                    s.test_coefficient[i, k],
                )
                for node, unit, part, value in slots:
                    made = scale * value * rows[:, i, :, block(node, n)]
                    A[:, row, row - unit, first : first + m, block(part, n)] += made
