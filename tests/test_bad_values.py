"""Bad values in Python: an OctoError whose one sentence names the field and what is allowed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import octo
from octo.model.character import Body, Character, ContactSphere, Joint
from octo.problem import codegen

MAMMAL = octo.gallery.mammal()
NX = MAMMAL.nx
GOOD: dict[str, Any] = {"steps": 20, "dt": 0.025, "costs": [octo.Effort()]}


def problem(**changes: Any) -> octo.Problem:
    return octo.Problem(MAMMAL, **{**GOOD, **changes})


def packed(term: octo.Cost) -> Any:
    """What compiling does with a term, without compiling."""
    made = problem(costs=[term], x0=MAMMAL.default_pose)
    return codegen.residuals_of(made.dynamics, made.costs, made.setting, False).references.pack(
        made.costs, made.setting
    )


def double_integrator(fd: Any = None, **changes: Any) -> octo.CustomDynamics:
    values = {"nx": 2, "actuated": [0], "parameters": {}, **changes}
    return octo.CustomDynamics(
        fd or (lambda x_next, x, x_prev, p: x_next - 2 * x + x_prev), **values
    )


def character(**changes: Any) -> Character:
    hinge = Joint("hinge", "hinge", np.array([0.0, 1.0, 0.0]))
    body = Body("arm", -1, (hinge,), mass=1.0, inertia=np.eye(3))
    return Character(**{"name": "arm", "bodies": (body,), "base": "fixed", **changes})


def arm(**changes: Any) -> tuple[Body, ...]:
    return (replace(character().bodies[0], **changes),)


def joint(**changes: Any) -> tuple[Body, ...]:
    return arm(joints=(replace(character().joints[0], **changes),))


def buried() -> Any:
    pose = np.array(MAMMAL.default_pose)
    pose[2] -= 1.0
    return pose


BALL = ContactSphere("ball", 0, np.zeros(3), 0.1)
STILL = np.zeros(NX)
COM, ROWS = octo.CenterOfMassVelocity, np.zeros((7, 3))
CASES: dict[str, tuple[Callable[[], Any], str]] = {
    "no steps": (lambda: problem(steps=0), "steps is 0, must be a whole number of at least 1"),
    "half a step": (lambda: problem(steps=1.5), "steps is 1.5, must be a whole number"),
    "steps in words": (lambda: problem(steps="ten"), "steps is 'ten', must be a whole number"),
    "dt not finite": (lambda: problem(dt=np.nan), "dt is nan s, must be positive"),
    "no model": (lambda: octo.Problem("mammal", **GOOD), "model is a str, must be a Character"),
    "no costs": (lambda: problem(costs=[]), "costs is empty: give at least one term"),
    "one cost, no list": (
        lambda: problem(costs=octo.Effort()),
        "costs is an Effort, must be a list",
    ),
    "a number for a cost": (
        lambda: problem(costs=[3]),
        "costs holds 3, must hold octo.Cost objects",
    ),
    "one name twice": (
        lambda: problem(costs=[octo.Effort(), octo.Effort()]),
        "two terms named 'Effort'.*name=",
    ),
    "x0 of another robot": (
        lambda: problem(x0=np.zeros(3)),
        rf"x0 has shape \(3,\), expected \({NX},\)",
    ),
    "x0 not finite": (lambda: problem(x0=np.full(NX, np.nan)), "x0 is not finite at index 0"),
    "x0 in words": (lambda: problem(x0="home"), "x0 is 'home', must be numbers"),
    "x0 under the ground": (
        lambda: problem(x0=buried()),
        "x0 is under the ground: contact .* m deep, must be above",
    ),
    "x0 and pose": (lambda: problem(x0=STILL, pose=STILL), "x0 and pose are both given"),
    "v0 of another robot": (lambda: problem(v0=np.zeros(3)), "v0 has shape"),
    "v_end alone": (lambda: problem(v_end=STILL), "v_end is given without x_end"),
    "two ends": (
        lambda: problem(x_end=STILL, displacement=STILL),
        "x_end and displacement are both given",
    ),
    "displacement of another robot": (
        lambda: problem(displacement=np.zeros(3)),
        "displacement has shape",
    ),
    "x_end too early": (
        lambda: problem(x_end=MAMMAL.default_pose, steps=2),
        "steps is 2: a fixed end state needs at least 3",
    ),
    "x_end too early for Hermite": (
        lambda: problem(x_end=MAMMAL.default_pose, steps=10, basis="hermite"),
        "steps is 10: a fixed end state needs at least 20",
    ),
    "unknown parameter": (
        lambda: problem(parameters={"contact.w_prep": 1.0}),
        "'contact.w_prep'.*contact.w_perp",
    ),
    "parameter not finite": (
        lambda: problem(parameters={"gravity_z": np.nan}),
        "parameter gravity_z is not finite",
    ),
    "unknown basis": (
        lambda: problem(basis="node"),
        "basis 'node' is not known; did you mean nodes",
    ),
    "Hermite segments of one step": (
        lambda: problem(basis=octo.Hermite(1)),
        "steps_per_segment is 1, must be at least 2",
    ),
    "no multiple of a segment": (
        lambda: problem(basis="hermite", steps=25),
        "steps is 25, must be a multiple.*10",
    ),
    "terrain by name": (
        lambda: problem(terrain="plane"),
        "terrain is 'plane', must be an octo.Plane",
    ),
    "law by name": (lambda: problem(law="coulomb"), "law is 'coulomb', must be one of octo.laws"),
    "a wall": (lambda: octo.Plane(slope=2.0), "slope is 2.0 rad, must be between"),
    "a plane at no height": (lambda: octo.Plane(height=np.nan), "terrain height is not finite"),
    "reference of two numbers": (
        lambda: packed(COM(velocity=(1, 0))),
        r"velocity has shape \(2,\), expected \(3,\) or",
    ),
    "reference not finite": (
        lambda: packed(COM(velocity=(1, 0, np.nan))),
        "velocity is not finite at index 2",
    ),
    "reference in words": (
        lambda: packed(COM(velocity="fast")),
        "velocity is 'fast', must be numbers",
    ),
    "too few rows": (lambda: packed(COM(velocity=ROWS)), r"\(7, 3\), expected \(3,\) or \(20, 3\)"),
    "weight of another length": (
        lambda: packed(octo.Effort(weight=np.ones(7))),
        r"Effort.weight has shape \(7,\), expected .*20",
    ),
    "negative weight": (
        lambda: packed(octo.Effort(weight=-1.0)),
        "Effort.weight is -1.0, must not be negative",
    ),
    "unknown steps of a term": (
        lambda: problem(costs=[octo.Effort(steps="first")]),
        "Effort.steps 'first'.*last",
    ),
    "unknown body": (lambda: packed(octo.PointPosition(body="trunks")), "body 'trunks'.*trunk"),
    "unknown contact": (
        lambda: packed(octo.Slip(contacts=("front_lef",))),
        "contact 'front_lef'.*front_left",
    ),
    "posture of three joints": (
        lambda: packed(octo.Posture(reference=np.zeros(3))),
        r"Posture.reference has shape \(3,\)",
    ),
    "weights of three joints": (
        lambda: packed(octo.Posture(joints=np.ones(3))),
        r"Posture.joints has shape \(3,\)",
    ),
    "no target": (lambda: packed(octo.PoseTarget()), "PoseTarget.target is missing"),
    "target of four": (lambda: packed(octo.PoseTarget(target=np.zeros(4))), r"target|operands"),
    "no function": (
        lambda: packed(octo.CustomCost()),
        r"CustomCost.function is missing: give function\(step, p\)",
    ),
    "a function that fails": (
        lambda: packed(octo.CustomCost(function=lambda step, p: p["a"])),
        "CustomCost.*KeyError: 'a'",
    ),
    "a function of nothing": (
        lambda: packed(octo.CustomCost(function=lambda step, p: None)),
        "CustomCost.*cannot be built",
    ),
    "a length of zero": (
        lambda: packed(octo.Slip(length=0.0)),
        "Slip.length is 0.0 m, must be positive",
    ),
    "FD of one row": (
        lambda: double_integrator(lambda a, b, c, p: a[0]),
        "returns 1 entries, must be nx = 2",
    ),
    "FD that fails": (
        lambda: double_integrator(lambda a, b, c, p: a * p["mass"]),
        "FD cannot be built: KeyError: 'mass'",
    ),
    "a joint that is not there": (
        lambda: double_integrator(actuated=[5]),
        r"actuated is \[5\], must be different indices",
    ),
    "a joint twice": (
        lambda: double_integrator(actuated=[0, 0]),
        r"actuated is \[0, 0\], must be different",
    ),
    "user-written dynamics from nowhere": (
        lambda: octo.Problem(double_integrator(), **GOOD).start,
        "x0 is missing",
    ),
    "ground under user-written dynamics": (
        lambda: octo.Problem(double_integrator(), terrain=octo.Plane(), **GOOD),
        "terrain and law belong to a Character",
    ),
    "unknown goal": (lambda: octo.Goal("wlak"), "goal 'wlak'.*walk"),  # type: ignore[arg-type]
    "speed not finite": (lambda: octo.Goal("walk", speed=np.inf), "speed is not finite"),
    "no mass": (lambda: character(bodies=arm(mass=0.0)), "total mass is 0.0, must be positive"),
    "negative mass": (
        lambda: character(bodies=arm(mass=-1.0)),
        "body 'arm': mass is -1.0, must be finite and not negative",
    ),
    "a parent that comes later": (
        lambda: character(bodies=arm(parent=1)),
        "body 'arm': parent index 1 must be",
    ),
    "limits the wrong way round": (
        lambda: character(bodies=joint(lower=1.0, upper=-1.0)),
        "lower limit 1.0 is above",
    ),
    "a contact on no body": (
        lambda: character(contacts=(replace(BALL, body=3),)),
        "body index 3 is not in 0…0",
    ),
    "a negative radius": (
        lambda: character(contacts=(replace(BALL, radius=-1.0),)),
        "contact 'ball': radius is -1.0",
    ),
    "a pair of one": (
        lambda: character(contacts=(BALL,), pairs=((0, 0),)),
        r"pair \(0, 0\): must be two different indices",
    ),
    "simulation from three numbers": (
        lambda: octo.simulate(MAMMAL, np.zeros(3), seconds=1),
        "x0 has shape",
    ),
    "simulation without an end": (
        lambda: octo.simulate(MAMMAL, STILL),
        "give seconds, steps, or an array of controls",
    ),
    "controls of three joints": (
        lambda: octo.simulate(MAMMAL, STILL, controls=np.zeros((4, 3))),
        "controls has shape",
    ),
    "unknown Hessian": (lambda: octo.SqpOptions(hessian="exct"), "hessian 'exct'.*exact"),  # type: ignore[arg-type]
    "negative tolerance": (
        lambda: octo.SqpOptions(tolerance=-1.0),
        "tolerance is -1.0, must be positive",
    ),
    "no start": (
        lambda: octo.solve(problem(), seeds=0),
        "seeds is 0, must be a whole number of at least 1",
    ),
    "no problem": (lambda: octo.solve([]), "list of problems is empty"),
    "unknown device": (lambda: octo.solve(problem(), device="tpu"), "device 'tpu'.*cpu"),
    "a start of one row": (
        lambda: octo.solve(problem(), start=np.zeros((1, NX))),
        r"start has shape \(1, 18\), expected \(N\+1, 18\)",
    ),
    "a start not finite": (
        lambda: octo.solve(problem(), start=np.full((21, NX), np.nan)),
        "start is not finite",
    ),
    "passes of a law that cannot grow": (
        lambda: octo.solve(problem(law=octo.laws.Compliant()), passes=2),
        "passes is 2: the stiffness of this contact law is fixed.*must be 1",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_refused(name: str) -> None:
    make, sentence = CASES[name]
    with pytest.raises(octo.errors.OctoError, match=sentence) as caught:
        make()
    assert "\n" not in str(caught.value)
