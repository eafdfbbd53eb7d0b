"""Implicit simulation: solve FD(x_next, x, x_prev, p) = Uᵀu for x_next, step after step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import (
    Array,
    instance,
    number,
    numbers,
    one_of,
    positive,
    room,
    steps_in,
    time_step,
    whole,
)
from octo.dynamics.evaluate import Dynamics, RobotDynamics, check_surroundings, modelled
from octo.dynamics.laws import ContactLaw
from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.scene import Scene
from octo.model.terrain import Ground

Controls = Array | Callable[[float, Array, Array], Array]

# m or rad: the displacement that the remaining force gives the joint's own inertia in one step
TOLERANCE = 1e-10
ITERATIONS = 60
CONTINUATIONS = 40
MOST_DAMPING = 1e12
LONGEST = 0.5  # m or rad, of one Newton step: linearised rotations mean nothing beyond


@dataclass(frozen=True, eq=False)
class Motion:
    """What a simulation did.

    Attributes
    ----------
    x: (N+2, nx) rad and m, x_{-1}, x_0, x_1 … x_N; the start is x[1].
    u: (N, nu) N m or N, u[i] acts from x_i to x_{i+1}.
    dt: s.
    converged: (N,) whether FD = Uᵀu was solved in this step.
    residual: (N,) what was left of it, in m or rad of displacement in one step.
    """

    x: Array
    u: Array
    dt: float
    converged: NDArray[np.bool_]
    residual: Array

    @property
    def time(self) -> Array:
        """(N+1,) s, of x_0 … x_N."""
        return np.asarray(self.dt * np.arange(len(self.u) + 1), dtype=float)

    @property
    def velocity(self) -> Array:
        """(N+1, nx) rad/s and m/s, backward differences: at x_0 … x_N."""
        return np.asarray(np.diff(self.x, axis=0) / self.dt, dtype=float)


class Stepper:
    """Solves one implicit step, over all rows or over some coordinates with the others held.

    Parameters
    ----------
    dynamics: FD.
    p: (NP,) its parameters.
    free: indices of the coordinates (and rows) that are solved for; all by default.
    """

    def __init__(self, dynamics: Dynamics, p: Array, free: NDArray[np.intp] | None = None):
        self.dynamics = dynamics
        self.p = np.array(p, dtype=float).reshape(1, -1)  # its own: shorter steps change dt
        self.free = np.arange(dynamics.nx) if free is None else np.asarray(free, dtype=np.intp)
        self._square = np.ix_(self.free, self.free)
        self._nodes = np.empty((1, 3, dynamics.nx))

    def __call__(self, x: Array, x_prev: Array, load: Array | None = None) -> tuple[Array, float]:
        """x_next (nx,) with FD(x_next, x, x_prev) = load (nx,) in the free rows, and the residual
        left, m or rad.

        Newton from the extrapolated configuration; where that fails, along the solutions of shorter
        steps; where a solution ends before the whole step, descent from the configuration that
        stands still.
        """
        load = np.zeros(len(x)) if load is None else load
        self._nodes[0, 0], self._nodes[0, 1] = x_prev, x
        best, left = self._newton(2.0 * x - x_prev, load)
        for fallback in (self._continue, self._descend):
            if left > TOLERANCE:
                tried, residual = fallback(load)
                if residual < left:
                    best, left = tried, residual
        return best, left

    def _continue(self, load: Array) -> tuple[Array, float]:
        """Newton along solutions of shorter steps, dt·s with s from 0 to 1, each from the last."""
        x_prev, x = self._nodes[0, 0].copy(), self._nodes[0, 1].copy()
        place = self.dynamics.layout.index("dt")
        dt = self.p[0, place]
        solved, rate, reached, advance = x, x - x_prev, 0.0, 0.25
        for _ in range(CONTINUATIONS):
            s = min(1.0, reached + advance)
            self.p[0, place], self._nodes[0, 0] = s * dt, x - s * (x - x_prev)
            x_next, left = self._newton(x + s * rate, load)
            if left <= TOLERANCE:
                solved, rate, reached, advance = x_next, (x_next - x) / s, s, 1.5 * advance
                if s == 1.0:
                    break
            else:
                advance *= 0.4
        self.p[0, place], self._nodes[0, 0] = dt, x_prev
        return (solved, 0.0) if reached == 1.0 else self._newton(x + rate, load)

    def _evaluate(self, x_next: Array, load: Array, order: int) -> tuple[Array, Array]:
        """FD - load (free,) at x_next and its derivatives (nx, 3 nx), of order 1."""
        self._nodes[0, 2] = x_next
        fd, jac, _ = self.dynamics.evaluate(self._nodes, self.p, order=order)
        return (fd[0, 0] - load)[self.free], np.empty(0) if jac is None else jac[0, 0]

    def _at(self, start: Array) -> Array:
        """The configuration x with the free coordinates of ``start``."""
        x_next = self._nodes[0, 1].copy()
        x_next[self.free] = start[self.free]
        return x_next

    def _newton(self, start: Array, load: Array) -> tuple[Array, float]:
        """Newton that shortens a step until the scaled force shrinks; it ends where none does."""
        n = self.dynamics.nx
        x_next = self._at(start)
        force, jac = self._evaluate(x_next, load, 1)
        scale = _scale(jac[:, 2 * n :][self._square])
        norm = float(np.linalg.norm(scale * force))
        for _ in range(ITERATIONS):
            if not norm > TOLERANCE:
                break
            change = _shortened(_solve(jac[:, :n][self._square], -force))
            length = 1.0
            while length > 0.05:
                trial = x_next.copy()
                trial[self.free] += length * change
                tried_norm = float(np.linalg.norm(scale * self._evaluate(trial, load, 0)[0]))
                if tried_norm <= (1.0 - 1e-4 * length) * norm:
                    break
                length *= 0.5
            else:
                break
            x_next, norm = trial, tried_norm
            force, jac = self._evaluate(x_next, load, 1)
        return x_next, norm if np.isfinite(norm) else np.inf

    def _descend(self, load: Array) -> tuple[Array, float]:
        """Descent on the potential whose gradient FD nearly is (all but friction): the inertia's
        plus V(x_next).

        Its matrix is made positive definite with the inertia M/dt² at rest; a step is accepted by
        the slope force·change at its end, which must not have grown past the one at its start.
        """
        n, x = self.dynamics.nx, self._nodes[0, 1].copy()
        still = np.repeat(x[None, None], 3, axis=1)
        at_rest = self.dynamics.evaluate(still, self.p, order=1)[1]
        assert at_rest is not None
        inertia = at_rest[0, 0][:, 2 * n :][self._square]
        scale = _scale(inertia)
        inertia = inertia + 1e-3 * np.diag(1.0 / scale)  # the base's chart is singular somewhere
        x_next, damping = x, 0.0
        force, jac = self._evaluate(x_next, load, 1)
        best, left = x_next, float(np.linalg.norm(scale * force))
        for _ in range(3 * ITERATIONS):
            if not left > TOLERANCE:
                break
            matrix = jac[:, :n][self._square]
            while damping <= MOST_DAMPING and not _definite(matrix + damping * inertia):
                damping = max(0.25, 2.0 * damping)
            change = _shortened(_solve(matrix + damping * inertia, -force))
            trial = x_next.copy()
            trial[self.free] += change
            tried, tried_jac = self._evaluate(trial, load, 1)
            slope = float(force @ change)
            if not float(tried @ change) <= 0.9 * abs(slope):
                damping = max(0.25, 4.0 * damping)
                if damping > MOST_DAMPING:
                    break
                continue
            x_next, force, jac = trial, tried, tried_jac
            damping = 0.0 if damping <= 0.25 else 0.25 * damping
            norm = float(np.linalg.norm(scale * force))
            if norm < left:
                best, left = x_next, norm
        return best, left if np.isfinite(left) else np.inf


def _scale(inertia: Array) -> Array:
    """(free,) displacement in one step per unit of force: the inverse of the diagonal of M/dt²."""
    diagonal = np.abs(np.diag(inertia))
    return 1.0 / np.maximum(diagonal, 1e-12 * np.max(diagonal))


def _shortened(change: Array) -> Array:
    return change * min(1.0, LONGEST / max(float(np.max(np.abs(change))), 1e-300))


def _definite(matrix: Array) -> bool:
    try:
        np.linalg.cholesky(matrix + matrix.T)
    except np.linalg.LinAlgError:
        return False
    return True


def _solve(matrix: Array, right: Array) -> Array:
    """Newton's step; none at all (zero) where the matrix is singular or not finite."""
    try:
        change = np.asarray(np.linalg.solve(matrix, right), dtype=float)
    except np.linalg.LinAlgError:
        return np.zeros_like(right)
    return change if np.isfinite(change).all() else np.zeros_like(right)


