"""Exact second derivatives of terms over the state: what Gauss and Newton's model of E leaves out.

Of rows r with coefficients c it is S = Σ 2 c r ∂²r/∂(z, u)², z = (x_next, x, x_prev); of bounded
rows with shifts d it is Σ d ∂²r/∂(z, u)². The chain rule over the torques, u = U·FD, is left to
those who have the slopes of FD, and FD's own curvature to ∂E/∂u (``octo_derive_rows`` of
sparse_rows.c).

A centre of mass is a long expression of all coordinates: terms are differentiated to the two
centres, whose own derivatives have a closed form.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.dynamics import slots, symbolic
from octo.dynamics.codegen import check_curvature
from octo.dynamics.long import check_length
from octo.model.character import Character
from octo.problem.calls import Call, gradient, jacobian, with_numbers_of
from octo.problem.costs import Cost
from octo.problem.lane_tables import tables_text
from octo.problem.symbols import StepSymbols

NAME = "octo_state_curvature"
HINT = 'leave it at curvature="gauss_newton", or write it in fewer operations'


@dataclass(frozen=True, eq=False)
class StateCurvature:
    """S of the terms that ask for it, over a step or over two in a row.

    function: (x_next, x, x_prev, u, p, q, v if there are calls), or the inputs of two steps -> the
        nonzeros (NS,) of the upper triangle of S.
    sparsity: their places, as indices into (x_next, x, x_prev, u), or into four nodes and two
        torques.
    """

    function: ca.Function
    sparsity: ca.Sparsity

    @property
    def rows(self) -> NDArray[np.intp]:
        """(NS,) of the nonzeros."""
        return np.array(self.sparsity.row(), dtype=int)

    @property
    def columns(self) -> NDArray[np.intp]:
        """(NS,) of the nonzeros."""
        return np.array(self.sparsity.get_col(), dtype=int)

    def tables(self) -> str:
        """C text of their count and places, for curvature.c."""
        places = {"bend_row": self.rows, "bend_column": self.columns}
        return tables_text({"NS": len(self.rows)}, places, anew=True)


@dataclass(frozen=True, eq=False)
class CenteredStep(StepSymbols):
    """A time step whose centres of mass are symbols of their own.

    centers: (6,) m, at x_next and at x.
    """

    centers: ca.SX = field(kw_only=True)

    @classmethod
    def of(cls, step: StepSymbols) -> CenteredStep:
        """The same step with symbols for its centres of mass, none without bodies."""
        given = {each.name: getattr(step, each.name) for each in fields(step)} | {"calls": []}
        centers = ca.SX.sym("centers", 0 if step.robot is None else 6)
        made = cls(**given, centers=centers)
        if step.robot is not None:
            velocity = (centers[:3] - centers[3:]) / step.dt
            made.__dict__.update(com=centers[:3], com_velocity=velocity)
        return made


@dataclass(frozen=True, eq=False)
class CurvedTerm:
    """One term over a step, the residual ``r`` as an expression of a centred step.

    place: in the list of terms. first: the place of its first row among those over the state.
    calls: of stages of code, in ``r``.
    """

    place: int
    label: str
    r: ca.SX
    first: int
    calls: list[Call]


@dataclass(frozen=True, eq=False)
class CurvedTerms:
    """The terms over a step whose curvature is exact."""

    step: CenteredStep
    terms: list[CurvedTerm] = field(default_factory=list)

    def add(
        self,
        place: int,
        term: Cost,
        view: Mapping[str, ca.SX],
        first: int,
        calls: Sequence[Call] = (),
    ) -> None:
        """Takes a term in, whose references are ``view``, see :class:`CurvedTerm`; ``calls``: those
        of the step that is not centred, whose symbols v stand for what is given here too."""
        self.step.calls.clear()
        r = term.shaped(term.residual(self.step, view), view)
        own = with_numbers_of(calls, self.step.calls, r)
        self.terms.append(CurvedTerm(place, term.label, own[0], first, own[1]))

    def _weighted(
        self, q: ca.SX, own: ca.SX, squares: int
    ) -> Iterator[tuple[CurvedTerm, ca.SX, ca.SX, ca.SX]]:
        """Terms, residuals, and what is their weight and what their second derivatives are
        multiplied with: those of a square together, bounded ones one by one. ``own``: weights and
        shifts of the bounded rows, which stand after ``squares`` others."""
        bounded = own.numel() // 2
        for term in self.terms:
            if term.first < squares:
                yield term, term.r, q[term.place], 2.0 * q[term.place] * term.r
                continue
            for i in range(term.r.numel()):
                at = term.first - squares + i
                yield term, term.r[i], own[at], own[bounded + at]

    def derived(self, inputs: Sequence[ca.SX], squares: int, bounded: int) -> StateCurvature | None:
        """S as a function; None where it is zero whatever the numbers. Of the rows over the state
        the first ``squares`` are squares, the others ``bounded``; ``inputs``: p, q and v, if any.

        Raises
        ------
        ModelError: it is too long.
        """
        if not self.terms:
            return None
        p, q, *v = inputs
        step, own = self.step, ca.SX.sym("own", 2 * bounded)
        nodes = [step.x_next, step.x, step.x_prev]
        state = ca.vertcat(*nodes, step.u)
        size, centers = state.numel(), step.centers
        whole, pull = ca.SX(size, size), ca.SX(centers.numel(), 1)
        motion = _center_slopes(step)
        for term, r, weight, shift in self._weighted(q, own, squares):
            held = ca.SX.sym("held", r.numel())
            pulled, both = ca.dot(held, r), ca.vertcat(state, centers)
            what, slopes = f"second derivatives of {term.label}", gradient(term.calls, pulled, both)
            check_curvature(what, [both, held, p, q, *v], slopes, HINT)
            second, mixed, centered, slope = (
                gated(value, held, shift, weight)
                for value in _second(pulled, term.calls, state, centers)
            )
            whole += second
            if mixed.nnz():
                whole += mixed @ motion + (mixed @ motion).T
            if centered.nnz():
                whole += motion.T @ centered @ motion
            pull += slope
        if pull.nnz():
            assert step.character is not None
            n = step.x.numel()
            for t in range(2):
                at = slice(t * n, (t + 1) * n)
                whole[at, at] += _center_curvature(
                    step.character, motion[3 * t : 3 * t + 3, at], nodes[t], pull[3 * t : 3 * t + 3]
                )
        upper = ca.sparsify(ca.triu(whole))
        if not upper.nnz():
            return None
        value = ca.vertcat(*upper.nonzeros())
        if step.character is not None:
            at_nodes = [symbolic.center_of_mass(step.character, node) for node in nodes[:2]]
            value = ca.substitute(value, centers, ca.vertcat(*at_nodes))
        function = ca.Function(
            NAME, [*nodes, step.u, p, ca.vertcat(q, own), *v], [value], {"cse": True}
        )
        check_length("second derivatives of terms", function.n_instructions(), HINT)
        return StateCurvature(function, upper.sparsity())


def _second(pulled: ca.SX, calls: Sequence[Call], state: ca.SX, centers: ca.SX) -> Sequence[ca.SX]:
    """Second derivatives to the state, to the state and the centres, to the centres; and the first
    one to the centres."""
    n, both = state.numel(), ca.vertcat(state, centers)
    if calls:
        whole = jacobian(calls, gradient(calls, pulled, both), both)
    else:
        whole = ca.hessian(pulled, both)[0]
    return whole[:n, :n], whole[:n, n:], whole[n:, n:], gradient(calls, pulled, centers)


def nonzeros(matrix: ca.SX) -> ca.SX:
    """As a column, which may be empty."""
    return ca.vertcat(*matrix.nonzeros()) if matrix.nnz() else ca.SX(0, 1)


def gated(value: ca.SX, held: ca.SX, shift: ca.SX, weight: ca.SX) -> ca.SX:
    """With ``shift`` for ``held``, and zero where the weight is: a step that a term leaves out may
    have no finite residual."""
    value = ca.sparsify(value)
    numbers = ca.substitute(nonzeros(value), held, shift)
    return ca.SX(value.sparsity(), ca.if_else(weight != 0.0, numbers, 0.0))


def _center_slopes(step: CenteredStep) -> ca.SX:
    """(6, 3n + nu) derivatives of the centres of mass at x_next and at x, to (z, u)."""
    width, n, robot = 3 * step.x.numel() + step.u.numel(), step.x.numel(), step.character
    if robot is None:
        return ca.SX(0, width)
    slopes = [_center_slope(robot, node) for node in (step.x_next, step.x)]
    return ca.horzcat(ca.diagcat(*slopes), ca.SX(6, width - 2 * n))


def _center_slope(robot: Character, x: ca.SX) -> ca.SX:
    """(3, n) D_j = ∂com/∂x_j: the share of the mass that joint j carries, along its twist."""
    mass, moment = list(robot.masses), []
    poses = symbolic.body_poses(robot, x)
    for body, (R, t), m in zip(robot.bodies, poses, robot.masses, strict=True):
        moment.append((R @ ca.SX(body.com) + t) * m)
    for b in reversed(range(len(robot.bodies))):
        parent = robot.bodies[b].parent
        if parent >= 0:
            mass[parent] += mass[b]
            moment[parent] = moment[parent] + moment[b]
    owner = [b for b, body in enumerate(robot.bodies) for _ in body.joints]
    columns = [
        (ca.cross(turn, moment[b]) + mass[b] * move) / robot.mass
        for b, (turn, move) in zip(owner, symbolic.joint_twists(robot, x), strict=True)
    ]
    return ca.horzcat(*columns)


def _center_curvature(robot: Character, slope: ca.SX, x: ca.SX, pull: ca.SX) -> ca.SX:
    """(n, n) ∂²(pull·com)/∂x_i∂x_j = ω_i·(D_j × pull) for i that carries j."""
    turns = [turn for turn, _ in symbolic.joint_twists(robot, x)]
    whole = ca.SX(x.numel(), x.numel())
    for j, path in enumerate(slots.paths(robot)):
        arm = ca.cross(slope[:, j], pull)
        for i in path:
            value = ca.dot(turns[i], arm)
            if not value.is_zero():
                whole[i, j] = whole[j, i] = value
    return whole
