"""A planned motion with a time stamp, read at any time: nodes and torques in between are interpolated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FADING = 0.5  # of the joints' velocity, from one step beyond the plan's end to the next


class Plan:
    """x_{-1} … x_N and u_0 … u_{N-1} from the time of x_0 on, in memory that is allocated once.

    Beyond its end the base keeps its velocity and the joints come to rest.
    """

    def __init__(self, steps: int, dt: float, actuated: NDArray[np.intp], n: int):
        self.steps, self.dt, self.time = steps, dt, 0.0  # time: s, of x_0
        self.x = np.zeros((2 * steps + 4, n))  # x_{-1} … x_N, then what follows the plan
        self.u = np.zeros((2 * steps + 4, len(actuated)))  # N m or N; the last one is repeated
        fading = np.ones((steps + 2, n))
        fading[:, actuated] = np.cumsum(FADING ** np.arange(1, steps + 3))[:, None]
        others = np.setdiff1d(np.arange(n), actuated)
        fading[:, others] = np.arange(1, steps + 3)[:, None]
        self._fading = fading
        self._actuated = actuated

    @property
    def end(self) -> float:
        """s, the time of x_N."""
        return self.time + self.steps * self.dt

    def store(self, time: float, nodes: Array, u: Array) -> None:
        """Take over nodes (N+2, n) and torques (N, nu)."""
        N = self.steps
        self.time = time
        self.x[: N + 2] = nodes
        np.multiply(self._fading, nodes[-1] - nodes[-2], out=self.x[N + 2 :])
        self.x[N + 2 :] += nodes[-1]
        self.u[:N] = u
        self.u[N:] = u[-1]

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

    def joints(self, time: float) -> tuple[Array, Array, Array]:
        """The same of the actuated coordinates only."""
        x, rate, u = self.at(time)
        return x[self._actuated], rate[self._actuated], u
