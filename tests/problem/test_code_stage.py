"""Stages of code against the same written in CasADi, and what is refused of them."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import pytest
from extending.code_stage import OverGrid
from walker import BASES, START, walker, wiggle_near_ground

import octo
from octo import native
from octo.errors import OctoError, ProblemError
from octo.gpu.problem import DeviceProblem
from octo.problem.compiled import CompiledProblem
from octo.problem.structure import check_alike
from octo.reference.program import nlp, point_of
from tests import emulator
from tests.emulator import EmulatedDevice

needs_compilers = pytest.mark.skipif(
    native.compiler() is None or emulator.compiler() is None, reason="no C or C++ compiler"
)
RANDOM = np.random.default_rng(5)
INPUTS, HIDDEN, OUTPUTS = 3, 8, 2
FIRST = RANDOM.standard_normal((HIDDEN, INPUTS + 1))  # weights, and what is added, last
LAST = RANDOM.standard_normal((OUTPUTS, HIDDEN)) / HIDDEN
TEXT = f"""
{octo.CodeStage.table("learned_first", FIRST)}{octo.CodeStage.table("learned_last", LAST)}
#define NX {INPUTS} /* octo has a macro of this name too */
static void learned(const double *a, double *value, double *slopes, double *second) {{
  for (int o = 0; o < {OUTPUTS}; ++o) value[o] = 0.0;
  for (int k = 0; slopes && k < {OUTPUTS} * NX; ++k) slopes[k] = 0.0;
  for (int k = 0; second && k < {OUTPUTS} * NX * NX; ++k) second[k] = 0.0;
  for (int h = 0; h < {HIDDEN}; ++h) {{
    const double *w = learned_first + h * (NX + 1);
    double sum = w[NX];
    for (int i = 0; i < NX; ++i) sum += w[i] * a[i];
    double y = tanh(sum), d = 1.0 - y * y;
    for (int o = 0; o < {OUTPUTS}; ++o) {{
      double out = learned_last[o * {HIDDEN} + h];
      value[o] += out * y;
      for (int i = 0; slopes && i < NX; ++i) slopes[o * NX + i] += out * d * w[i];
      for (int k = 0; second && k < NX * NX; ++k)
        second[o * NX * NX + k] -= 2.0 * out * y * d * w[k / NX] * w[k % NX];
    }}
  }}
}}
"""


def learned(a: np.ndarray) -> tuple[np.ndarray, ...]:
    w = FIRST[:, :-1]
    y = np.tanh(a @ w.T + FIRST[:, -1])
    d = 1.0 - y * y
    slopes = np.einsum("oh,...h,hi->...oi", LAST, d, w)
    return y @ LAST.T, slopes, np.einsum("oh,...h,hi,hj->...oij", LAST, -2.0 * y * d, w, w)


NETWORK = octo.CodeStage("learned", INPUTS, OUTPUTS, TEXT, learned, second=True)


def written(a: ca.SX) -> ca.SX:
    return LAST @ ca.tanh(FIRST[:, :-1] @ a + FIRST[:, -1])


def residual(step: Any, call: Callable[[ca.SX], ca.SX]) -> ca.SX:
    """Of the motion, of torques, and of what an earlier call gave."""
    height = step.pose("shank")[1][2]
    first = call(ca.vertcat(height, step.x[7] - step.x_prev[7], step.u[0]))
    second = call(ca.vertcat(step.x_next[6], step.u[1], step.x_next[8]))
    third = call(ca.vertcat(first[0] * step.x_next[1], second[1], height))
    return ca.vertcat(first, third * step.x_next[0])


def by_code(step: Any, p: Mapping[str, ca.SX]) -> ca.SX:
    return residual(step, lambda a: step.call(NETWORK, a))


def by_symbols(step: Any, p: Mapping[str, ca.SX]) -> ca.SX:
    return residual(step, written)


def problem(function: Any, basis: Any = "nodes", **options: Any) -> octo.Problem:
    costs = [octo.Posture(weight=0.1), octo.CustomCost(function, name="learned", **options)]
    return octo.Problem(walker(), steps=9, dt=0.05, basis=basis, costs=costs, x0=START)


def close(found: Any, expected: np.ndarray, relative: float = 1e-12) -> None:
    scale = np.abs(expected).max()
    np.testing.assert_allclose(np.asarray(found), expected, rtol=0.0, atol=relative * scale)


@pytest.mark.parametrize("basis", sorted(BASES))
@needs_compilers
def test_a_learned_map_is_the_same_as_its_expression(basis: str) -> None:
    """E, C and the model in C, without a compiler, and in CUDA's text."""
    code, symbols = (CompiledProblem([problem(f, BASES[basis])] * 2) for f in (by_code, by_symbols))
    assert code.functions.calls.waves == [2, 2, 3]
    unknowns = wiggle_near_ground(code)
    expected = symbols.evaluate(unknowns)
    lam = np.random.default_rng(0).standard_normal((2, code.K, code.ma))
    device = DeviceProblem(code, EmulatedDevice(32, 1))
    for backend in (code, code.interpreted(), device):
        found = backend.evaluate(device.device.array(unknowns) if backend is device else unknowns)
        close(found.terms, expected.terms)
        for multipliers in (None, lam):
            model = backend.linearize(found, multipliers)
            wanted = symbols.linearize(expected, multipliers)
            for name in ("H", "A", "b"):
                close(getattr(model, name), getattr(wanted, name))


