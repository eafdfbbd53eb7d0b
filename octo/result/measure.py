"""From an iterate to a motion: what the feet, the forces and the laws of physics say about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from octo.checks import Array
from octo.dynamics.contact_numbers import contact_numbers, many
from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.dynamics.parameters import section
from octo.interrupts import postponed
from octo.model.character import Character
from octo.model.terrain import distances
from octo.problem.asked import Asked, Motion
from octo.problem.compiled import CompiledProblem, Evaluation
from octo.result.bounds import bounds_kept
from octo.result.residuals import residuals_of
from octo.result.stride import Stride
from octo.result.trajectory import TOUCHES, VECTORS
from octo.soft.dynamics import SoftDynamics
from octo.world.drawn import sampled
from octo.world.world import World

GROUND_MARGIN = 1.0  # m, of sampled terrain around the motion
GROUND_SPACING = 0.1  # m
LEVEL = 1e-11  # m, of φ on the ground, as fine as bisection gets


def violations(problem: CompiledProblem, at: Evaluation) -> tuple[Array, Array]:
    """‖C‖∞ and ‖U_/FD‖∞ (batch,) in N; moments are divided by ℓ (DESIGN: the scale of the rows)."""
    weight = problem.weight
    if problem.ma == 0:
        return np.zeros(problem.batch), np.zeros(problem.batch)
    reduced = np.abs(at.C).max(axis=(1, 2)) * weight
    rows = np.abs(at.fd[..., problem.dynamics.unactuated] * problem.row_scale[:, None])
    return reduced, rows.max(axis=(1, 2)) * weight


def measured(problem: CompiledProblem, at: Evaluation, member: int) -> dict[str, Any]:
    """The fields of a Trajectory, of one member's iterate."""
    described = problem.problems[member]
    dynamics = described.dynamics  # its ground is its own
    reduced, pointwise = violations(problem, at)
    names = [term.label for term in described.costs]  # constraints, which come last, have no part
    energies = problem.term_values(at)[member, : len(names)]
    robot: Character | None = described.character
    p = problem.p[member]
    return {
        "name": dynamics.name if robot is None else robot.name,
        "character": robot,
        "soft": dynamics.coordinates if isinstance(dynamics, SoftDynamics) else None,
        "dt": float(described.dt),
        "basis": problem.basis.name,
        "x": at.nodes[member].copy(),
        "u": at.fd[member][:, dynamics.actuated].copy(),
        "unknowns": at.unknowns[member].copy(),
        "terms": dict(zip(names, energies.tolist(), strict=True)),
        "violation": float(reduced[member]),
        "pointwise_residual": float(pointwise[member]),
        "weight": described.weight,
        "length": described.length,
        "torque_limit": described.setting.torque_limit,
        "cycle": stride(problem, at, member),
        "world": world_of(dynamics),
        "parameters": dynamics.layout.named(p),
        "asked": asked(problem, at.nodes[member], member),
        "bounds": bounds_kept(problem, at, member),
        "residuals": residuals_of(problem, at, member),
        **_contacts(dynamics, at.nodes[member], p, problem),
        **_touches(dynamics, at.nodes[member], p, problem),
    }


def asked(problem: CompiledProblem, nodes: Array, member: int) -> tuple[Asked, ...]:
    """What the terms of one member ask of its motion x_{-1} … x_N (N+2, n), and what came of it."""
    described = problem.problems[member]
    made = []
    for k, term in enumerate(described.costs):
        weights = problem.q[member][:, k]
        if term is not described.anchor and weights.any():
            motion = Motion(nodes[1:], float(described.dt), described.character, weights)
            made.append(term.asked(motion, described.setting))
    return tuple(one for one in made if one is not None)


def stride(problem: CompiledProblem, at: Evaluation, member: int) -> Stride | None:
    """What a cycle is carried on with, and how well the laws of physics hold for its mirror image;
    None of other motions."""
    made = Stride.of(problem.problems[member])
    if made is None or not made.mirrored:
        return made
    alone, own = problem.take(np.array([member])), slice(member, member + 1)
    image = alone.evaluate_nodes(at.unknowns[own], made.on(at.nodes[own]))
    return replace(made, asymmetry=float(violations(alone, image)[1][0]))


