"""Eq. 10: the model's minimiser within the trust region, over two directions (§6.1), batched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from octo.arrays import Array, Numbers, inner, inners, scaled
from octo.solver.blocks import KKTBlocks

RELAXATION = 0.8  # of the radius: how much of it the normal step may use (Nocedal and Wright, §18.5)


@dataclass(frozen=True, eq=False)
class Directions:
    """What one linearisation gives, whatever the radius: the solutions with its factors, each (batch, K, nc)."""

    full: Array  # p_f, the KKT step of Eq. 12
    tangential: Array  # p(C_0 = 0), the KKT step without the constraints' residual
    normal: Array  # v_N = -Aᵀ(AAᵀ)⁻¹C_0
    lam: Array  # multipliers of p_f


@dataclass(frozen=True, eq=False)
class Step:
    """A step and what the model says of it."""

    delta: Array  # (batch, K, nc)
    energy: Numbers  # (batch,) ½ΔᵀHΔ + bᵀΔ
    residual: Numbers  # (batch,) ‖A Δ + C_0‖₂


def minimize(blocks: KKTBlocks, at: Directions, project: Any, radius: Numbers) -> Step:
    """Minimise the model over v + span{p(θ) − v, −P(b + Hv)} in the ball of ``radius`` (batch,).

    ``project(w)`` is P w, the projection onto the null space of A. The normal part v is θ v_N with
    θ = min(1, 0.8 radius/‖v_N‖): this is the adjustment of C_0 of Algorithm 1.
    """
    length = np.sqrt(inner(at.normal, at.normal))
    theta = RELAXATION * radius / np.maximum(np.maximum(length, RELAXATION * radius), 1e-300)
    v = scaled(theta, at.normal)
    target = scaled(theta, at.full) + scaled(1.0 - theta, at.tangential)
    gradient = blocks.b + blocks.hessian_times(v)
    first = _unit(project(target - v))
    steepest = project(gradient)
    second = _unit(steepest - scaled(inner(first, steepest), first))
    second = _unit(second - scaled(inner(first, second), first))  # twice is enough (Kahan)
    room = np.sqrt(np.maximum(radius**2 - inner(v, v), 0.0))  # v is orthogonal to the null space
    h1, h2 = blocks.hessian_times(first), blocks.hessian_times(second)
    pairs = ((first, h1), (first, h2), (second, h2), (first, gradient), (second, gradient))
    a, b, c, g1, g2 = inners(*pairs)
    z1, z2 = _two_by_two((a, b, c), (g1, g2), room)
    delta = v + scaled(z1, first) + scaled(z2, second)
    left = blocks.constraints_times(delta) + blocks.C
    curvature, slope = inners((delta, blocks.hessian_times(delta)), (blocks.b, delta))
    return Step(delta, 0.5 * curvature + slope, np.sqrt(inner(left, left)))


def _unit(w: Array) -> Array:
    length = np.sqrt(inner(w, w))
    return scaled(np.where(length > 1e-300, 1.0 / np.maximum(length, 1e-300), 0.0), w)


def _two_by_two(
    hessian: tuple[Numbers, Numbers, Numbers], gradient: tuple[Numbers, Numbers], radius: Numbers
) -> tuple[Numbers, Numbers]:
    """Minimise gᵀz + ½zᵀBz over ‖z‖ ≤ radius (batch,), B = [[a, b], [b, c]]: bisection on the multiplier of the ball."""
    (a, b, c), (g1, g2) = hessian, gradient
    mean, half = 0.5 * (a + c), np.sqrt((0.5 * (a - c)) ** 2 + b**2)
    lowest = mean - half

    def at(shift: Numbers) -> tuple[Numbers, Numbers]:
        d = np.maximum((a + shift) * (c + shift) - b * b, 1e-300)
        return -((c + shift) * g1 - b * g2) / d, -((a + shift) * g2 - b * g1) / d

    size = np.sqrt(g1**2 + g2**2)
    least = size / np.maximum(radius, 1e-300)  # the multiplier where the Hessian is zero
    low = np.maximum(0.0, -lowest) + 1e-14 * np.maximum(np.abs(mean) + half, np.maximum(least, 1e-300))
    high = low + least + 1e-300
    z1, z2 = at(low)
    inside = z1**2 + z2**2 <= radius**2
    for _ in range(60):
        middle = 0.5 * (low + high)
        y1, y2 = at(middle)
        outside = y1**2 + y2**2 > radius**2
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    y1, y2 = at(high)
    return np.where(inside, z1, y1), np.where(inside, z2, y2)