LINEAR = (
    octo.CodeStage.table("linear_slopes", FIRST[:OUTPUTS, :INPUTS])
    + f"""
static void linear(const double *a, double *value, double *slopes) {{
  for (int o = 0; o < {OUTPUTS}; ++o) value[o] = 0.0;
  for (int k = 0; k < {OUTPUTS * INPUTS}; ++k) {{
    value[k / {INPUTS}] += linear_slopes[k] * a[k % {INPUTS}];
    if (slopes) slopes[k] = linear_slopes[k];
  }}
}}
"""
)


def linear(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    slopes = FIRST[:OUTPUTS, :INPUTS]
    return a @ slopes.T, np.broadcast_to(slopes, (*a.shape[:-1], *slopes.shape))


STRAIGHT = octo.CodeStage("linear", INPUTS, OUTPUTS, LINEAR, linear)
STAGES = {"its own": (NETWORK, written), "none": (STRAIGHT, lambda a: FIRST[:OUTPUTS, :INPUTS] @ a)}


@needs_compilers
@pytest.mark.parametrize("second", sorted(STAGES))
@pytest.mark.parametrize("basis", sorted(BASES))
def test_exact_second_derivatives_pass_through(basis: str, second: str) -> None:
    """With the stage's own; without them a stage counts as linear where it is called."""
    stage, expression = STAGES[second]
    code, symbols = (
        CompiledProblem(
            [problem(lambda step, p, f=f: residual(step, partial(f, step)), BASES[basis])],
            exact=True,
        )
        for f in (lambda step, a: step.call(stage, a), lambda step, a: expression(a))
    )
    unknowns = wiggle_near_ground(code)
    lam = np.random.default_rng(0).standard_normal((1, code.K, code.ma))
    expected = symbols.linearize(symbols.evaluate(unknowns), lam).H
    device = DeviceProblem(code, EmulatedDevice(32, 1))
    for backend in (code, code.interpreted(), device):
        at = backend.evaluate(device.device.array(unknowns) if backend is device else unknowns)
        close(backend.linearize(at, lam).H, expected)
    plain = CompiledProblem(code.problems)
    gauss_newton = plain.linearize(plain.evaluate(unknowns), lam).H
    assert np.abs(gauss_newton - expected).max() > 1e-6 * np.abs(expected).max()


def of(stage: octo.CodeStage, step: Any) -> Callable[[ca.SX], ca.SX]:
    return partial(step.call, stage)


OVER = OverGrid(body="shank", weight=3.0)
COSTS: dict[str, list[octo.Cost]] = {
    "a learned map": [octo.Posture(weight=0.1), octo.CustomCost(by_code, weight=0.3)],
    "a table, without second derivatives": [octo.Posture(weight=0.1), octo.Effort(), OVER],
}


@needs_compilers
@pytest.mark.parametrize("case", sorted(COSTS))
def test_the_reference_finds_the_same_motion(case: str) -> None:
    described = octo.Problem(walker(), steps=12, dt=0.05, costs=COSTS[case], x0=START)
    values = dict(described.values)
    described = described.replace(parameters={"contact.w_perp": values["contact.w_perp"]})
    for solver in (octo.reference.ipopt, octo.reference.fatrop):
        run = solver(described)
        own = octo.solve(described, start=run.solution.x[1:] + 1e-3, device="cpu")
        assert run.compiled and run.solution.converged and own.converged
        assert run.solution.energy == pytest.approx(own.energy, rel=1e-5)


def test_casadi_differentiates_the_stage_in_python() -> None:
    """The expressions behind IPOPT, with the stage's second derivatives and with differences."""
    differences = another(
        text=TEXT.replace(", double *second) {", ") {\n  double *second = 0;"),
        python=lambda a: learned(a)[:2],
        second=False,
    )
    found = []
    for call in (lambda step: written, *(partial(of, stage) for stage in (NETWORK, differences))):
        made = nlp(problem(lambda step, p, call=call: residual(step, call(step))))
        x = point_of(made.compiled, wiggle_near_ground(made.compiled))
        lam = np.random.default_rng(0).standard_normal(made.g.numel())
        hessian = made.hessian(x, made.parameters, 1.0, lam)
        found.append([made.objective(x, made.parameters), hessian])
    for (value, hessian), relative in zip(found[1:], (1e-12, 1e-7), strict=True):
        close(value, np.asarray(found[0][0]))
        close(hessian.full(), found[0][1].full(), relative)


def test_a_name_that_casadi_has_no_use_for() -> None:
    """C allows more names than CasADi does."""
    named = stage(text=SQUARE.format(RIGHT).replace("square", "_a__square_"), name="_a__square_")
    given = ca.MX.sym("a", 1)
    slopes = ca.Function("slopes", [given], [ca.jacobian(named.function(given), given)])
    assert float(slopes(3.0)) == pytest.approx(6.0, rel=1e-12)


# -- structure -------------------------------------------------------------------------------------


def another(**changes: Any) -> octo.CodeStage:
    given = {"text": TEXT, "python": learned, "inputs": INPUTS, "outputs": OUTPUTS, "second": True}
    return octo.CodeStage("learned", **{**given, **changes})


def test_a_batch_has_one_text() -> None:
    same, spaced = another(), another(text=f"{TEXT}\n/* another text */\n")
    calls = [
        lambda step, p, stage=stage: residual(step, lambda a: step.call(stage, a))
        for stage in (NETWORK, same, spaced)
    ]
    problems = [problem(f) for f in calls]
    check_alike(problems[:2])
    with pytest.raises(ProblemError, match=r"learned\.residual of problem 1|learned\.function"):
        check_alike([problems[0], problems[2]])


def test_two_stages_of_one_name_are_refused() -> None:
    other = another(text=f"{TEXT}\n")

    def both(step: Any, p: Any) -> ca.SX:
        return step.call(NETWORK, step.x[:3]) + step.call(other, step.x[:3])

    with pytest.raises(ProblemError, match="two stages are named 'learned'"):
        CompiledProblem([problem(both)])


def test_a_problem_with_a_stage_is_pickled() -> None:
    NETWORK.function(np.zeros(INPUTS))
    again = pickle.loads(pickle.dumps(NETWORK))
    assert again.structure == NETWORK.structure
    np.testing.assert_array_equal(again.evaluate(np.ones(3))[0], NETWORK.evaluate(np.ones(3))[0])


# -- what is refused -------------------------------------------------------------------------------

SQUARE = "static void square(const double *a, double *value, double *slopes) {{ {0} }}"
RIGHT = "value[0] = a[0] * a[0]; if (slopes) slopes[0] = 2.0 * a[0];"


def square(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return a * a, 2.0 * a[..., None]


def stage(body: str = RIGHT, python: Any = square, **changes: Any) -> octo.CodeStage:
    given = {"inputs": 1, "outputs": 1, "text": SQUARE.format(body), "python": python}
    return octo.CodeStage(**{"name": "square", **given, **changes})


WRONG: dict[str, tuple[Callable[[], Any], str]] = {
    "no identifier": (lambda: stage(name="2nd"), "CodeStage.name is '2nd', must be a C identifier"),
    "octo's own": (lambda: stage(name="octo_evaluate"), "does not begin with octo"),
    "a macro": (lambda: stage(name="NX"), "'NX', must be a C identifier with a small letter"),
    "a type": (lambda: stage(name="real"), "does not begin with octo, .* or real"),
    "no inputs": (lambda: stage(inputs=0), "square.inputs is 0, must be a whole number"),
    "no text": (lambda: stage(text=3), "square.text is 3, must be C text"),
    "no function": (lambda: stage(python=None), "square.python is not callable"),
    "too large": (lambda: stage(inputs=20_000), "at most 10000"),
    "no C": (lambda: stage("value[0] = ;"), r"square\.text does not compile.*square:1:\d+: error"),
    "unknown words": (lambda: stage("value[0] = squared(a[0]);"), "does not compile.*squared"),
    "another function": (lambda: stage(name="cube"), "cube.text does not compile"),
    "another value": (
        lambda: stage(RIGHT.replace("a[0] * a[0]", "a[0]")),
        r"square: value \(0,\) at a = .* in C and .* in Python, must be the same",
    ),
    "another slope": (
        lambda: stage(RIGHT.replace("2.0", "3.0")),
        r"slopes \(0, 0\) at a = .* in C",
    ),
    "no slope": (lambda: stage("value[0] = a[0] * a[0];"), "square.text's slopes is not finite"),
    "slopes of another function": (
        lambda: stage(python=lambda a: (a * a, a[..., None])),
        r"slopes \(0, 0\) at a = .*, differences give",
    ),
    "not finite": (
        lambda: stage(python=lambda a: (np.log(-np.abs(a)), a[..., None])),
        "square.python's value is not finite at index 0, 0",
    ),
    "a wrong shape": (
        lambda: stage(python=lambda a: (a, a)),
        r"square.python's slopes has shape \(8, 1\), expected \(8, 1, 1\)",
    ),
    "one array": (lambda: stage(python=lambda a: (a,)), "gives 1 arrays, must give value, slopes"),
    "Python that fails": (lambda: stage(python=lambda a: a[3, 9]), "square.python fails.*IndexErr"),
    "points": (lambda: stage(points=np.zeros(3)), r"square.points has shape \(3,\), expected"),
    "a table's name": (lambda: octo.CodeStage.table("a b", [1.0]), "table 'a b' needs a C ident"),
    "a table's numbers": (lambda: octo.CodeStage.table("t", [np.inf]), "table t is not finite"),
}


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("case", sorted(WRONG))
def test_what_is_wrong_is_named(case: str) -> None:
    make, message = WRONG[case]
    with pytest.raises(OctoError, match=message):
        make()


def test_wrong_calls_name_the_term() -> None:
    for function, message in (
        (lambda step, p: step.call(NETWORK, step.u[0]), r"CodeStage learned has shape \(1,\)"),
        (lambda step, p: step.call(learned, step.u), "a function is called, must be an octo.Code"),
    ):
        with pytest.raises(OctoError, match=message):
            CompiledProblem([problem(function)])


def test_a_term_over_contacts_is_told_what_to_write() -> None:
    class OfContacts(octo.ContactCost):
        def contact_residual(self, contact, p):
            return contact.call(NETWORK, contact.height)

    described = octo.Problem(walker(), steps=9, dt=0.05, x0=START, costs=[OfContacts()])
    with pytest.raises(OctoError, match="cannot call a stage of code: write an octo.Cost"):
        CompiledProblem([described])


def test_a_right_one_is_taken() -> None:
    assert stage().evaluate(np.array([3.0]))[0] == 9.0
    assert stage(points=np.array([[2.0]])).shapes == ((1,), (1, 1))
