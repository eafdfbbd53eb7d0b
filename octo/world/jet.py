"""A signed distance and its derivatives at a point, as the numbers of a Taylor polynomial.

A jet is [φ; x y z; xx xy xz yy yz zz; xxx xxy xxz xyy xyz xzz yyy yyz yzz zzz], of an order d the
first ``SIZES[d]`` numbers. What is made of jets (another frame, a smooth minimum) is made of their
polynomials and differentiated at δ = 0, so that no rule of differentiation is written by hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import combinations_with_replacement

import casadi as ca

from octo.interrupts import postponed

SIZES = (1, 4, 10, 20)  # numbers of a jet by its order
ORDERS = range(len(SIZES))
# the axes that each number is differentiated along
AXES = [axes for order in ORDERS for axes in combinations_with_replacement(range(3), order)]


def derivatives(value: ca.SX, over: ca.SX, order: int) -> ca.SX:
    """The jet (SIZES[order],) of an expression of ``over`` (3,)."""
    levels, axes = [ca.SX(value)], AXES[:1]
    for _ in range(order):
        slopes = ca.densify(ca.jacobian(levels[-1], over))
        # each derivative once: along axes that do not fall
        places = [(row, k) for row, a in enumerate(axes) for k in range(a[-1] if a else 0, 3)]
        levels.append(ca.vertcat(*[slopes[row, k] for row, k in places]))
        axes = [(*axes[row], k) for row, k in places]
    return ca.densify(ca.vertcat(*levels))


def polynomial(jet: ca.SX, delta: ca.SX) -> ca.SX:
    """The Taylor polynomial of a jet at ``delta`` (3,) m from its point."""
    whole = ca.SX(0)
    for coefficient, axes in zip(ca.vertsplit(jet), AXES, strict=False):
        power = math.prod((delta[k] for k in axes), start=ca.SX(1))
        whole += coefficient * power / math.prod(math.factorial(axes.count(k)) for k in range(3))
    return whole


@postponed()
def of_jets(
    name: str,
    sizes: Sequence[int],
    jets: int,
    order: int,
    expression: Callable[..., Sequence[ca.SX]],
) -> ca.Function:
    """A function of vectors of ``sizes`` and of ``jets`` jets, whose results are jets.

    Parameters
    ----------
    expression: called with the vectors, the jets, each a function of a displacement from the point
        (3,) m, and with the displacement δ over which the results are expanded.
    """
    delta = ca.SX.sym("delta", 3)
    numbers = [ca.SX.sym(f"n{k}", size) for k, size in enumerate(sizes)]
    given = [ca.SX.sym(f"jet{k}", SIZES[order]) for k in range(jets)]
    made = expression(*numbers, *[partial(polynomial, jet) for jet in given], delta)
    expanded = [derivatives(one, delta, order) for one in made]
    results = ca.substitute(expanded, [delta], [ca.SX.zeros(3)])
    dense = [ca.densify(one) for one in results]
    return ca.Function(f"octo_world_{name}_{order}", [*numbers, *given], dense, {"cse": True})


@cache
def turned(order: int) -> ca.Function:
    """(rotation (9,), row by row, jet in a shape's frame) -> the jet in world axes."""

    def expression(rotation: ca.SX, jet: Callable[[ca.SX], ca.SX], delta: ca.SX) -> list[ca.SX]:
        return [jet(ca.reshape(rotation, 3, 3) @ delta)]  # by columns: this is Rᵀ δ

    return of_jets("turned", [9], 1, order, expression)
