"""The problem as CasADi expressions: the same unknowns, rows, scales, weights and start as octo's
own.

For any solver of CasADi; IPOPT without a C compiler is one. The laws are those of
``dynamics.symbolic``, one step as an SX function that is mapped over the steps; every derivative is
CasADi's. It shares nothing with the compiled assembly but the residuals and the numbers: that is
what tests compare.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import Array, instance, numbers
from octo.dynamics import symbolic
from octo.dynamics.evaluate import RobotDynamics
from octo.errors import ProblemError
from octo.interrupts import postponed
from octo.model.terrain import World
from octo.problem.basis import Hermite
from octo.problem.calls import Calls
from octo.problem.compiled import CompiledProblem
from octo.problem.contact_model import contact_inputs
from octo.problem.problem import Problem
from octo.reference.rows import given_rows, limits, used


@dataclass(frozen=True, eq=False)
class Nlp:
    """Minimise f(x, p) over x_lower ≤ x ≤ x_upper subject to g_lower ≤ g(x, p) ≤ g_upper.

    Attributes
    ----------
    compiled: octo's own form of the problem, a batch of one.
    x, p, f, g: CasADi expressions; p are the run-time numbers (start, parameters, weights and
        references, row scales).
    parameters: values of p. start: of x, rad and m (tangents times τ in the Hermite basis).
    x_lower, x_upper, g_lower, g_upper: bounds; g is C of Eq. 7 without rows that no step adds to,
        in mg and mg·ℓ, then the rows of the constraints that have a bound, step by step.
    """

    compiled: CompiledProblem
    x: ca.MX
    p: ca.MX
    f: ca.MX
    g: ca.MX
    parameters: Array
    start: Array

    @property
    def symbols(self) -> dict[str, ca.MX]:
        """What ``casadi.nlpsol`` and others take."""
        return {"x": self.x, "p": self.p, "f": self.f, "g": self.g}

    @property
    def x_lower(self) -> Array:
        return np.full(len(self.start), -np.inf)

    @property
    def x_upper(self) -> Array:
        return np.full(len(self.start), np.inf)

    @property
    def g_lower(self) -> Array:
        return limits(self.compiled, places_of(self.compiled))[0]

    @property
    def g_upper(self) -> Array:
        return limits(self.compiled, places_of(self.compiled))[1]

    @property
    def arguments(self) -> dict[str, Array]:
        """Of one call of a CasADi solver: x0, p and the bounds."""
        bounds = {
            "lbx": self.x_lower,
            "ubx": self.x_upper,
            "lbg": self.g_lower,
            "ubg": self.g_upper,
        }
        return {"x0": self.start, "p": self.parameters, **bounds}

    @cached_property
    def objective(self) -> ca.Function:
        """(x, p) -> f."""
        return ca.Function("objective", [self.x, self.p], [self.f])

    @cached_property
    def gradient(self) -> ca.Function:
        """(x, p) -> ∇f."""
        return ca.Function("gradient", [self.x, self.p], [ca.gradient(self.f, self.x)])

    @cached_property
    def constraints(self) -> ca.Function:
        """(x, p) -> g."""
        return ca.Function("constraints", [self.x, self.p], [self.g])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(x, p) -> ∂g/∂x, sparse."""
        return ca.Function("jacobian", [self.x, self.p], [ca.jacobian(self.g, self.x)])

    @cached_property
    @postponed()
    def hessian(self) -> ca.Function:
        """(x, p, sigma, lam) -> ∇²(sigma f + lamᵀg), sparse, symmetric, exact."""
        sigma, lam = ca.MX.sym("sigma"), ca.MX.sym("lam", self.g.numel())
        lagrangian = sigma * self.f + ca.dot(lam, self.g)
        return ca.Function(
            "hessian", [self.x, self.p, sigma, lam], [ca.hessian(lagrangian, self.x)[0]]
        )

    def unknowns(self, x: Any) -> Array:
        """(1, K, nc) octo's unknowns of a point x."""
        return unknowns_of(self.compiled, x)


