"""What a solution says of its feet, its forces and the ground, against numbers made by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import octo
from octo.model.character import Body, Character, ContactSphere, Joint, floating_base
from octo.problem.compiled import CompiledProblem
from octo.result import measure
from octo.result.solution import Solution

STEPS, DT, RADIUS = 12, 0.05, 0.02


def block() -> Character:
    """3 kg on four spheres, with a flywheel that gives it an actuator."""
    corners = [(0.2 * a, 0.1 * b, -0.1) for a in (1, -1) for b in (1, -1)]
    contacts = tuple(
        ContactSphere(f"corner_{k}", 0, np.array(c), RADIUS) for k, c in enumerate(corners)
    )
    wheel = Joint("wheel", "hinge", np.array([0.0, 1.0, 0.0]), torque_limit=2.0)
    inertia = np.diag([0.01, 0.02, 0.03])
    body = Body("block", -1, floating_base(), mass=2.0, inertia=inertia)
    return Character(
        "block", (body, Body("wheel", 0, (wheel,), mass=1.0, inertia=inertia)), contacts
    )


def moving(
    slope: float = 0.0, speed: float = 0.3, depth: float = 0.004
) -> tuple[CompiledProblem, dict]:
    """The block slides level over the ground at constant speed, ``depth`` m in it; fields of the
    Solution."""
    x0 = np.array([0.0, 0.0, 0.1 + RADIUS - depth, 0.0, 0.0, 0.0, 0.0])
    v0 = np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5])
    problem = octo.Problem(
        block(),
        steps=STEPS,
        dt=DT,
        x0=x0,
        v0=v0,
        costs=octo.costs.paper(),
        terrain=octo.Plane(slope=slope),
        parameters={"contact.w_perp": 3e4, "contact.w_par": 3e5, "contact.onset": 0.0},
    )
    compiled = CompiledProblem([problem])
    nodes = (x0 + DT * v0 * np.arange(-1, STEPS + 1)[:, None])[None]
    return compiled, measure.measured(compiled, compiled.evaluate(compiled.unknowns(nodes)), 0)


def solution(fields: dict, **changes) -> Solution:
    other = {
        "multipliers": np.zeros(0),
        "status": octo.Status.ITERATION_LIMIT,
        "iterations": 0,
        "factorizations": 0,
        "history": {},
        "seconds": 0.0,
        "setup_seconds": 0.0,
    }
    return Solution(**{**fields, **other, **changes})


def test_feet_that_slide():
    _, fields = moving()
    found = solution(fields)
    normal, along = 3e4 * 0.004**2, 3e5 * 0.004**2 * 0.3
    np.testing.assert_allclose(
        found.contact_force, np.broadcast_to([-along, 0.0, normal], (STEPS, 4, 3)), rtol=1e-9
    )
    np.testing.assert_allclose(found.contact_depth, 0.004, rtol=1e-9)
    np.testing.assert_allclose(found.contact_point[0, 0], [0.2 + 0.3 * DT, 0.1, -0.004], atol=0.005)
    assert found.contact_names == ("corner_0", "corner_1", "corner_2", "corner_3")
    assert found.slip == pytest.approx(
        0.3
    ) and found.penetration == found.penetration_max == pytest.approx(0.004)
    assert found.friction_use == found.friction_use_95 == pytest.approx(along / normal)
    assert found.loaded.all()
    np.testing.assert_allclose(
        found.com[-1] - found.com[0], [0.3 * STEPS * DT, 0.0, 0.0], atol=1e-12
    )


def test_residual_and_violation_are_newtons():
    """At constant velocity FD is gravity and contact alone: the missing force, and the moment over
    ℓ, in N."""
    compiled, fields = moving()
    normal, along = 4 * 3e4 * 0.004**2, 4 * 3e5 * 0.004**2 * 0.3
    length = compiled.problems[0].length
    assert length == pytest.approx(0.1 + RADIUS)
    missing = 3.0 * 9.81 - normal
    moment = along * (0.1 + RADIUS - 0.004) / length
    rows = compiled.evaluate(fields["unknowns"][None]).fd[0]
    np.testing.assert_allclose(rows[:, 0], along, rtol=1e-9)
    np.testing.assert_allclose(rows[:, 2], missing, rtol=1e-9)
    assert (
        fields["violation"]
        == fields["pointwise_residual"]
        == pytest.approx(max(missing, along, moment), rel=0.05)
    )


def test_torques_and_terms():
    _, fields = moving()
    found = solution(fields, u=np.full((STEPS, 1), -3.0))
    assert found.torque_excess == pytest.approx(1.5)
    assert solution(fields, torque_limit=np.array([np.inf])).torque_excess == 0.0
    assert found.energy == pytest.approx(sum(found.terms.values()))
    assert found.terms["CenterOfMassVelocity"] == pytest.approx((0.3 - 0.5) ** 2 / 0.25)


def test_feet_in_the_air_are_not_loaded():
    _, fields = moving(depth=-0.05)
    found = solution(fields)
    report = found.report()
    for name in ("penetration", "penetration_max", "slip", "friction_use", "friction_use_95"):
        assert report[name] == 0.0
    assert not found.loaded.any() and np.isfinite(list(report["terms"].values())).all()


def test_ground_is_sampled_around_the_motion():
    _, fields = moving(slope=0.2)
    ground = fields["ground"]
    x, _ = np.meshgrid(ground["x"], ground["y"], indexing="ij")
    np.testing.assert_allclose(ground["z"], np.tan(0.2) * x, atol=1e-9)
    assert ground["x"][0] <= -1.1 and ground["x"][-1] >= 1.1 and len(ground["x"]) > 20


def test_a_robot_without_contacts_has_no_feet():
    robot = dataclasses.replace(block(), contacts=())
    problem = octo.Problem(robot, steps=3, dt=DT, x0=np.zeros(7), costs=octo.costs.paper())
    compiled = CompiledProblem([problem])
    fields = measure.measured(compiled, compiled.evaluate(np.zeros((1, 3, 7))), 0)
    found = solution(fields)
    assert found.contact_force.shape == (3, 0, 3) and found.slip == found.penetration == 0.0


def test_the_ground_of_a_world_may_have_an_underside():
    """A platform that ends: its top is the ground, and beside it there is none."""
    platform = octo.shapes.Box((0.8, 9.0, 0.5), position=(0.0, 0.0, -0.25))
    world = octo.World([platform])
    problem = octo.Problem(block(), steps=3, dt=DT, costs=[octo.Effort()], terrain=world)
    ground = measure.ground(problem.dynamics, problem.p, np.zeros((1, 3)))
    on = np.abs(ground["x"]) < 0.3
    np.testing.assert_allclose(ground["z"][on], 0.0, atol=1e-6)
    assert (ground["z"][np.abs(ground["x"]) > 0.5] < -3.0).all()
