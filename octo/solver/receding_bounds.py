"""Rows between bounds at one iteration a measurement: one step of a primal-dual interior point with
a weight μ that stays.

Of a row r with a bound, gap being how far r is inside it, and of its multiplier z ≥ 0 (Nocedal and
Wright, §19.3; here each bound has a slack g of its own):

    D = z/g        d = D (gap − g) − μ/g        z ← z + length (μ/g − D gap⁺)

gap⁺ is that after the step. g is the gap before it, but no nearer to the bound than half of μ/z.
Multipliers are kept between calls and move along the horizon with the plan. They are never more
than ``MOST``, so that bounds that cannot hold together, or not from where a robot was measured, are
missed by little instead of stopping the plan.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from octo.checks import Array
from octo.problem.compiled import CompiledProblem

# N μ. Under motors at 0.4 and 0.5 of their limits, joint speeds of 10 rad/s and the joints' ranges
# a go2 and a mammal at 0.5 m/s plan beyond them at 4 to 18 % of all calls; at 3e-2 it is 10 to 37
# %, at 1e-2 30 to 64 %, with multipliers of an augmented Lagrangian 91 to 95 %, and with the bounds
# left out 91 to 97 %
WEIGHT = 0.1
MOST = 10.0  # N z
NEAREST = 0.1  # a slack to its bound, where μ/z says no nearer place
HALF = 0.5  # of μ/z
SAFEGUARD = 10.0  # by which a multiplier may differ from μ/gap
NONE = 1e30  # a bound where there is none


class Horizon(Protocol):
    """What a receding horizon shows of its rows."""

    rows: Array  # (N, rows), of the last evaluation

    def evaluate(self) -> None: ...

    def evaluate_first(self) -> None: ...


class NoBounds:
    """Of a problem whose rows have none."""

    def forget(self) -> None:
        """Begin anew."""

    def shift(self, steps: int, part: float) -> None:
        """Let go by of the plan so many whole steps, and a part of the next one."""

    def keep(self) -> None:
        """What there is now belongs to the plan."""

    def weigh(self, horizon: Horizon) -> None:
        """Give the rows their weights before all steps but those that see the measurement are
        linearised."""

    def weigh_first(self, horizon: Horizon) -> None:
        """Those of the steps that see it, once it is there."""

    def learn(self, horizon: Horizon, length: float) -> None:
        """Multipliers after a step of ``length``, which led where the horizon is evaluated."""

    def excess(self, horizon: Horizon) -> float:
        """How far a row is beyond its bound at most, in its own unit; 0 where none is."""
        del horizon
        return 0.0

    def price(self, horizon: Horizon) -> float:
        """What a merit adds to E."""
        del horizon
        return 0.0


class RecedingBounds(NoBounds):
    """Multipliers of one problem's bounds, and the rows' weights that they make.

    Parameters
    ----------
    compiled: its ``q`` is where the weights go.
    """

    def __init__(self, compiled: CompiledProblem):
        lower, upper = compiled.lower[0], compiled.upper[0]
        self._bound = np.stack([np.maximum(lower, -NONE), np.minimum(upper, NONE)])  # (2, N, rows)
        self._sign = np.array([1.0, -1.0]).reshape(2, 1, 1)
        self._steps = compiled.steps
        self._mu, self._most = WEIGHT / self._steps, MOST / self._steps
        self._into = [compiled.q[0][:, place] for place in compiled.functions.row_weights]
        self._z, self._kept = np.empty_like(self._bound), np.empty_like(self._bound)
        self._price, self._push = np.empty_like(self._bound), np.empty_like(self._bound)
        self.forget()

    def forget(self) -> None:
        self._z[:] = np.where(np.abs(self._bound) < NONE, self._mu, 0.0)
        self.keep()

    def shift(self, steps: int, part: float) -> None:
        z, i = self._z, min(steps, self._steps - 1)
        z[:, : self._steps - i], z[:, self._steps - i :] = self._kept[:, i:], self._kept[:, -1:]
        z[:, :-1] += part * (z[:, 1:] - z[:, :-1])

    def keep(self) -> None:
        self._kept[:] = self._z

    def weigh(self, horizon: Horizon) -> None:
        horizon.evaluate()
        self._weigh(horizon.rows)

    def weigh_first(self, horizon: Horizon) -> None:
        horizon.evaluate_first()
        self._weigh(horizon.rows)

    def _weigh(self, rows: Array) -> None:
        z, gap = self._z, self._gap(rows)
        slack = np.maximum(gap, np.minimum(HALF * self._mu / np.maximum(z, 1.0 / NONE), NEAREST))
        self._price, self._push = z / slack, self._mu / slack
        pull = self._price * (gap - slack) - self._push
        weights, shifts, multipliers = self._into
        np.add(self._price[0], self._price[1], out=weights)
        np.subtract(pull[0], pull[1], out=shifts)
        np.subtract(z[1], z[0], out=multipliers)

    def learn(self, horizon: Horizon, length: float) -> None:
        gap = self._gap(horizon.rows)
        z = self._z + length * (self._push - self._price * gap)
        least = self._mu / SAFEGUARD / np.maximum(gap, NEAREST)
        most = SAFEGUARD * self._mu / np.maximum(gap, 1.0 / NONE)
        self._z = np.clip(z, least, np.minimum(most, self._most))

    def excess(self, horizon: Horizon) -> float:
        return max(-float(self._gap(horizon.rows).min()), 0.0)

    def price(self, horizon: Horizon) -> float:
        """−μ log gap, from where its slope is that of ``MOST`` on a straight line."""
        gap, near = self._gap(horizon.rows), self._mu / self._most
        beyond = np.maximum(near - gap, 0.0)
        held = np.where(gap < 0.5 * NONE, np.maximum(gap, near), 1.0)
        return float(np.sum(self._most * beyond - self._mu * np.log(held)))

    def _gap(self, rows: Array) -> Array:
        """(2, N, rows) how far the rows are inside their bounds."""
        return np.asarray(self._sign * (rows - self._bound))


def bounds_of(compiled: CompiledProblem) -> NoBounds:
    """Of a problem's rows."""
    return RecedingBounds(compiled) if compiled.lower.size else NoBounds()