@postponed()
def nlp(problem: Problem, start: Array | None = None) -> Nlp:
    """The problem as functions of one vector x, for any solver.

    Parameters
    ----------
    start: nodes x_{-1} … x_N (N+2, nx), rad and m; by default x_0 held still, of a cycle carried
        along.
    """
    compiled = CompiledProblem([instance("problem", problem, Problem, "an octo.Problem")])
    compiled.check_squares("a reference solver", bounds=True)
    n, numbers = compiled.n, parameter_vector(compiled)
    x, p = ca.MX.sym("x", len(free_places(compiled))), ca.MX.sym("p", len(numbers))
    constant = ca.reshape(p[: n * (compiled.steps + 2)], n, compiled.steps + 2)
    rest = p[n * (compiled.steps + 2) :]
    nodes = ca.reshape(ca.mtimes(node_matrix(compiled), x), n, compiled.steps + 2) + constant
    step, (NP, NQ) = step_function(compiled), (compiled.p.shape[1], compiled.q.shape[2])
    dynamics, q = rest[:NP], ca.reshape(rest[NP : NP + NQ * compiled.steps], NQ, compiled.steps)
    q = q[: step.size1_in(4), :]  # without weights of bounded rows
    scale = rest[NP + NQ * compiled.steps :]
    repeated = [ca.repmat(v, 1, compiled.steps) for v in (dynamics, scale)]
    energy, rows, torques, bounded = step.map(compiled.steps)(
        nodes[:, 2:], nodes[:, 1:-1], nodes[:, :-2], repeated[0], q, repeated[1]
    )
    f = ca.sum2(energy) + _between(compiled, x, constant, q)
    f += _step_pairs(compiled, nodes, torques, dynamics, q)
    tested = compiled.plan.test_matrix
    tests = ca.sparsify(ca.DM(tested[tested.any(axis=1)]))
    g = ca.vec(ca.mtimes(rows, tests.T)) if compiled.m else ca.MX(0, 1)
    given = given_rows(compiled)
    if len(given):
        g = ca.vertcat(g, ca.vec(bounded)[given.tolist()])
    at = compiled.unknowns(start_nodes(problem, start)[None])
    return Nlp(compiled, x, p, f, g, numbers, point_of(compiled, at))


def start_nodes(problem: Problem, start: Array | None) -> Array:
    """(N+2, nx): what was given, or x_0 held still, of a cycle carried along."""
    shape = (problem.steps + 2, problem.dynamics.nx)
    if start is None and problem.closure is not None:
        start = problem.closure.along(problem.start, problem.steps)
    elif start is None:
        start = np.repeat(problem.start[None], shape[0], axis=0)
        start[0] -= problem.dt * problem.start_velocity
    return numbers("start", start, shape)


def free_places(compiled: CompiledProblem) -> NDArray[np.intp]:
    """Of each number of x its place in octo's unknowns (K, nc): those that move a node."""
    free = np.ones((compiled.K, compiled.nc), dtype=bool)
    free[compiled.fixed] = False
    for unit, part in compiled.idle:
        free[unit, part * compiled.n : (part + 1) * compiled.n] = False
    return np.flatnonzero(free)


def live_places(compiled: CompiledProblem) -> NDArray[np.intp]:
    """Of each row of g its place in C (K, ma): 0 = 0 is left out, IPOPT counts it as an
    equation."""
    return np.flatnonzero(np.repeat(compiled.plan.test_matrix.any(axis=1), compiled.m))


def places_of(compiled: CompiledProblem) -> NDArray[np.intp]:
    """Of each row of g its place among the bounded rows (N, rows), -1 of those of C."""
    return np.concatenate([np.full(len(live_places(compiled)), -1), given_rows(compiled)])


def point_of(compiled: CompiledProblem, unknowns: Array) -> Array:
    """x of octo's unknowns (1, K, nc)."""
    return unknowns.ravel()[free_places(compiled)]


