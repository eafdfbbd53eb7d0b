"""The gradient, A and H of every term and of the constraints against finite differences, in both
bases."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from octo import costs
from octo.problem.compiled import CompiledProblem
from octo.solver.blocks import KKTBlocks

SIZES = np.geomspace(1e-3, 1e-5, 5)  # of a step along a direction of length 1
COST_CLASSES = [
    name
    for name in costs.__all__
    if name[0].isupper()
    and issubclass(getattr(costs, name), costs.Cost)
    and name not in ("Cost", "ContactCost")
    and not issubclass(getattr(costs, name), costs.StepPairCost)  # test_step_pairs.py
    and not issubclass(getattr(costs, name), costs.ArrayCost)  # tests/learn
]


def alone(problem: CompiledProblem, label: str) -> CompiledProblem:
    """The same code with all weights zero but one."""
    changed = [
        p.replace(
            costs=[t if t.label == label else dataclasses.replace(t, weight=0.0) for t in p.costs]
        )
        for p in problem.problems
    ]
    return CompiledProblem(changed, problem.threads, like=problem)


def direction(problem: CompiledProblem, seed: int = 1) -> np.ndarray:
    d = np.random.default_rng(seed).standard_normal((problem.batch, problem.K, problem.nc))
    d[:, problem.fixed] = 0.0
    return d / np.linalg.norm(d)


def test_every_class_is_in_the_list(every_cost):
    assert {type(term).__name__ for term in every_cost()} == set(COST_CLASSES)


@pytest.mark.parametrize("label", COST_CLASSES)
@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_gradient_of_a_term(compiled, wiggle, remainder_slope, basis, label):
    problem = alone(compiled(basis), label)
    at, d = wiggle(problem), direction(problem)
    evaluation = problem.evaluate(at)
    place = [term.label for term in problem.problems[0].costs].index(label)
    np.testing.assert_allclose(
        problem.term_values(evaluation)[:, place], evaluation.energy, rtol=1e-12, atol=1e-300
    )
    assert evaluation.energy.sum() > 1e-9
    b = problem.linearize(evaluation, None).b
    assert (
        remainder_slope(lambda h: problem.evaluate(at + h * d).energy.sum(), (b * d).sum(), SIZES)
        > 1.9
    )


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_jacobian_of_the_constraints(compiled, wiggle, remainder_slope, basis):
    problem = compiled(basis)
    at, d = wiggle(problem), direction(problem)
    model = problem.linearize(problem.evaluate(at), None)
    np.testing.assert_allclose(model.C, problem.evaluate(at).C, rtol=1e-12, atol=1e-12)
    change = KKTBlocks(model.H, model.A, model.b, model.C).constraints_times(d)
    assert remainder_slope(lambda h: problem.evaluate(at + h * d).C, change, SIZES) > 1.9


def gradient_of_lagrangian(
    problem: CompiledProblem, unknowns: np.ndarray, lam: np.ndarray
) -> np.ndarray:
    model = problem.linearize(problem.evaluate(unknowns), None)
    gradient = model.b + KKTBlocks(model.H, model.A, model.b, model.C).constraints_transposed_times(
        lam
    )
    gradient[:, problem.fixed] = 0.0
    return gradient


# in x and u
LINEAR = ("Effort", "TorqueLimit", "Posture", "JointVelocity", "JointAcceleration", "PoseTarget")
TOUCHING = [name for name in COST_CLASSES if issubclass(getattr(costs, name), costs.ContactCost)]


@pytest.mark.parametrize(
    "exact", [LINEAR, *((name,) for name in TOUCHING)], ids=["linear", *TOUCHING]
)
@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_exact_hessian(compiled, wiggle, basis, exact):
    """Of terms linear in x and u, and over contacts, H is the whole second derivative of E + lamᵀC,
    jumps of laws apart."""
    full = compiled(basis)
    changed = [
        p.replace(
            costs=[t if t.label in exact else dataclasses.replace(t, weight=0.0) for t in p.costs]
        )
        for p in full.problems
    ]
    problem = CompiledProblem(changed, like=full)
    at, d = wiggle(problem), direction(problem)
    lam = np.random.default_rng(5).standard_normal((problem.batch, problem.K, problem.ma))
    model = problem.linearize(problem.evaluate(at), lam)
    product = KKTBlocks(model.H, model.A, model.b, model.C).hessian_times(d)
    h = 1e-5
    difference = (
        gradient_of_lagrangian(problem, at + h * d, lam)
        - gradient_of_lagrangian(problem, at - h * d, lam)
    ) / (2 * h)
    np.testing.assert_allclose(product, difference, atol=1e-6 * np.abs(difference).max())
    plain = problem.linearize(problem.evaluate(at), np.zeros_like(lam))
    # curvature of the residuals themselves
    difference = plain.H - problem.linearize(problem.evaluate(at), None).H
    assert np.abs(difference).max() > 1e-4 * np.abs(plain.H).max()


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_other_terms_keep_the_gauss_newton_hessian(compiled, wiggle, basis):
    """H(lam) − H(no lam) does not know the other terms; and JᵀJ is the whole Hessian of a term
    whose residual is zero."""
    full = compiled(basis)
    at = wiggle(full)
    lam = np.random.default_rng(5).standard_normal((full.batch, full.K, full.ma))
    evaluation = full.evaluate(at)
    added = full.linearize(evaluation, lam).H - full.linearize(evaluation, None).H
    torque = [
        p.replace(
            costs=[
                dataclasses.replace(t, weight=t.weight if _is_curved(t) else 0.0) for t in p.costs
            ]
        )
        for p in full.problems
    ]
    only = CompiledProblem(torque, like=full)
    same = only.linearize(only.evaluate(at), lam).H - only.linearize(only.evaluate(at), None).H
    np.testing.assert_allclose(added, same, atol=1e-11 * np.abs(added).max())

    com = np.stack([_com_velocity(full, nodes) for nodes in evaluation.nodes])
    followed = [
        p.replace(
            costs=[
                dataclasses.replace(t, velocity=v)
                if t.label == "CenterOfMassVelocity"
                else dataclasses.replace(t, weight=0.0)
                for t in p.costs
            ]
        )
        for p, v in zip(full.problems, com, strict=True)
    ]
    problem = CompiledProblem(followed, like=full)
    d = direction(problem)
    model = problem.linearize(problem.evaluate(at), None)
    assert problem.evaluate(at).energy.max() < 1e-20
    product = KKTBlocks(model.H, model.A, model.b, model.C).hessian_times(d)
    zero, h = np.zeros_like(lam), 1e-5
    difference = (
        gradient_of_lagrangian(problem, at + h * d, zero)
        - gradient_of_lagrangian(problem, at - h * d, zero)
    ) / (2 * h)
    np.testing.assert_allclose(product, difference, atol=1e-7 * np.abs(difference).max())


def _is_curved(term: costs.Cost) -> bool:
    """It sees torques or contacts."""
    kinds = (costs.Effort, costs.JointPower, costs.TorqueLimit, costs.CustomCost)
    return isinstance(term, (*kinds, costs.ContactCost))


def _com_velocity(problem: CompiledProblem, nodes: np.ndarray) -> np.ndarray:
    from octo.model.kinematics import center_of_mass

    robot = problem.problems[0].character
    assert robot is not None
    return np.diff(center_of_mass(robot, nodes[1:]), axis=0) / problem.problems[0].dt


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_derivatives_with_a_fixed_end(compiled, wiggle, remainder_slope, basis):
    """The pinned units are constants: no column of A, no gradient, an identity block of H."""
    free = compiled(basis)
    end = free.start[0] + 0.02
    problem = CompiledProblem(
        [p.replace(x_end=end, v_end=0.1 * np.ones(9)) for p in free.problems], like=free
    )
    at, d = wiggle(problem), direction(problem)
    evaluation = problem.evaluate(at)
    np.testing.assert_allclose(evaluation.nodes[:, -1], end[None].repeat(2, axis=0), atol=1e-15)
    model = problem.linearize(evaluation, None)
    blocks = KKTBlocks(model.H, model.A, model.b, model.C)
    assert (
        remainder_slope(
            lambda h: problem.evaluate(at + h * d).energy.sum(), (model.b * d).sum(), SIZES
        )
        > 1.9
    )
    assert (
        remainder_slope(
            lambda h: problem.evaluate(at + h * d).C, blocks.constraints_times(d), SIZES
        )
        > 1.9
    )
    pinned = np.zeros_like(d)
    pinned[:, problem.fixed] = np.random.default_rng(0).standard_normal(
        (problem.batch, len(problem.fixed), problem.nc)
    )
    np.testing.assert_array_equal(blocks.constraints_times(pinned), 0.0)
    np.testing.assert_array_equal(blocks.hessian_times(pinned), pinned)
    np.testing.assert_array_equal(model.b[:, problem.fixed], 0.0)
