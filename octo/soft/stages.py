"""What is not a loop of a body's dynamics, as small CasADi functions: the base's rotation and its
derivatives, by the chart's angles. The contact's law is ``octo.dynamics.stages.point``."""

from __future__ import annotations

import casadi as ca

from octo.dynamics.forms import rows
from octo.model.chart import Chart
from octo.soft.symbolic import rotation

PREFIX = "octo_"  # of the names in the C text
# second derivatives are symmetric: those that are kept
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
TURNS = 1 + 3 + len(PAIRS)  # matrices that ``turn`` gives


def turn(chart: Chart) -> ca.Function:
    """R, its slopes ∂_a R and ∂_a ∂_b R by PAIRS, nine numbers each, row by row. Input: the angles
    (3,)."""
    angles = ca.SX.sym("angles", 3)
    out = ca.vertcat(*(rows(one) for one in _derivatives(rotation(angles, chart), angles)))
    return ca.Function(f"{PREFIX}turn", [angles], [ca.densify(out)], {"cse": True})


def bend(chart: Chart) -> ca.Function:
    """The same numbers of R_λ = Σ λ_a ∂_a R. Inputs: the angles, and λ (3,)."""
    angles, lam = ca.SX.sym("angles", 3), ca.SX.sym("lam", 3)
    along = ca.jtimes(ca.vec(rotation(angles, chart)), angles, lam)
    out = ca.vertcat(*(rows(one) for one in _derivatives(ca.reshape(along, 3, 3), angles)))
    return ca.Function(f"{PREFIX}bend", [angles, lam], [ca.densify(out)], {"cse": True})


def _derivatives(matrix: ca.SX, angles: ca.SX) -> list[ca.SX]:
    flat = ca.vec(matrix)
    slopes = [ca.jacobian(flat, angles[a]) for a in range(3)]
    second = [ca.jacobian(slopes[a], angles[b]) for a, b in PAIRS]
    return [ca.reshape(one, 3, 3) for one in (flat, *slopes, *second)]
