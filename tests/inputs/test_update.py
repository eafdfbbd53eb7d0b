"""Controller.update: a number changes the plan's residual, what is compiled is refused by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

import octo
from octo.errors import OctoError, ProblemError, ShapeError, UnknownNameError
from octo.model.gallery import mammal
from octo.mpc import Controller

ROBOT = mammal()
TERMS = [
    octo.PointPosition(body="front_left_shank", target=(0.3, 0.1, 0.0), steps="all"),
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
    "steps": ("PointPosition", {"steps": "last"}, "steps"),
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


@dataclass(frozen=True, eq=False)
class Branching(octo.Cost):
    """Its residual looks at ``squared`` and, where that is set, at ``power``; at ``gain`` never."""

    gain: float = 1.0
    squared: bool = False
    power: float = 2.0
    limit: float | None = None

    def references(self, setting):
        return {"gain": self.gain} | ({} if self.limit is None else {"limit": self.limit})

    def residual(self, step, p):
        return p["gain"] * (step.u**self.power if self.squared else step.u)


class Derived(Branching):
    """Keeps what its residual is made of beside its fields."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "_sign", 1.0 if self.gain > 0.0 else -1.0)

    def residual(self, step, p):
        return p["gain"] * self._sign * step.u


class Whole(Branching):
    """Its residual looks at its fields without naming them."""

    def residual(self, step, p):
        return p["gain"] * vars(self)["power"] * step.u


class Exact(Branching):
    """Has another residual than its subclasses."""

    def residual(self, step, p):
        return (self.power if type(self) is Exact else 1.0) * p["gain"] * step.u


@pytest.fixture
def own(monkeypatch):
    """A controller of one term, which needs no compiler."""
    monkeypatch.setenv("OCTO_NO_COMPILER", "1")
    return of_one


def of_one(term: octo.Cost) -> Controller:
    return Controller(octo.Problem(ROBOT, steps=8, dt=0.03, costs=[term], x0=ROBOT.default_pose))


def refused(controller: Controller, name: str, value: object) -> None:
    label = controller.problem.costs[0].label
    with pytest.raises(ProblemError, match=rf"{label}\.{name} cannot be updated: it is compiled"):
        controller.update(label, **{name: value})


def test_a_users_residual_may_branch_on_a_field(own):
    controller = own(Branching())
    for gain in (2.0, 3.0):
        controller.update("Branching", gain=gain)
        assert controller.reference("Branching", "gain")[0, 0] == gain
        refused(controller, "squared", True)
        refused(controller, "limit", 1.0)  # another reference
        refused(controller, "gain", np.ones(ROBOT.nu))  # another size
    controller.update("Branching", power=3.0)  # which nothing looks at
    controller = own(Branching(squared=True))
    controller.update("Branching", gain=2.0)
    refused(controller, "power", 3.0)
    controller.update("Branching", gain=4.0, squared=True)
    refused(controller, "power", 3.0)
    assert controller.problem.costs[0].power == 2.0


def test_a_field_that_is_read_may_change_where_the_residual_stays(own):
    """A power of 1 is the branch of no power: after it, another field is looked at."""
    controller = own(Branching(power=1.0))
    controller.update("Branching", gain=2.0)
    controller.update("Branching", squared=True)
    refused(controller, "power", 2.0)


@pytest.mark.parametrize("kind", [Derived, Whole, Exact])
def test_a_users_residual_may_look_at_its_fields_in_other_ways(own, kind):
    controller, label = own(kind(name="Own")), "Own"
    controller.update(label, gain=2.0)
    refused(controller, "gain" if kind is Derived else "power", -3.0)
    controller.update(label, gain=4.0)
    assert controller.reference(label, "gain")[0, 0] == 4.0
    assert "__getattribute__" not in vars(kind)


def test_no_residual_is_formed_again_for_numbers(own, monkeypatch):
    term = octo.CenterOfMassVelocity((0.3, 0.0, 0.0))
    controller = own(term)
    controller.update(term.label, velocity=(0.4, 0.0, 0.0))
    monkeypatch.setattr(type(term), "residual", None)
    controller.update(term.label, velocity=np.ones((8, 3)), weight=2.0)
    assert (controller.reference(term.label, "velocity") == 1.0).all()
