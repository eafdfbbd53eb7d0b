"""Controller.update: a number changes the plan's residual, what is compiled is refused by name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

import octo
from octo.errors import OctoError, ProblemError, ShapeError, UnknownNameError
from octo.model.gallery import mammal
from octo.mpc import Controller

ROBOT = mammal()
TERMS = [
    octo.PointPosition(body="front_left_shank", target=(0.3, 0.1, 0.0), at="all"),
    octo.BaseOrientation(),
    octo.Slip(),
    octo.JointLimit(weight=20.0),
    octo.CenterOfMassVelocity((0.3, 0.0, 0.0)),
    octo.CustomCost(lambda step, p: next(iter(p.values())) * step.u, {"gain": 0.1}),
    octo.Effort(),
]


@pytest.fixture(scope="module")
def controller() -> Controller:
    problem = octo.Problem(ROBOT, steps=8, dt=0.03, costs=TERMS, x0=ROBOT.default_pose)
    return Controller(problem)


def values(controller: Controller) -> np.ndarray:
    """(terms,) E at nodes that move, so that every term has something to say."""
    nodes = controller.horizon.nodes
    kept = nodes.copy()
    nodes[:] = ROBOT.default_pose + 0.9 * np.sin(np.arange(nodes.size)).reshape(nodes.shape)
    controller.horizon.evaluate()
    found = controller.horizon.terms.sum(axis=0).copy()
    nodes[:] = kept
    controller.horizon.evaluate()
    return found


FIXED: dict[str, tuple[str, Mapping[str, object], str]] = {
    "body of a point": ("PointPosition", {"body": "hind_left_shank"}, "body"),
    "body of an orientation": ("BaseOrientation", {"body": "front_left_thigh"}, "body"),
    "contacts": ("Slip", {"contacts": ("front_left",)}, "contacts"),
    "function": ("CustomCost", {"function": lambda step, p: step.u**2}, "function"),
    "names of values": ("CustomCost", {"values": {"other": 1.0}}, "values"),
    "size of values": ("CustomCost", {"values": {"gain": np.ones(ROBOT.nu)}}, "values"),
    "name": ("Effort", {"name": "Torque"}, "name"),
    "a number beside it": ("PointPosition", {"target": (0.0, 0.0, 0.0), "body": None}, "body"),
    "scale": ("CustomCost", {"fixed_scale": 2.0}, "fixed_scale"),
}


@pytest.mark.parametrize("what", FIXED)
def test_what_is_compiled_is_refused_by_name_and_nothing_changes(controller, what):
    label, changes, name = FIXED[what]
    before, q = controller.problem, controller.compiled.q.copy()
    with pytest.raises(OctoError, match=rf"{label}\.{name} cannot be updated") as error:
        controller.update(label, **changes)
    assert "\n" not in str(error.value)
    np.testing.assert_array_equal(controller.compiled.q, q)
    assert controller.problem is before


NUMBERS: dict[str, tuple[str, Mapping[str, object]]] = {
    "at": ("PointPosition", {"at": [0, -1]}),
    "steps": ("PointPosition", {"steps": "last", "weight": 2.0}),
    "target": ("PointPosition", {"target": (0.0, -0.4, 0.3)}),
    "point and axes": ("PointPosition", {"point": (0.0, 0.0, -0.1), "axes": (1.0, 0.0, 0.0)}),
    "angles": ("BaseOrientation", {"roll_pitch_yaw": (0.2, 0.0, 0.1)}),
    "length": ("Slip", {"length": 0.1}),
    "margin": ("JointLimit", {"margin": 0.1}),
    "velocity for each step": ("CenterOfMassVelocity", {"velocity": np.ones((8, 3))}),
    "value": ("CustomCost", {"values": {"gain": 0.7}}),
    "weight": ("Effort", {"weight": 5.0}),
    "weight for each step": ("Effort", {"weight": np.arange(8.0)}),
}


@pytest.mark.parametrize("what", NUMBERS)
def test_a_number_changes_its_term_alone_and_as_a_new_controller_would(controller, what):
    label, changes = NUMBERS[what]
    k = [term.label for term in controller.problem.costs].index(label)
    term, q, before = controller.problem.costs[k], controller.compiled.q.copy(), values(controller)
    controller.update(label, **changes)
    after, changed = values(controller), controller.problem
    controller.compiled.q[:] = q
    controller.problem = octo.Problem(ROBOT, steps=8, dt=0.03, costs=TERMS, x0=ROBOT.default_pose)
    others = np.arange(len(TERMS)) != k
    np.testing.assert_array_equal(after[others], before[others])
    assert abs(after[k] - before[k]) > 1e-6 * abs(before[k])
    fresh = Controller(changed)
    scale = changed.costs[k].scale(changed.setting) / term.scale(changed.setting)  # it stays
    np.testing.assert_allclose(after[k], values(fresh)[k] * scale, rtol=1e-9)


def test_the_same_body_by_name_is_no_change(controller):
    controller.update("PointPosition", body="front_left_shank")


def test_the_scale_stays_that_of_the_problem_over_several_updates(controller):
    q = controller.compiled.q.copy()
    controller.update("CenterOfMassVelocity", velocity=(3.0, 0.0, 0.0))
    controller.update("CenterOfMassVelocity", weight=2.0)
    coefficient = controller.compiled.q[0, 0, 4]
    controller.compiled.q[:] = q
    assert coefficient == pytest.approx(2.0 / (8 * 0.3**2))


def test_other_mistakes_say_what_is_allowed(controller):
    with pytest.raises(UnknownNameError, match="field of Slip 'lenght'.*length"):
        controller.update("Slip", lenght=0.1)
    with pytest.raises(ShapeError, match=r"CenterOfMassVelocity.velocity has shape \(\)"):
        controller.update("CenterOfMassVelocity", velocity=0.5)
    with pytest.raises(ProblemError, match="JointLimit.name"):
        controller.update("JointLimit", name="Limits")
