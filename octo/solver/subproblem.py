"""Eq. 10: the model's minimiser within the trust region, over two directions (§6.1), batched.

Everything, the numbers of each member too, stays where the arrays are: a device is not waited for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

from octo.arrays import Array, Numbers, array_module, inner, like
from octo.solver.blocks import KKTBlocks

# of the radius: how much of it the normal step may use (Nocedal and Wright, §18.5)
RELAXATION = 0.8


@dataclass(frozen=True, eq=False)
class Directions:
    """What one linearisation gives, whatever the radius: the solutions with its factors, each
    (batch, K, nc)."""

    full: Array  # p_f, the KKT step of Eq. 12
    tangential: Array  # p(C_0 = 0), the KKT step without the constraints' residual
    normal: Array  # v_N = -Aᵀ(AAᵀ)⁻¹C_0
    lam: Array  # multipliers of p_f


@dataclass(frozen=True, eq=False)
class Step:
    """A step and what the model says of it."""

    delta: Array  # (batch, K, nc)
    energy: Array  # (batch,) ½ΔᵀHΔ + bᵀΔ
    residual: Array  # (batch,) ‖A Δ + C_0‖₂
    slope: Array  # (batch,) bᵀΔ


Three: TypeAlias = tuple[Array, Array, Array]
Two: TypeAlias = tuple[Array, Array]


def two_by_two(hessian: Three, gradient: Two, radius: Array) -> Two:
    """Minimise gᵀz + ½zᵀBz over ‖z‖ ≤ radius (batch,), B = [[a, b], [b, c]]: bisection on the
    multiplier of the ball."""
    xp = array_module(radius)
    (a, b, c), (g1, g2) = hessian, gradient
    mean, half = 0.5 * (a + c), xp.sqrt((0.5 * (a - c)) ** 2 + b**2)
    lowest = mean - half

    def at(shift: Array) -> tuple[Array, Array]:
        d = xp.maximum((a + shift) * (c + shift) - b * b, 1e-300)
        return -((c + shift) * g1 - b * g2) / d, -((a + shift) * g2 - b * g1) / d

    size = xp.sqrt(g1**2 + g2**2)
    least = size / xp.maximum(radius, 1e-300)  # the multiplier where the Hessian is zero
    low = xp.maximum(0.0, -lowest) + 1e-14 * xp.maximum(abs(mean) + half, xp.maximum(least, 1e-300))
    high = low + least + 1e-300
    z1, z2 = at(low)
    inside = z1**2 + z2**2 <= radius**2
    for _ in range(60):
        middle = 0.5 * (low + high)
        y1, y2 = at(middle)
        outside = y1**2 + y2**2 > radius**2
        low, high = xp.where(outside, middle, low), xp.where(outside, high, middle)
    y1, y2 = at(high)
    return xp.where(inside, z1, y1), xp.where(inside, z2, y2)


def minimize(
    blocks: KKTBlocks,
    at: Directions,
    project: Any,
    radius: Numbers,
    ball: Callable[[Three, Two, Array], Two] = two_by_two,
) -> Step:
    """Minimise the model over v + span{p(θ) − v, −P(b + Hv)} in the ball of ``radius`` (batch,).

    ``project(w)`` is P w, the projection onto the null space of A. The normal part v is θ v_N with
    θ = min(1, 0.8 radius/‖v_N‖): this is the adjustment of C_0 of Algorithm 1.
    """
    xp, radius = array_module(at.normal), like(radius, at.normal)
    length = xp.sqrt(inner(at.normal, at.normal))
    theta = RELAXATION * radius / xp.maximum(xp.maximum(length, RELAXATION * radius), 1e-300)
    v = _times(theta, at.normal)
    target = _times(theta, at.full) + _times(1.0 - theta, at.tangential)
    gradient = blocks.b + blocks.hessian_times(v)
    first = _unit(project(target - v))
    steepest = project(gradient)
    second = _unit(steepest - _times(inner(first, steepest), first))
    second = _unit(second - _times(inner(first, second), first))  # twice is enough (Kahan)
    room = xp.sqrt(xp.maximum(radius**2 - inner(v, v), 0.0))  # v is orthogonal to the null space
    h1, h2 = blocks.hessian_times(first), blocks.hessian_times(second)
    pairs = ((first, h1), (first, h2), (second, h2), (first, gradient), (second, gradient))
    a, b, c, g1, g2 = (inner(*pair) for pair in pairs)
    z1, z2 = ball((a, b, c), (g1, g2), room)
    delta = v + _times(z1, first) + _times(z2, second)
    left = blocks.constraints_times(delta) + blocks.C
    curvature, slope = inner(delta, blocks.hessian_times(delta)), inner(blocks.b, delta)
    return Step(delta, 0.5 * curvature + slope, xp.sqrt(inner(left, left)), slope)


def _unit(w: Array) -> Array:
    xp = array_module(w)
    length = xp.sqrt(inner(w, w))
    return _times(xp.where(length > 1e-300, 1.0 / xp.maximum(length, 1e-300), 0.0), w)


def _times(factor: Array, v: Array) -> Array:
    """factor (batch,) times v (batch, K, nc)."""
    return factor.reshape(-1, 1, 1) * v