def step(dynamics: Dynamics, x: Array, x_prev: Array, u: Array | None, p: Array) -> Array:
    """x_next (nx,) with FD(x_next, x, x_prev, p) = Uᵀu.

    Parameters
    ----------
    x, x_prev: (nx,) rad and m.
    u: (nu,) N m or N; None for zero.
    p: (NP,).
    """
    load = np.zeros(dynamics.nx)
    if u is not None:
        load[dynamics.actuated] = numbers("u", u, (dynamics.nu,))
    now, before = numbers("x", x, (dynamics.nx,)), numbers("x_prev", x_prev, (dynamics.nx,))
    return Stepper(dynamics, p)(now, before, load)[0]


def simulate(
    model: Character | Scene | Dynamics,
    x0: Array,
    v0: Array | None = None,
    controls: Controls | None = None,
    *,
    seconds: float | None = None,
    steps: int | None = None,
    dt: float = 0.025,
    terrain: Ground | None = None,
    law: ContactLaw | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Motion:
    """Roll the dynamics out.

    Parameters
    ----------
    model: a Character, a Scene, or any Dynamics (then without terrain and law).
    x0, v0: (nx,) the start and its velocity, rad, m, rad/s, m/s; v0 is zero by default.
    controls: (N, nu) N m or N, or a callable ``controls(t, q, v) -> (nu,)``; zero by default.
    seconds, steps: how long; one of them, or neither with an array of controls.
    dt: s.
    parameters: run-time parameters of the dynamics by name.

    Raises
    ------
    ProblemError, ShapeError, ValueRangeError, UnknownNameError: naming the argument and what is
        allowed.
    """
    check_surroundings(terrain, law, model)
    model = modelled(model)
    dynamics = model if isinstance(model, Dynamics) else RobotDynamics(model, law, terrain)
    dt = time_step(dt) if isinstance(dynamics, RobotDynamics) else positive("dt", dt, "s")
    p = parameters_of(dynamics, dt, {} if parameters is None else parameters)
    x0 = numbers("x0", x0, (dynamics.nx,))
    v0 = np.zeros(dynamics.nx) if v0 is None else numbers("v0", v0, (dynamics.nx,))
    N, control = _schedule(controls, seconds, steps, dt, dynamics.nx, dynamics.nu)
    stepper = Stepper(dynamics, p)
    x, u = np.empty((N + 2, dynamics.nx)), np.zeros((N, dynamics.nu))
    x[0], x[1] = x0 - dt * v0, x0
    residual, load = np.empty(N), np.zeros(dynamics.nx)
    for i in range(N):
        if control is not None:
            u[i] = control(i, x[i + 1], (x[i + 1] - x[i]) / dt)
            load[dynamics.actuated] = u[i]
        x[i + 2], residual[i] = stepper(x[i + 1], x[i], load)
    return Motion(x, u, float(dt), residual <= TOLERANCE, residual)


def parameters_of(dynamics: Dynamics, dt: float, parameters: Mapping[str, float]) -> Array:
    """p (NP,) with ``dt`` s and the given ones, which are checked, in place of the defaults."""
    for name, value in instance("parameters", parameters, Mapping, "numbers by name").items():
        one_of("parameter", name, dynamics.layout.given)
        number(f"parameter {name}", value)
    return dynamics.layout.pack(**{**parameters, "dt": dt})


def _schedule(
    controls: Controls | None, seconds: float | None, steps: int | None, dt: float, nx: int, nu: int
) -> tuple[int, Callable[[int, Array, Array], Array] | None]:
    """Number of steps, and u_i as a function of (i, x_i, v_i)."""
    if seconds is not None and steps is not None:
        raise ProblemError("seconds and steps are both given: give one of them")
    if seconds is not None:
        steps = max(1, steps_in(positive("seconds", seconds, "s"), dt))
    if steps is not None:
        whole("steps", steps)
        room(f"{steps} steps of simulation", 2.0 * steps * nx)
    if controls is None:
        if steps is None:
            raise ProblemError(
                "give seconds, steps, or an array of controls: how long is not known"
            )
        return int(steps), None
    if callable(controls):
        if steps is None:
            raise ProblemError(
                "give seconds or steps: controls is a function, so how long is not known"
            )
        policy = controls
        return int(steps), lambda i, q, v: numbers(
            f"controls at step {i}", policy(i * dt, q.copy(), v), (nu,)
        )
    array = numbers("controls", controls)
    N = int(steps) if steps is not None else len(np.atleast_1d(array))
    table = numbers("controls", array, (N, nu))
    return N, lambda i, q, v: table[i]