def unknowns_of(compiled: CompiledProblem, x: Any) -> Array:
    """(1, K, nc) of x."""
    unknowns = np.zeros((1, compiled.K, compiled.nc))
    unknowns.flat[free_places(compiled)] = np.asarray(x, dtype=float).ravel()
    return unknowns


def rows_of(compiled: CompiledProblem, multipliers: Array, bounded: Array | None = None) -> Array:
    """Those of g of octo's multipliers (K, ma) and of those of the bounded rows (N, rows), by
    default zero."""
    own, given = multipliers.ravel()[live_places(compiled)], given_rows(compiled)
    if bounded is None or not bounded.size:
        return np.concatenate([own, np.zeros(len(given))])
    return np.concatenate([own, bounded.ravel()[given]])


def multipliers_of(compiled: CompiledProblem, rows: Any) -> Array:
    """(K, ma) of those of g."""
    multipliers = np.zeros((compiled.K, compiled.ma))
    live = live_places(compiled)
    multipliers.flat[live] = np.asarray(rows, dtype=float).ravel()[: len(live)]
    return multipliers


def node_variables(compiled: CompiledProblem) -> NDArray[np.intp]:
    """(N+2, slots) first of the n numbers of x that a slot of a node takes, -1 where none."""
    s, place = compiled.stencil, free_places(compiled)
    variable = np.full(compiled.K * compiled.nc, -1)
    variable[place] = np.arange(len(place))
    return np.where(s.unit >= 0, variable[(s.unit * s.parts + s.part) * compiled.n], -1)


def parameter_vector(compiled: CompiledProblem) -> Array:
    """p: the part of the nodes that no unknown moves (N+2, nx), parameters (NP,), q (N, NQ), row
    scales (m,)."""
    c = compiled
    parts = c.constant[0], c.p[0], used(c), c.row_scale[0]
    return np.concatenate([part.ravel() for part in parts])


def node_matrix(compiled: CompiledProblem) -> ca.DM:
    """((N+2)·nx, size of x) sparse: what x adds to x_{-1} … x_N."""
    variable, n = node_variables(compiled), compiled.n
    rows, columns, values = [], [], []
    for node, slot in zip(*np.nonzero(variable >= 0), strict=True):
        own = np.eye(n) if compiled.carry is None or node > 1 else compiled.carry[0]
        i, j = np.nonzero(own)
        rows.append(node * n + i)
        columns.append(variable[node, slot] + j)
        values.append(compiled.stencil.coefficient[node, slot] * own[i, j])
    shape = (n * (compiled.steps + 2), len(free_places(compiled)))
    flat = [np.concatenate(a).tolist() for a in (rows, columns, values)]
    return ca.DM.triplet(flat[0], flat[1], ca.DM(flat[2]), *shape)


def step_function(compiled: CompiledProblem) -> ca.Function:
    """(x_next, x, x_prev, p, q, row_scale) -> the step's part of E, the scaled unactuated rows of
    FD, its torques, the bounded rows."""
    dynamics, functions, calls = compiled.dynamics, compiled.functions, compiled.functions.calls
    *nodes, _, p, q = functions.state.sx_in()[:6]
    given = functions.state.sx_in()[6:]
    scale = ca.SX.sym("scale", compiled.m)
    if isinstance(dynamics, RobotDynamics) and isinstance(dynamics.terrain, World):
        raise ProblemError(
            "octo.reference.nlp writes the ground as an expression, an octo.World has none: "
            "terrain must be an octo.Plane or an octo.Terrain"
        )
    fd = dynamics.symbolic(*nodes, p)
    u = fd[[int(j) for j in dynamics.actuated]]
    r = functions.state(*nodes, u, p, q, *given)
    squares = r.numel() - len(functions.bounded)
    r, bounded = r[:squares], r[squares:]
    energy = (
        ca.dot(ca.vertcat(*[q[k] for k in functions.state_terms[:squares]]), r**2)
        if squares
        else ca.SX(0)
    )
    if functions.contact is not None and isinstance(dynamics, RobotDynamics):
        own = functions.contact
        poses = [symbolic.body_poses(dynamics.character, node) for node in nodes]
        for index, use in zip(own.spheres, own.use.astype(float), strict=True):
            r = own.value(*contact_inputs(dynamics.character, index, poses), p, q)
            energy += ca.dot(
                ca.vertcat(*[q[t] * u for t, u in zip(own.terms, use, strict=True)]), r**2
            )
    rows = scale * fd[[int(j) for j in dynamics.unactuated]]
    outputs = [energy, *map(ca.densify, (rows, u, bounded))]
    made = ca.Function("step", [*nodes, p, q, scale, *given], outputs, {"cse": True})
    return _with_calls(calls, made, ca.Function("torques", [*nodes, p], [u])) if calls else made


