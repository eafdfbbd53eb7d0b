"""Contact-invariant optimisation: forces as unknowns, in place of a contact law."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

import octo
from octo import SqpOptions
from octo.dynamics.evaluate import RobotDynamics
from octo.errors import ProblemError, ShapeError, UnknownNameError, ValueRangeError
from octo.problem.symbols import StepSymbols
from octo.reference import contact_invariant
from octo.solve import evaluated
from octo.solver.status import Status

COSTS = (octo.CenterOfMassVelocity((0.2, 0.0, 0.0)), octo.Effort())


def biped(**changes: object) -> octo.Problem:
    return octo.Problem(octo.gallery.biped(), steps=2, dt=0.05, costs=COSTS).replace(**changes)


def step_of(
    problem: octo.Problem, nodes: np.ndarray, u: np.ndarray, robot: RobotDynamics | None
) -> StepSymbols:
    """A step at numbers: nodes (3, n) x_prev, x, x_next, u (nu,)."""
    x_prev, x, x_next = (ca.SX(ca.DM(node)) for node in nodes)
    numbers = {name: ca.SX(value) for name, value in problem.values.items()}
    return StepSymbols(
        x_next, x, x_prev, ca.SX(ca.DM(u)), numbers, problem.dynamics.actuated, robot
    )


def value(residual: ca.SX) -> np.ndarray:
    return np.asarray(ca.evalf(residual)).ravel()


def test_with_the_forces_of_a_law_it_is_the_robots_dynamics() -> None:
    problem = biped()
    dynamics, n = problem.dynamics, problem.dynamics.nx
    assert isinstance(dynamics, RobotDynamics)
    made = contact_invariant(problem)
    x = problem.start + np.random.default_rng(0).normal(0.0, 2e-3, (3, n))
    x[:2] = problem.start  # from rest
    motion = evaluated(problem, np.vstack([x[1:], x[2:]]), Status.SIMULATED)
    places = [dynamics.character.contact_index(name) for name in made.contacts]
    forces = np.asarray(motion.contact_force)[0, places]
    assert np.abs(forces[:, 2]).max() > 1.0  # they do carry
    nodes = np.hstack([x, np.tile(forces.ravel() / problem.weight, (3, 1))])
    fd = np.asarray(made.problem.dynamics.symbolic(nodes[2], nodes[1], nodes[0], made.problem.p))
    own = np.asarray(dynamics.symbolic(x[2], x[1], x[0], problem.p)).ravel()
    own[dynamics.unactuated] *= problem.row_scale
    np.testing.assert_allclose(fd.ravel()[:n], own, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fd.ravel()[n:], nodes[2, n:])
    np.testing.assert_allclose(made.forces(nodes)[0], forces, atol=1e-12)
    np.testing.assert_array_equal(made.motion(nodes), x)
    u = fd.ravel()[made.problem.dynamics.actuated]
    for term, wrapped in zip(problem.costs, made.problem.costs, strict=False):
        p = {name: ca.SX(ca.DM(v)) for name, v in term.references(problem.setting).items()}
        theirs = term.residual(step_of(problem, x, u[: dynamics.nu], dynamics), p)
        ours = wrapped.residual(step_of(made.problem, nodes, u, None), p)
        np.testing.assert_allclose(value(ours), value(theirs), rtol=1e-12)
        assert wrapped.scale(made.problem.setting) == term.scale(problem.setting)
        assert wrapped.references(made.problem.setting).keys() == p.keys()


def test_e_int_as_it_is_printed() -> None:
    """Of a robot that stands a little above the ground and slides, one point of which carries."""
    problem = biped()
    made = contact_invariant(problem)
    robot, up, slide, load = problem.character, 0.01, 0.02, 0.3
    places = [robot.contact_index(name) for name in made.contacts]
    x = np.tile(problem.start, (3, 1))
    x[:, 2] += up
    x[2, 0] += slide
    forces = np.zeros((3, len(places), 3))
    forces[:, 0, 2] = load
    nodes = np.hstack([x, forces.reshape(3, -1)])
    term = made.problem.costs[-1]
    assert term.label == "Interaction" and term.weight == 100.0
    found = value(term.residual(step_of(made.problem, nodes, np.zeros(0), None), {}))
    heights = octo.kinematics.sphere_centers(robot, x[2])[places, 2]
    heights -= [robot.contacts[k].radius for k in places]
    speed, wanted = slide / problem.dt, 0.0
    for k, height in enumerate(heights / problem.length):
        carries = 0.5 * np.tanh(20.0 * (load if k == 0 else 0.0) - 2.0) + 0.5
        away = speed**2 / (problem.gravity * problem.length) + height**2
        wanted += min(height, 0.0) ** 2 + carries * away
    assert np.sum(found**2) == pytest.approx(wanted, rel=1e-9)
    deep = nodes - np.eye(1, len(nodes[0]), 2) * 2.0 * up  # as deep as it was high
    more = value(term.residual(step_of(made.problem, deep, np.zeros(0), None), {}))
    assert np.sum(more**2) > np.sum(found**2)


def ball() -> octo.Problem:
    """A ball that is to move along, with one contact."""
    robot = octo.objects.ball(radius=0.1, mass=1.0, position=(0.0, 0.0, 0.1))
    return octo.Problem(robot, steps=4, dt=0.05, costs=COSTS[:1])


def test_what_it_poses_is_solved_like_any_other_problem() -> None:
    made = contact_invariant(ball(), weight=1000.0)
    soft = SqpOptions(step="levenberg_marquardt", hessian="gauss_newton", penalty=100.0)
    for options in (soft, SqpOptions()):
        found = octo.solve(made.problem, options=options, max_iterations=300, device="cpu")
        assert found.converged and found.violation < 0.05
        carried = made.forces(found.x)[:, 0, 2] / made.robot.weight
        assert np.abs(carried.mean() - 1.0) < 0.1
    assert found.violation < 1e-9


@pytest.mark.parametrize(
    ("error", "said", "ask"),
    [
        (UnknownNameError, "left_claw", lambda: contact_invariant(biped(), ["left_claw"])),
        (ProblemError, "must be a list", lambda: contact_invariant(biped(), "left_foot")),
        (ProblemError, "contacts is empty", lambda: contact_invariant(biped(), [])),
        (ValueRangeError, "weight", lambda: contact_invariant(biped(), weight=-1.0)),
        (
            ProblemError,
            "TorqueLimits is a constraint",
            lambda: contact_invariant(biped(constraints=[octo.TorqueLimits(limit=9.0)])),
        ),
        (
            ProblemError,
            "octo.Plane",
            lambda: contact_invariant(biped(terrain=octo.worlds.stairs())),
        ),
        (ShapeError, "x", lambda: contact_invariant(biped()).motion(np.zeros((3, 4)))),
    ],
)
def test_what_it_refuses(error: type[Exception], said: str, ask: Callable[[], object]) -> None:
    with pytest.raises(error, match=said):
        ask()
