"""A planned motion with a time stamp, interpolated at any time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.model.quantities import Array
from octo.solver.elimination import address

FADING = 0.5  # of the joints' velocity, from one step beyond the plan's end to the next


class Grid:
    """What all plans of a controller have in common: N ``steps`` of ``dt`` s of n coordinates, some
    of them actuated."""

    def __init__(self, steps: int, dt: float, actuated: NDArray[np.intp], n: int):
        self.steps, self.dt, self.actuated, self.n, self.nu = steps, dt, actuated, n, len(actuated)
        self.rows = 2 * steps + 4  # x_{-1} … x_N and what follows the plan
        others = np.setdiff1d(np.arange(n), actuated)
        self.fading = np.ones((steps + 2, n))
        self.fading[:, actuated] = np.cumsum(FADING ** np.arange(1, steps + 3))[:, None]
        self.fading[:, others] = np.arange(1, steps + 3)[:, None]


class Plan:
    """x_{-1} … x_N and u_0 … u_{N-1} from the time of x_0 on. A plan is never changed: whoever
    holds one reads one motion.

    Beyond its end the base keeps its velocity and the joints come to rest.

    Attributes
    ----------
    grid: what all plans of a controller have in common.
    nodes: (N+2, n) rad and m, that it is made of.
    time: s, of x_0.
    x: (2N+4, n), from x_{-1} on.
    u: (2N+4, nu) N m or N, from u_0 on; the last one is repeated.
    address: of the block of numbers that low_level.c reads.
    """

    def __init__(self, grid: Grid, time: float, nodes: Array, u: Array):
        """Nodes (N+2, n) rad and m, torques (N, nu)."""
        self.time = time
        self.steps, self.dt, N = grid.steps, grid.dt, grid.steps
        size = grid.rows * grid.n
        block = np.empty(1 + size + grid.rows * grid.nu)
        self.address = address(block)
        block[0] = time
        self.x = block[1 : 1 + size].reshape(grid.rows, grid.n)
        self.u = block[1 + size :].reshape(grid.rows, grid.nu)
        self.x[: N + 2] = nodes
        np.multiply(grid.fading, nodes[-1] - nodes[-2], out=self.x[N + 2 :])
        self.x[N + 2 :] += nodes[-1]
        self.u[:N] = u
        self.u[N:] = u[-1]
        for array in (block, self.x, self.u):
            # .flags.writeable = …, like .ctypes, leaves a name in Python's cache every time
            array.setflags(write=False)

    @property
    def end(self) -> float:
        """s, the time of x_N."""
        return self.time + self.steps * self.dt

    def place(self, time: float) -> tuple[int, float]:
        """The step and the part of it at ``time``, not beyond what is stored."""
        s = min(max((time - self.time) / self.dt, 0.0), self.steps + 1.999)
        i = int(s)
        return i, s - i

    def shift(self, time: float, nodes: Array) -> None:
        """The plan as nodes (N+2, n) whose x_0 is at ``time``."""
        i, f = self.place(time)
        N = self.steps
        ahead = self.x[i + 1 : i + N + 3]
        np.multiply(self.x[i : i + N + 2], 1.0 - f, out=nodes)
        nodes += f * ahead

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """x (n,), its rate (n,) and u (nu,) at ``time``."""
        i, f = self.place(time)
        move = self.x[i + 2] - self.x[i + 1]
        return self.x[i + 1] + f * move, move / self.dt, self.u[i] + f * (self.u[i + 1] - self.u[i])