def _with_calls(calls: Calls, step: ca.Function, torques: ca.Function) -> ca.Function:
    """``step`` without its last input v: what stages of code give, each by its Python and with its
    own derivatives."""
    inputs = [ca.MX.sym(step.name_in(k), step.size1_in(k)) for k in range(6)]
    nodes, p, q = inputs[:3], inputs[3], inputs[4]
    over = [*nodes, torques(*nodes, p), p, q]
    v = ca.MX.zeros(calls.size)
    for stage, argument, at in zip(calls.stages, calls.arguments, calls.at, strict=False):
        v[at : at + stage.outputs] = stage.function(argument(*over, v))
    return ca.Function("step", inputs, step(*inputs, v))


def _step_pairs(
    compiled: CompiledProblem, nodes: ca.MX, torques: ca.MX, p: ca.MX, q: ca.MX
) -> ca.MX:
    """Terms over two steps in a row, from all nodes and torques; of a cycle the last step, carried
    back, comes before the first."""
    own, first = compiled.functions.pairs, int(compiled.carry is None)
    count = compiled.steps - first
    if own is None or not count:
        return ca.MX(0)
    inputs = own.value.sx_in()
    energy = ca.dot(ca.vertcat(*[inputs[-1][k] for k in own.terms]), own.value(*inputs) ** 2)
    if compiled.carry is not None:
        carry, motors = compiled.carry[0], compiled.dynamics.actuated
        oldest = nodes[:, 0] + ca.DM(carry) @ (nodes[:, -3] - nodes[:, -2])
        nodes = ca.horzcat(oldest, nodes)
        torques = ca.horzcat(ca.DM(carry[np.ix_(motors, motors)]) @ torques[:, -1], torques)
    window = [nodes[:, 3 - k : 3 - k + count] for k in range(4)]
    return ca.sum2(
        ca.Function("step_pair", inputs, [energy], {"cse": True}).map(count)(
            *window, torques[:, 1:], torques[:, :-1], ca.repmat(p, 1, count), q[:, first:]
        )
    )


def _between(compiled: CompiledProblem, x: ca.MX, constant: ca.MX, q: ca.MX) -> ca.MX:
    """Terms over neighbouring Hermite controls c_0 … c_Z."""
    total = ca.MX(0)
    if not compiled.functions.between:
        return total
    assert isinstance(compiled.basis, Hermite)
    segment, n = compiled.basis.steps_per_segment, compiled.n
    full = ca.MX(ca.DM(compiled.ends[0].T))
    full[free_places(compiled).tolist()] = x
    first = ca.vertcat(constant[:, 1], segment * (constant[:, 1] - constant[:, 0]))
    controls = ca.horzcat(first, full[:, :-1])
    now = ca.SX.sym("c", 2 * n)
    following = ca.SX.sym("c_next", 2 * n)
    row = ca.SX.sym("q", compiled.q.shape[2])
    for k, function in compiled.functions.between:
        r = function(now, following, row)[0]
        square = ca.Function("square", [now, following, row], [ca.sumsqr(r)]).map(compiled.K - 1)
        weight = ca.sum1(ca.reshape(q[k, :], segment, compiled.K - 1))
        total += ca.dot(
            weight, square(controls[:, :-1], controls[:, 1:], q[:, segment - 1 :: segment])
        )
    return total
