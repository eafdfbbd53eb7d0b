"""What is added in one file works in every backend: CasADi's virtual machine, C, the CUDA text on a
CPU, and the problem behind IPOPT."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from extending.code_stage import OverGrid
from extending.contact_pair import EqualLoads
from extending.hertz_law import Hertz
from extending.pseudo_huber import PseudoHuber
from extending.torque_rate import PowerChange, TorqueChange
from walker import START, walker, wiggle_near_ground

import octo
from octo import native
from octo.gpu.problem import DeviceProblem
from octo.problem.compiled import CompiledProblem
from octo.reference.layout import octo_layout
from octo.reference.library import Library
from octo.reference.program import nlp, point_of
from tests import emulator
from tests.emulator import EmulatedDevice

pytestmark = [
    pytest.mark.skipif(
        native.compiler() is None or emulator.compiler() is None, reason="no C or C++ compiler"
    )
]
HERE = Path(__file__).parent
STEPS, DT = 12, 0.05
PAIR = EqualLoads(pair=("foot", "front"), weight=2.0, name="pair")
TERMS: dict[str, list[octo.Cost]] = {
    "a pair of contacts": [PAIR],
    "a loss over the state": [octo.JointVelocity(0.4, loss=PseudoHuber(0.2))],
    "a loss over torques": [octo.Effort(loss=PseudoHuber(0.05))],
    "a loss over contacts": [octo.Slip(length=0.03, loss=PseudoHuber(0.02))],
    "a loss over neighbours": [
        octo.NeighbourCost(lambda c, after, p: 3.0 * (after - c), loss=PseudoHuber(0.1))
    ],
    "Huber's loss": [octo.JointVelocity(0.4, loss=octo.Huber(0.3)), octo.Slip(loss=octo.Huber())],
    "a loss over a pair": [replace(PAIR, loss=PseudoHuber(0.1))],
    "two steps in a row": [octo.Effort(), TorqueChange(weight=2.0)],
    "a loss over two steps in a row": [
        PowerChange(loss=PseudoHuber(0.1)),
        octo.TorqueRate(at="last"),
    ],
    "a stage of code": [OverGrid(body="shank", weight=3.0, name="grid")],
    "a loss over a stage": [OverGrid(body="shank", loss=PseudoHuber(0.02))],
    "a contact law": [octo.Slip(length=0.03), octo.FrictionCone(mu=0.1)],
}


def problem(name: str, steps: int = STEPS) -> octo.Problem:
    law = Hertz() if name == "a contact law" else None
    costs = [octo.Posture(weight=0.1), *TERMS[name]]
    return octo.Problem(walker(), steps=steps, dt=DT, costs=costs, law=law, x0=START)


@pytest.fixture(params=sorted(TERMS))
def case(request: pytest.FixtureRequest) -> CompiledProblem:
    return CompiledProblem([problem(request.param)] * 2)


def close(found: np.ndarray, expected: np.ndarray, relative: float = 1e-10) -> None:
    scale = max(1e-12, np.abs(expected).max(initial=0.0))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=relative * scale)


def test_backends_agree(case: CompiledProblem) -> None:
    """E by terms, C, and the model with exact curvature and without."""
    unknowns, plain = wiggle_near_ground(case), case.interpreted()
    lam = np.random.default_rng(0).standard_normal((2, case.K, case.ma))
    device = DeviceProblem(case, EmulatedDevice(32, 1))
    at = case.evaluate(unknowns)
    others = {"interpreted": plain, "CUDA": device}
    for name, other in others.items():
        given = unknowns if other is plain else device.device.array(unknowns)
        found = other.evaluate(given)
        close(np.asarray(found.terms), at.terms)
        close(np.asarray(found.C), at.C)
        for multipliers in (None, lam):
            model, made = case.linearize(at, multipliers), other.linearize(found, multipliers)
            for field in ("H", "A", "b"):
                close(np.asarray(getattr(made, field)), getattr(model, field), 1e-9)
        assert name


def test_the_gradient_is_that_of_the_value(case: CompiledProblem) -> None:
    """The remainder of Taylor's series falls with the square of the step."""
    unknowns = wiggle_near_ground(case)
    d = np.random.default_rng(2).standard_normal(unknowns.shape)
    d[:, case.fixed] = 0.0
    start = case.evaluate(unknowns)
    slope = (case.linearize(start, None).b * d).sum()
    sizes = np.array([1e-3, 1e-4])
    left = [
        abs(case.evaluate(unknowns + h * d).energy.sum() - start.energy.sum() - h * slope)
        for h in sizes
    ]
    order = np.log(left[0] / left[1]) / np.log(sizes[0] / sizes[1])
    assert order > 1.85


@pytest.mark.parametrize("name", sorted(TERMS))
def test_the_problem_behind_ipopt(name: str) -> None:
    """Its expressions and its compiled form, against octo's own E and gradient."""
    described = problem(name)
    made = nlp(described)
    unknowns = wiggle_near_ground(made.compiled)
    x, p = point_of(made.compiled, unknowns), made.parameters
    own = made.compiled.evaluate(unknowns)
    close(np.asarray(made.objective(x, p)).ravel(), own.energy)
    gradient = point_of(made.compiled, made.compiled.linearize(own, None).b)
    close(np.asarray(made.gradient(x, p)).ravel(), gradient)
    library = Library(made.compiled, octo_layout(made.compiled))
    library.activate()
    _, found = library.function("nlp_grad_f")(x, p)
    close(np.asarray(found).ravel(), gradient)


def test_a_step_with_a_loss_costs_less_than_its_square() -> None:
    """Far from the reference the root is that of a line; near it the residual itself."""
    described = problem("Huber's loss")
    squares = described.replace(costs=[octo.JointVelocity(0.4)])
    lines = described.replace(costs=[octo.JointVelocity(0.4, loss=octo.Huber(0.3))])
    one, other = (CompiledProblem([p]) for p in (squares, lines))
    unknowns = wiggle_near_ground(one)
    at = one.evaluate(unknowns)
    speed = np.diff(at.nodes[0, 1:], axis=0)[:, 6:] / DT - 0.4
    rho = np.where(np.abs(speed) <= 0.3, speed**2, 0.6 * np.abs(speed) - 0.09)
    assert (np.abs(speed) > 0.3).any() and (np.abs(speed) < 0.3).any()
    close(other.evaluate(unknowns).energy, np.array([rho.sum() / STEPS]))
    close(at.energy, np.array([(speed**2).sum() / STEPS]))


@pytest.mark.parametrize(
    "file",
    ["contact_pair.py", "pseudo_huber.py", "hertz_law.py", "torque_rate.py", "code_stage.py"],
)
def test_each_is_one_short_file(file: str) -> None:
    assert len((HERE / file).read_text(encoding="utf-8").splitlines()) <= 80
