"""A network's term on a device: the same numbers as on the CPU, and the same solve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import strict

import octo
from octo import arrays, learn
from octo.errors import DeviceError
from octo.gpu.backend import DeviceBackend
from octo.gpu.problem import DeviceProblem
from octo.problem.compiled import CompiledProblem
from octo.solver import sqp
from octo.solver.options import SqpOptions
from octo.starts import first_nodes
from tests.emulator import EmulatedDevice

SAME = 1e-12


def _told(problem: octo.Problem, seed: int, **fields: object) -> learn.Transition:
    """With weights of order one."""
    begun = learn.Transition(**{"hidden": (7, 5), **fields}).started(problem)
    random = np.random.default_rng(seed)
    return begun.with_weights(0.4 * random.standard_normal(begun.network.count))


@pytest.mark.parametrize("state", ["body", "world"])
@pytest.mark.parametrize("activation", ["softplus", "tanh"])
def test_a_networks_residual_and_slopes_are_those_of_the_cpu(state, activation):
    robot = octo.load("mammal")
    problem = octo.Problem(robot, steps=6, dt=0.025, costs=[octo.Effort()])
    of = _told(problem, 0, state=state, activation=activation)
    c = np.random.default_rng(1).standard_normal((2, 3, 2 * robot.nx))
    here = (of.residual(c, 0.9 * c), *of.residual_slopes(c, 0.9 * c), of.next(c))
    d = strict.asarray(c)
    there = (of.residual(d, 0.9 * d), *of.residual_slopes(d, 0.9 * d), of.next(d))
    for one, other in zip(here, there, strict=True):
        assert isinstance(other, strict.ndarray)
        np.testing.assert_allclose(other.get(), one, rtol=SAME, atol=SAME)


def _batch(basis: str, fixed: bool, given: type[learn.Markovian] = learn.Markovian):
    """Two members of their own networks, and their starts."""
    plain = octo.Problem(
        octo.gallery.chain(3), steps=20, dt=0.025, costs=octo.costs.paper(), basis=basis
    )
    if fixed:
        plain = plain.replace(x_end=plain.start, v_end=0.0 * plain.start)
    problems = [
        plain.replace(costs=[*plain.costs, given(transition=_told(plain, seed), weight=0.3)])
        for seed in (0, 1)
    ]
    nodes = np.stack([first_nodes(problem, k, None) for k, problem in enumerate(problems)])
    return CompiledProblem(problems), nodes


@pytest.mark.parametrize(
    ("basis", "fixed"), [("nodes", False), ("nodes", True), ("hermite", False), ("hermite", True)]
)
def test_e_and_its_blocks_are_those_of_the_cpu(basis, fixed):
    problem, nodes = _batch(basis, fixed)
    other = DeviceProblem(problem, EmulatedDevice(xp=strict))
    at, there = problem.evaluate(problem.unknowns(nodes)), other.evaluate(other.unknowns(nodes))
    assert problem.term_values(at)[:, -1].min() > 1e-6
    np.testing.assert_allclose(arrays.host(there.terms).sum(axis=1), at.terms.sum(axis=1), SAME)
    one, two = problem.linearize(at, None), other.linearize(there, None)
    for name in ("H", "b"):
        own, its = getattr(one, name), arrays.host(getattr(two, name))
        np.testing.assert_allclose(its, own, rtol=SAME, atol=SAME * np.abs(own).max())
    last = np.array([1])
    part = other.take(last)
    own = part.evaluate(part.xp.ascontiguousarray(there.unknowns[strict.asarray(last)]))
    np.testing.assert_allclose(arrays.host(own.terms), at.terms[1:], rtol=SAME, atol=SAME)


@pytest.mark.slow
@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_a_solve_goes_the_same_way(basis):
    problem, nodes = _batch(basis, False)
    device = EmulatedDevice(xp=strict)
    # with the curvature of these random networks' constraints the first steps are 40 and 3,600 long
    how = {"linear_solver": "cyclic_reduction", "hessian": "gauss_newton"}
    options = SqpOptions(max_iterations=5, **how)
    expected = sqp.run(problem, problem.unknowns(nodes), None, options)
    other, backend = DeviceProblem(problem, device), DeviceBackend(device)
    found = sqp.run(other, other.unknowns(nodes), None, options, None, backend)
    for one, its in zip(expected.history, found.history, strict=True):
        np.testing.assert_allclose(its["energy"], one["energy"], rtol=1e-6)


@dataclass(frozen=True, eq=False)
class OfNumPy(learn.Markovian):
    anywhere = False


def test_a_term_that_takes_numpy_alone_is_refused_by_name():
    problem, _ = _batch("nodes", False, OfNumPy)
    with pytest.raises(DeviceError, match="OfNumPy is written in NumPy's arrays") as refused:
        DeviceBackend(EmulatedDevice(xp=strict)).place(problem)
    assert "\n" not in str(refused.value)
