"""One plan a measurement: real-time iteration (§7; Diehl, Bock and Schlöder 2005)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from octo.checks import instance, one_of, positive, whole
from octo.errors import ProblemError, ShapeError, ValueRangeError, said
from octo.model.convention import Convention
from octo.model.quantities import Array
from octo.mpc.command import Command, CommandStatus
from octo.mpc.iteration import Iteration
from octo.mpc.limits import MU, held_by_the_ground, torque_bounds
from octo.mpc.low_level import LowLevel, default_damping, default_stiffness, gains
from octo.mpc.measurement import check_device, checked, checked_time, measured, robot_of, time_of
from octo.mpc.plan import Grid, Plan
from octo.mpc.readings import Readings
from octo.mpc.tuning import Tuning
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solver.receding import RecedingHorizon
from octo.solver.receding_bounds import bounds_of
from octo.solver.receding_interpreted import InterpretedHorizon

Guide = Callable[["Controller", float, Array], None]

CURVATURES = ("gauss-newton", "exact")
SIGMA = 1e-5  # of one iteration a tick: 1e-7 … 1e-3 make no difference
SETTLE = 40  # iterations at a reset, from the pose held still
GIVE_UP = 5  # calls without a step after which the plan begins anew from the pose measured
WORST = 20.0  # relative to mg: a plan with a larger residual breaks the laws of physics
TOLERANCE = 0.25  # of dt: a plan prepared for a time that near serves this one


class Controller:
    """Receding-horizon control of a robot by one problem, compiled once.

    Parameters
    ----------
    problem: its N and dt are the horizon, in the basis "nodes". Its x0 is the first plan's.
    iterations: of Gauss-Newton in one call.
    budget: s, of one call; None is no limit. The best plan that was ready by then is returned.
    device: "cpu"; "auto" means that too and logs once that this version has no loop on a GPU.
        Without a C compiler a call takes 70 times as long.
    convention: form of q and v, "mujoco" or "pinocchio" (see
        :class:`octo.model.convention.Convention`).
    curvature: "gauss-newton", or "exact": that of λᵀC and of the torque terms too.
    sigma: the regularisation weight on the diagonal of H.
    stiffness, damping: kp (N m/rad) and kd of the low level's joints, numbers or (nu,); by default
        1.1·mg·ℓ and 0.23·√(ℓ/g)·kp.
    guide: called as ``guide(controller, t, x)`` before each plan, with the expected configuration:
        it may change references. Its ``reset()``, where it has one, is called at a reset of the
        controller.

    Raises
    ------
    ProblemError, DeviceError, ValueRangeError, UnknownNameError: naming the argument and what is
        allowed. No call of
    ``step``, ``prepare``, ``feedback`` or ``command`` raises, unless the guide does.
    """

    def __init__(
        self,
        problem: Problem,
        iterations: int = 1,
        budget: float | None = None,
        device: str = "cpu",
        convention: str = "mujoco",
        *,
        curvature: str = "gauss-newton",
        sigma: float = SIGMA,
        stiffness: float | Array | None = None,
        damping: float | Array | None = None,
        guide: Guide | None = None,
    ):
        check_device(device)
        robot = robot_of(problem)
        if guide is not None and not callable(guide):
            raise ProblemError(
                f"guide is {said(guide)}, must be a function guide(controller, t, x)"
            )
        one_of("curvature", curvature, CURVATURES)
        problem, self._most_friction = held_by_the_ground(problem)
        self.problem, self.robot = problem, robot
        self.iterations, self.exact = whole("iterations", iterations), curvature == "exact"
        self.budget = None if budget is None else positive("budget", budget, "s")
        self.convention = Convention(self.robot, convention)
        self.compiled = CompiledProblem([problem])
        self.compiled.check_squares("the controller", bounds=True)
        self.compiled.prepare()
        self._tuning = Tuning(self.compiled, problem)
        ground = dict(zip(problem.dynamics.layout.names, problem.p.tolist(), strict=True))
        self.first_ground = ground.get("terrain.height", 0.0)  # m
        fast = self.compiled.library is not None
        horizon = RecedingHorizon if fast else InterpretedHorizon
        self.horizon = horizon(self.compiled, positive("sigma", sigma))
        self.dt, self.guide = float(problem.dt), guide
        limit = torque_bounds(problem)
        self.limit, self._has_limit = limit, np.isfinite(limit) & (limit > 0.0)
        nu, stiff = robot.nu, default_stiffness(problem) if stiffness is None else stiffness
        kp = gains("stiffness", stiff, nu)
        kd = gains("damping", default_damping(problem, kp) if damping is None else damping, nu)
        self._grid = Grid(problem.steps, self.dt, self.robot.actuated, self.robot.nx)
        self._low = LowLevel(self._grid, self.convention.actuated_q, kp, kd, limit)
        hinge = np.array([joint.kind == "hinge" for joint in self.robot.joints])
        bounds = bounds_of(self.compiled)
        self._iteration = Iteration(self.horizon, hinge, sigma, self.exact, bounds)
        self._readings = Readings(self.convention, self.dt)
        self.reset()

    @property
    def kp(self) -> Array:
        """(nu,) N m/rad or N/m of the low level, to be written in place."""
        return self._low.kp

    @property
    def kd(self) -> Array:
        """(nu,) N m s/rad or N s/m of the low level, to be written in place."""
        return self._low.kd

    # -- references, weights, parameters -----------------------------------------------------------

    def reference(self, label: str, name: str) -> Array:
        """(N, size) of a term's references, to be written in place: the next plan follows it.
        Nothing is recompiled."""
        return self._tuning.reference(label, name)

    def update(self, label: str, **values: Any) -> None:
        """Change a term's fields: ``update("BaseHeight", height=0.3, weight=40.0)``. Its scale
        stays that of the problem.

        Raises
        ------
        UnknownNameError: no such term or field. ProblemError: a field that is compiled into the
            controller, such as a body, a
        function or contacts, or one that only scales E. ShapeError, ValueRangeError: what the term
        refuses.
        """
        self.problem = self._tuning.update(self.problem, label, values)

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Change run-time parameters of the dynamics by name: ``{"terrain.height": 0.1,
        "contact.mu": 0.5}``; not dt, and no more friction than hard cones allow."""
        if not (friction := values.get(MU, 0.0)) <= self._most_friction:
            raise ValueRangeError(
                f"parameter {MU} is {friction}, must be at most {self._most_friction:g}, that of "
                "the problem's FrictionCones"
            )
        self._tuning.set_parameters(values)

    # -- the first plan ----------------------------------------------------------------------------

    def reset(self, q: Array | None = None, v: Array | None = None, t: float = 0.0) -> None:
        """Forget the plan; make a new one from q (nq,) and v (nv,), by default the problem's start
        at rest.

        Raises
        ------
        ShapeError, ValueRangeError: q or v have another shape, are not finite or out of all bounds.
        """
        nodes, t = self.horizon.nodes, checked_time(t)
        if q is None:
            x = self.problem.start
            before = self.problem.start - self.dt * self.problem.start_velocity
        else:
            rate = np.zeros(self.convention.nv) if v is None else v
            place, speed = checked(q, rate, self.convention)
            x, before = self.convention.to_octo(place, speed, self.dt, self.problem.start)
        nodes[:] = x
        nodes[0] = before
        self._forget(x)
        if self.guide is not None:
            getattr(self.guide, "reset", lambda: None)()
            self.guide(self, t, x.copy())
        good = True
        self.horizon.evaluate()
        for _ in range(SETTLE):
            self._iteration.prepare()
            good = self._step() and self._is_motion()
            self._iteration.learn(good)
            if not good or np.max(np.abs(self.horizon.step)) < 1e-3:
                break
        if not good:  # stand still
            nodes[:], nodes[0] = x, before
            self._iteration.bounds.forget()
            self.horizon.evaluate()
        self._take(t, solved=good)

    def _forget(self, x: Array) -> None:
        self._iteration.forget()
        self._readings.forget()
        self._near, self._prepared = x.copy(), np.nan
        self._worst, self._energy, self._violation, self._failures = 0.0, np.nan, np.nan, 0
        self._clipped, self._beyond = 0.0, 0.0
        self._gain_nodes = np.zeros((3, self.robot.nx))
        self._gain = np.zeros((self.robot.nx, 2 * self.robot.nx))

    def warm_start(self, solution: Solution, t: float = 0.0) -> None:
        """Take a solution's motion and multipliers, from its start on, as the plan from time ``t``
        on.

        Raises
        ------
        ProblemError: no solution. ShapeError: of another robot, or shorter than the horizon.
            ValueRangeError: another dt.
        """
        N, n, t = self.problem.steps, self.robot.nx, checked_time(t)
        instance("solution", solution, Solution, "a Solution")
        if solution.x.shape[1] != n or solution.steps < N:
            raise ShapeError("solution.x", solution.x.shape, f"(at least {N + 2}, {n})")
        if abs(solution.dt - self.dt) > 1e-12:
            raise ValueRangeError(
                f"solution.dt is {solution.dt} s, must be the controller's {self.dt} s"
            )
        self._forget(solution.x[1])
        self.horizon.nodes[:] = solution.x[: N + 2]
        if solution.multipliers.shape[1:] == self.horizon.lam.shape[1:]:
            self.horizon.guess[2:] = solution.multipliers[:N]
        self.horizon.evaluate()
        self._take(t, solved=False)

    @property
    def plan(self) -> Plan:
        """The plan that commands are read from. It is never changed, the next one takes its place
        at once."""
        return self._plan

    # -- one measurement ---------------------------------------------------------------------------

    def step(self, t: float, q: Array, v: Array) -> Command:
        """A new plan from the measurement q (nq,), v (nv,) at time t (s), and the command that
        starts it."""
        began = time.perf_counter()
        t, q, v = time_of(t), measured(q, self.convention.nq), measured(v, self.convention.nv)
        status = self._readings.refuse(t, q, v, self._plan.end)
        ahead = 0.0
        if status is None and not abs(self._prepared - t) <= TOLERANCE * self.dt:
            self.prepare(t)
            ahead = time.perf_counter() - began
        return self._feedback(t, q, v, began, ahead, status)

    def prepare(self, t: float | None = None) -> None:
        """What can be done before the measurement at time ``t`` (by default one tick after the last
        one) arrives."""
        plan, t = self._plan, time_of(t)
        if not np.isfinite(t):
            last = self._readings.time
            t = last + self._readings.tick if np.isfinite(last) else plan.time
        plan.shift(t, self.horizon.nodes)
        self._iteration.bounds.shift(*plan.place(t))
        if self.guide is not None:
            self.guide(self, t, self.horizon.nodes[1].copy())
        if self._failures >= GIVE_UP:
            self.horizon.nodes[:] = self._near
            self.horizon.guess[:] = 0.0
            self._iteration.bounds.forget()
            self._failures = 0
        elif self.exact:
            self._shift_multipliers(t)
        self._iteration.prepare()
        self._prepared = t

    def feedback(self, t: float, q: Array, v: Array) -> Command:
        """The rest of :meth:`step` after :meth:`prepare`."""
        return self.step(t, q, v)

    def _shift_multipliers(self, t: float) -> None:
        """Those of the plan, moved by the whole steps that have passed."""
        i = min(int(round((t - self._plan.time) / self.dt)), self.problem.steps - 1)
        guess = self.horizon.guess[2:]
        if i > 0:
            guess[:-i] = guess[i:].copy()

    def _feedback(
        self, t: float, q: Array, v: Array, began: float, ahead: float, status: CommandStatus | None
    ) -> Command:
        done = 0
        if status is None:
            late = t > self._plan.end
            self._readings.take(t, q, v)
            x, before = self.convention.to_octo(q, v, self.dt, self._near)
            self._near = x
            status, done = self._improve(t, x, before, began)
            solved = status is CommandStatus.SOLVED
            self._failures = 0 if solved else self._failures + (status is not CommandStatus.BUDGET)
            if solved and late:
                status = CommandStatus.LATE
            self._prepared = np.nan
        return self._command(t, status, began, ahead, done)

    def _improve(
        self, t: float, x: Array, before: Array, began: float
    ) -> tuple[CommandStatus, int]:
        """Iterations from the shifted plan and the measurement, until the budget runs out."""
        horizon, iteration, done = self.horizon, self._iteration, 0
        horizon.nodes[0], horizon.nodes[1] = before, x
        if self._spent(began):
            return CommandStatus.BUDGET, 0
        if self.iterations > 1:
            horizon.evaluate()
        for k in range(self.iterations):
            if k:
                if self._spent(began, (time.perf_counter() - began) / k):
                    break
                iteration.prepare()
            good = self._step()
            iteration.learn(good)
            if self._spent(began) and not done:
                return CommandStatus.BUDGET, 0
            if good:
                if not self._is_motion():
                    iteration.learn(False)
                    return (CommandStatus.SOLVED, done) if done else (CommandStatus.DIVERGED, 0)
                self._take(t)
                done += 1
        return (CommandStatus.SOLVED, done) if done else (CommandStatus.FAILED, 0)

    def _step(self) -> bool:
        return self._iteration.better() if self.iterations > 1 else self._iteration.whole()

    def _spent(self, began: float, needed: float = 0.0) -> bool:
        return self.budget is not None and time.perf_counter() - began + needed > self.budget

    def _is_motion(self) -> bool:
        """Whether the horizon's nodes could be the plan."""
        worst = float(np.abs(self.horizon.C).max(initial=0.0))
        return bool(np.isfinite(self.horizon.energy)) and worst <= WORST

    def _take(self, t: float, solved: bool = True) -> None:
        """Make the horizon's nodes the plan; ``solved``: its last factorisation led to them."""
        horizon = self.horizon
        u = horizon.fd[:, self.robot.actuated]
        if not np.isfinite(u).all():
            u = np.zeros_like(u)
        ratio = np.abs(u[:, self._has_limit]) / self.limit[self._has_limit]
        self._worst, self._energy = float(ratio.max(initial=0.0)), horizon.energy
        self._clipped = max(float(ratio[0].max(initial=0.0)) - 1.0, 0.0)
        self._beyond = self._iteration.bounds.excess(horizon)
        self._violation = float(np.abs(horizon.C).max(initial=0.0))
        self._gain_nodes[:] = horizon.nodes[:3]
        if solved:
            self._gain[:] = horizon.gain()
        self._plan = Plan(self._grid, t, horizon.nodes, self._limited(u))
        self._iteration.bounds.keep()

    # -- commands ----------------------------------------------------------------------------------

    def _command(
        self, t: float, status: CommandStatus, began: float, ahead: float, done: int
    ) -> Command:
        plan = self._plan
        when = t if np.isfinite(t) else plan.time
        u = plan.at(when)[2]
        x, rate, _ = plan.at(when + self._readings.tick)
        gain, nodes = self._gain.copy(), self._gain_nodes.copy()
        later = (lambda: self._gains(gain, nodes), lambda: self.convention.from_octo(x, rate))
        of_plan = (self._worst, self._energy, self._violation, self._clipped, self._beyond)
        took = time.perf_counter() - began
        return Command(self._limited(u), plan.end, status, took, ahead, done, *of_plan, *later)

    def _gains(self, gain: Array, nodes: Array) -> Array:
        """du_0/d(x_0, x_{-1}) of the plan through nodes x_{-1}, x_0, x_1 (3, n), on the
        convention's tangent space."""
        n, dynamics = self.robot.nx, self.problem.dynamics
        jac = dynamics.evaluate(nodes[None], self.compiled.p, order=1)[1]
        assert jac is not None
        rows = jac[0, 0][self.robot.actuated]
        place = rows[:, n : 2 * n] + rows[:, :n] @ gain[:, :n]
        past = rows[:, 2 * n :] + rows[:, :n] @ gain[:, n:]
        tangent = self.convention.tangent(nodes[1])
        return np.concatenate([(place + past) @ tangent, -self.dt * past @ tangent], axis=1)

    def command(self, t: float, q: Array, v: Array) -> Array:
        """u (nu,) of the low level at time t, in microseconds: planned torques and a spring and
        damper to the planned joints.

        May be called in another thread than the rest. A joint that is not measured follows the
        plan's torque.
        """
        measurement = measured(q, self.convention.nq), measured(v, self.convention.nv)
        return self._low(self._plan, time_of(t), *measurement)

    def _limited(self, u: Array) -> Array:
        return np.asarray(np.minimum(np.maximum(u, -self.limit), self.limit))
