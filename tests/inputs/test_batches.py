"""A batch has one structure: numbers may differ, anything else is refused by name."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import octo
from octo.dynamics.laws import Coulomb, Smooth, Viscous
from octo.errors import ProblemError
from octo.model.gallery import mammal
from octo.problem.basis import Hermite
from octo.problem.costs import Cost

ROBOT = mammal()
QUICK = {"passes": 1, "max_iterations": 4, "device": "cpu"}


def problem(*terms: Cost, robot=ROBOT, **given) -> octo.Problem:
    own = {"steps": 8, "dt": 0.025, "x0": robot.default_pose, **given}
    return octo.Problem(robot, costs=[octo.Effort(), *terms], **own)


def lifted(by: float) -> np.ndarray:
    pose = ROBOT.default_pose.copy()
    pose[2] += by
    return pose


class Gain(Cost):
    """A term of a user's own, whose gain is part of its residual and not a reference."""

    def __init__(self, gain: float):
        super().__init__()
        object.__setattr__(self, "gain", gain)

    def residual(self, step, p):
        return self.gain * step.x_next


def between(power: int) -> octo.NeighbourCost:
    return octo.NeighbourCost(lambda c, after, p: (after - c) ** power)


REFUSED = {
    "body of a point": (
        octo.PointPosition(body="front_left_shank"),
        octo.PointPosition(body="hind_left_shank"),
        r"PointPosition\.body \('hind_left_shank'\)",
    ),
    "body of an orientation": (
        octo.BaseOrientation(),
        octo.BaseOrientation(body="front_left_thigh"),
        r"BaseOrientation\.body",
    ),
    "contacts": (
        octo.Slip(contacts=("front_left",)),
        octo.Slip(contacts=("front_right",)),
        r"Slip\.contacts",
    ),
    "contacts by default and by name": (
        octo.FrictionCone(),
        octo.FrictionCone(contacts=("hind_left", "hind_right")),
        r"FrictionCone\.contacts",
    ),
    "function": (
        octo.CustomCost(lambda step, p: step.x_next),
        octo.CustomCost(lambda step, p: ca.sin(step.x_next)),
        r"CustomCost\.function",
    ),
    "names of the references": (
        octo.CustomCost(lambda step, p: next(iter(p.values())) * step.u, {"a": 1.0}),
        octo.CustomCost(lambda step, p: next(iter(p.values())) * step.u, {"b": 1.0}),
        r"CustomCost\.values",
    ),
    "what a closure holds": (Gain(1.0), Gain(2.0), r"Gain\.residual"),
    "order of a difference": (between(1), between(2), r"NeighbourCost\.function"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_terms_that_differ_in_structure_are_refused_by_name(what):
    one, other, said = REFUSED[what]
    with pytest.raises(ProblemError, match=f"terms differ.*{said}.*of problem 2") as error:
        octo.solve([problem(one), problem(one), problem(other)], **QUICK)
    assert "\n" not in str(error.value) and len(str(error.value)) < 300


def test_a_term_between_hermite_controls_is_compared_too():
    basis = {"basis": Hermite(4)}
    with pytest.raises(ProblemError, match=r"NeighbourCost\.function"):
        octo.solve([problem(between(1), **basis), problem(between(2), **basis)], **QUICK)


def test_other_feet_at_the_start_are_refused():
    """Contacts "feet" are those on the ground: of a robot in the air none."""
    feet = [problem(octo.LoadSharing(contacts="feet"), x0=lifted(by)) for by in (0.0, 0.3)]
    with pytest.raises(
        ProblemError, match="LoadSharing.contacts .those on the ground at the start"
    ):
        octo.solve(feet, **QUICK)


MODELS = {
    "friction": {"law": Smooth(friction=Coulomb())},
    "ground": {"terrain": octo.Terrain(lambda point, p: point[2] - 0.01 * ca.sin(point[0]))},
}


@pytest.mark.parametrize("what", MODELS)
def test_another_model_is_refused(what):
    with pytest.raises(ProblemError, match="model differ"):
        octo.solve([problem(), problem(**MODELS[what])], **QUICK)


def test_other_motors_of_the_same_dynamics_are_refused():
    def fd(x_next, x, x_prev, p):
        return (x_next - 2 * x + x_prev) / p["dt"] ** 2

    models = [octo.CustomDynamics(fd, 2, [k], {}) for k in (0, 1)]
    both = [octo.Problem(m, steps=4, dt=0.1, x0=[0, 0], costs=[octo.Effort()]) for m in models]
    with pytest.raises(ProblemError, match="model differ"):
        octo.solve(both, **QUICK)


SAME = {
    "references": [octo.CenterOfMassVelocity((0.1 * k, 0.0, 0.0), weight=1.0 + k) for k in (1, 2)],
    "lists made twice": [octo.Slip(contacts=("front_left",)) for _ in range(2)],
    "contacts in two ways": [
        octo.Slip(contacts=name)
        for name in ("feet", ("front_left", "front_right", "hind_left", "hind_right"))
    ],
    "function of equal text": [octo.CustomCost(lambda step, p: step.x_next) for _ in range(2)],
    "values": [octo.CustomCost(lambda s, p: p["a"] * s.u, {"a": a}) for a in (1.0, 2.0)],
    "closure": [Gain(3.0), Gain(3.0)],
}


@pytest.mark.parametrize("what", SAME)
def test_numbers_may_differ_and_each_member_is_its_own_problem(what):
    described = [problem(term) for term in SAME[what]]
    for member, alone in zip(octo.solve(described, **QUICK), described, strict=True):
        expected = octo.solve(alone, **QUICK)
        np.testing.assert_allclose(member.energy, expected.energy, rtol=1e-9)
        np.testing.assert_allclose(member.x, expected.x, atol=1e-9)


def test_each_member_has_the_passes_of_its_own_height():
    """Depths of a pass go with the height of the base at the start: one of the two crouches."""
    low = ROBOT.default_pose.copy()
    low[ROBOT.nx - ROBOT.nu :] *= 1.15
    low[2] *= 0.9
    options = {**QUICK, "passes": 2}
    described = [problem(x0=pose) for pose in (ROBOT.default_pose, low)]
    assert described[0].length != described[1].length
    for member, alone in zip(octo.solve(described, **options), described, strict=True):
        expected = octo.solve(alone, **options)
        assert member.parameters == pytest.approx(expected.parameters, rel=1e-12)


def test_each_member_has_the_friction_of_its_own_law():
    """Under laws of one text the ratio w_par/w_perp is a number."""
    laws = [Smooth(friction=Viscous(w_par=ratio * Smooth().w_perp)) for ratio in (5.0, 20.0)]
    described = [problem(law=law) for law in laws]
    for member, alone in zip(octo.solve(described, **QUICK), described, strict=True):
        expected = octo.solve(alone, **QUICK)
        assert member.parameters == pytest.approx(expected.parameters, rel=1e-12)
        np.testing.assert_allclose(member.energy, expected.energy, rtol=1e-9)


def test_a_robot_made_twice_is_one_model():
    twice = [problem(octo.Slip(contacts="feet"), robot=mammal()) for _ in range(2)]
    one, other = octo.solve(twice, **QUICK)
    np.testing.assert_allclose(one.x, other.x, atol=1e-12)
