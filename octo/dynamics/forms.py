"""Bilinear forms of twists, (6, 6), and wrenches, (6,): what the stages are written in.

A twist is (angular velocity, velocity of the point at the world's origin), a wrench (moment about
the origin, force), of SX.
"""

from __future__ import annotations

import casadi as ca


def axial(N: ca.SX) -> ca.SX:
    """(3,) of what is not symmetric in N (3, 3); of a rotation matrix 2 sin(angle)·axis."""
    return ca.vertcat(N[2, 1] - N[1, 2], N[0, 2] - N[2, 0], N[1, 0] - N[0, 1])


def moved(V: ca.SX, point: ca.SX) -> ca.SX:
    """The linear part (3,) of a twist about ``point``."""
    return V[3:] + ca.cross(V[:3], point)


def wrench(moment: ca.SX, force: ca.SX, point: ca.SX) -> ca.SX:
    """A wrench about ``point``, about the world origin."""
    return ca.vertcat(moment + ca.cross(point, force), force)


def about(block: ca.SX, left: ca.SX, right: ca.SX) -> ca.SX:
    """A form (6, 6) of twists about the points ``left`` and ``right``, as a form of twists about
    the world origin."""
    a, b = ca.skew(left), ca.skew(right)
    A, B, C, D = block[:3, :3], block[:3, 3:], block[3:, :3], block[3:, 3:]
    A, C = A - B @ b, C - D @ b
    return ca.blockcat([[A + a @ C, B + a @ D], [C, D]])


def q_form(Q: ca.SX, q_r: ca.SX, q_t: ca.SX, mass: ca.SX) -> ca.SX:
    """Matrix (6, 6) of the bilinear form tr(τ̂_i Q τ̂_jᵀ) with the homogeneous Q = [[Q, q_r],
    [q_tᵀ, mass]]."""
    turn = ca.trace(Q) * ca.SX.eye(3) - Q.T
    return ca.blockcat([[turn, ca.skew(q_r)], [-ca.skew(q_t), mass * ca.SX.eye(3)]])


def g_form(N: ca.SX, f: ca.SX) -> ca.SX:
    """Upper rows (3, 6) of the form ⟨τ̂_i τ̂_j, [N | f]⟩; its lower rows are zero."""
    return ca.horzcat(N.T - ca.trace(N) * ca.SX.eye(3), -ca.skew(f))


def raised(upper: ca.SX) -> ca.SX:
    return ca.vertcat(upper, ca.SX(3, 6))


def rows(matrix: ca.SX) -> ca.SX:
    """A matrix as one dense column, row by row (C's order)."""
    return ca.densify(ca.vec(matrix.T)) if matrix.shape[1] > 1 else ca.densify(matrix)