def _contacts(
    dynamics: Dynamics, nodes: Array, p: Array, problem: CompiledProblem
) -> dict[str, Any]:
    steps = len(nodes) - 2
    if isinstance(dynamics, SoftDynamics):
        names, vectors, depth = dynamics.contact_numbers(p, nodes)
        out: dict[str, Any] = dict(zip(VECTORS, vectors, strict=True))
        out |= {"contact_depth": depth, "contact_names": names}
        return out | {"ground": ground(dynamics, p, passed(True, nodes, out["contact_point"]))}
    count = len(dynamics.character.terrain_contacts) if isinstance(dynamics, RobotDynamics) else 0
    if not isinstance(dynamics, RobotDynamics) or count == 0:
        empty = {name: np.zeros((steps, 0, 3)) for name in VECTORS}
        return {**empty, "contact_depth": np.zeros((steps, 0)), "contact_names": (), "ground": {}}
    if many(dynamics):
        vectors, depth = contact_numbers(dynamics, p, nodes[2:], nodes[1:-1])
    else:
        at = dynamics.seen(p, nodes[2:])
        *values, below = problem.kinematics.map(steps)(nodes[2:].T, nodes[1:-1].T, at)
        vectors = [np.asarray(v).reshape(3, steps, count).transpose(1, 2, 0) for v in values]
        depth = np.asarray(below).T.reshape(steps, count)
    out = dict(zip(VECTORS, vectors, strict=True))
    robot = dynamics.character
    out["contact_depth"] = depth
    out["contact_names"] = tuple(robot.contacts[k].name for k in robot.terrain_contacts)
    out["ground"] = ground(dynamics, p, out["contact_point"])
    return out


def _touches(
    dynamics: Dynamics, nodes: Array, p: Array, problem: CompiledProblem
) -> dict[str, Array]:
    """The forces between bodies, and where they act."""
    steps = len(nodes) - 2
    count = len(dynamics.character.touches) if isinstance(dynamics, RobotDynamics) else 0
    if not count:
        return {}
    given = (nodes[2:].T, nodes[1:-1].T, np.repeat(p[:, None], steps, axis=1))
    found = problem.program.touches.map(steps)(*given)
    arrays = [np.asarray(own).reshape(3, steps, count).transpose(1, 2, 0) for own in found]
    return dict(zip(TOUCHES, arrays, strict=True))


def world_of(dynamics: Dynamics) -> World | None:
    """The shapes that a robot's or a soft body's ground is made of; None of other grounds."""
    terrain = dynamics.terrain if isinstance(dynamics, (RobotDynamics, SoftDynamics)) else None
    return terrain if isinstance(terrain, World) else None


def passed(soft: bool, nodes: Array, points: Array) -> Array:
    """(k, 3) m, where a motion x_{-1} … x_N (N+2, n) passes: at its contacts' ``points``
    (..., 3), and a soft body, which has none in the air, at its middle too."""
    middle = nodes[1:, :3] if soft else np.zeros((0, 3))
    return np.concatenate([middle, points.reshape(-1, 3)])


@postponed()
def ground(dynamics: RobotDynamics | SoftDynamics, p: Array, around: Array) -> dict[str, Array]:
    """Heights z (a, b) m of the terrain on a grid x (a,), y (b,) that spans the points ``around``
    (..., 3)."""
    low = around.reshape(-1, 3).min(axis=0) - GROUND_MARGIN
    high = around.reshape(-1, 3).max(axis=0) + GROUND_MARGIN
    world = world_of(dynamics)
    if world is not None:
        return sampled(world.below, low, high)
    counts = [int(min(200, max(2, np.ceil((high[k] - low[k]) / GROUND_SPACING)))) for k in (0, 1)]
    x, y = (np.linspace(low[k], high[k], counts[k]) for k in (0, 1))
    grid = np.stack([a.ravel() for a in np.meshgrid(x, y, indexing="ij")], axis=1)
    phi = distances(dynamics.terrain, section(dynamics.layout.named(p), "terrain."))
    return {"x": x, "y": y, "z": _heights(phi, grid, low[2], high[2]).reshape(len(x), len(y))}


def _heights(phi: Callable[[Array], Array], grid: Array, low: float, high: float) -> Array:
    """z (k,) m where φ is zero over places (k, 2) m."""
    below, above = np.full(len(grid), low - 3.0), np.full(len(grid), high + 3.0)
    first, last = (phi(np.column_stack([grid, z])) for z in (below, above))
    flat = below - first * (above - below) / np.where(last > first, last - first, 1.0)
    if (np.abs(phi(np.column_stack([grid, flat]))) < LEVEL).all():  # a plane
        return flat
    for _ in range(40):  # φ grows with height: bisection on the vertical line over each place
        middle = 0.5 * (below + above)
        inside = phi(np.column_stack([grid, middle])) < 0.0
        below, above = np.where(inside, middle, below), np.where(inside, above, middle)
    return np.asarray(0.5 * (below + above))
