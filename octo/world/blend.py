"""The smooth minimum of many distances: symmetric, C², and never more than blend/6 below the least.

With x = a/T it is the least expected distance of a random choice among the shapes whose
indecision is rewarded,

    m = min over λ of Σ λ_i a_i − T·(4/3)(1 − Σ λ_i^{3/2}),  λ ≥ 0, Σ λ_i = 1,

the convex dual of Tsallis' entropy of exponent 3/2 (Peters, Niculae and Martins 2019, "Sparse
Sequence-to-Sequence Models", α-entmax). It is chosen because

- it does not know an order of the shapes, as a sum of smooth minima of pairs does;
- ∇m = λ is a convex combination: the normal lies between those of the shapes that meet;
- λ_i = ((τ − x_i)/2)², which vanishes with its slope at x_i = τ ≤ min x + 2: m is C², and a shape
  that is 2T farther than the nearest one does not matter at all, so that most are skipped exactly;
- of one shape m = a exactly, and of any number m > min a − 4T/3, where log-sum-exp sinks without
  bound: with T = blend/8 that is blend/6;
- τ, the root of Σ (τ − x_i)² = 4, and so m need sums of powers of x alone, in closed form.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca

from octo.world.jet import of_jets

PART = 1.0 / 8.0  # T in parts of the blend
REACH = 2.0  # in parts of T: a shape that is farther than the nearest one by more does not matter
Jet = Callable[[ca.SX], ca.SX]


def root(count: ca.SX, first: ca.SX, second: ca.SX) -> ca.SX:
    """τ of ``count`` distances with the sums Σ x and Σ x²."""
    return (first + ca.sqrt(first * first - count * (second - 4.0))) / count


@cache
def add(order: int) -> ca.Function:
    """((least distance m, T m), jet of a distance, jets of Σ x, Σ x² and Σ x³) -> the three sums
    with it, x = (distance − least)/T."""

    def expression(
        scale: ca.SX, jet: Jet, first: Jet, second: Jet, third: Jet, delta: ca.SX
    ) -> list[ca.SX]:
        x = (jet(delta) - scale[0]) / scale[1]
        sums = first(delta), second(delta), third(delta)
        return [sums[0] + x, sums[1] + x * x, sums[2] + x * x * x]

    return of_jets("add", [2], 4, order, expression)


@cache
def soften(order: int) -> ca.Function:
    """(least distance m, T m, their number), jets of the three sums) -> the jet of m."""

    def expression(scale: ca.SX, first: Jet, second: Jet, third: Jet, delta: ca.SX) -> list[ca.SX]:
        s1, s2, s3, count = first(delta), second(delta), third(delta), scale[2]
        tau = root(count, s1, s2)
        cubes = count * tau**3 - 3.0 * tau**2 * s1 + 3.0 * tau * s2 - s3  # Σ (τ − x_i)³
        return [scale[0] + scale[1] * (tau - 4.0 / 3.0 - cubes / 12.0)]

    return of_jets("soften", [3], 3, order, expression)
