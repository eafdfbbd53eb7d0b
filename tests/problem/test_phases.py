"""Problems in sequence as one: the blocks of an undivided problem, derivatives across the joint,
what a later phase knows of the first, and what is refused."""

from __future__ import annotations

import pickle
import re
from typing import Any

import numpy as np
import pytest
from walker import START, walker

import octo
from octo import native
from octo.dynamics.laws import Coulomb, Smooth
from octo.errors import OctoError
from octo.problem.compiled import CompiledProblem
from octo.problem.phased import PhasedProblem
from octo.problem.phases import Phases
from octo.problem.problem import Problem
from octo.solver.blocks import KKTBlocks

ROBOT = walker()
DT = 0.04
SIZES = np.geomspace(1e-3, 1e-5, 5)  # of a step along a direction of length 1
ARRAYS = ("nodes", "fd", "C")


def described(steps: int = 4, **more: Any) -> Problem:
    """Of terms that are means over all steps, and rows with bounds."""
    given: dict[str, Any] = {
        "dt": DT,
        "costs": [octo.CenterOfMassVelocity((0.3, 0.0, 0.1)), octo.Effort(), octo.ForceRate()],
        "constraints": [octo.TorqueLimits(), octo.StepLimit(0.4)],
        "parameters": {"contact.onset": 0.004},
    }
    return Problem(ROBOT, steps=steps, **{**given, **more})


def divided(*counts: int, **more: Any) -> Phases:
    first, *others = counts
    return octo.phases([described(first, x0=START, **more), *(described(n) for n in others)])


def differing(ends: bool = False) -> Phases:
    """Three phases that differ in everything that may: dt, steps, terms, rows, law, parameters."""
    ice = Smooth(w_perp=2e4, friction=Coulomb(mu=0.2))
    end = {"x_end": START + 0.05, "v_end": 0.1 * np.ones(9)} if ends else {}
    return octo.phases(
        [
            described(5, x0=START, v0=0.2 * np.ones(9), constraints=[octo.TorqueLimits()]),
            described(
                1,
                dt=0.025,
                costs=[octo.Effort(), octo.Posture(reference=START)],
                constraints=[],
                law=ice,
            ),
            described(4, dt=0.07, parameters={"gravity_z": -5.0}, **end),
        ]
    )


def around(problem: PhasedProblem, seed: int = 0) -> np.ndarray:
    """(batch, K, nc) unknowns of a motion close to the ground that begins at the start."""
    random = np.random.default_rng(seed)
    times = np.linspace(0.0, 1.0, problem.steps + 2)[:, None]
    waves = sum(
        np.sin((k + 1) * times) * random.uniform(-0.06, 0.06, (problem.batch, 1, problem.n))
        for k in range(4)
    )
    return problem.unknowns(START + waves)


def direction(problem: PhasedProblem) -> np.ndarray:
    """Of length 1; zero where nothing moves."""
    shape = (problem.batch, problem.steps + 2, problem.n)
    d = problem.unknowns(np.random.default_rng(1).standard_normal(shape))
    return d / np.linalg.norm(d)


def weighted(problem: Any, shape: tuple[int, ...]) -> list[np.ndarray]:
    """Weights, shifts and multipliers of the bounded rows, set."""
    random = np.random.default_rng(2)
    rows = [random.uniform(0.1, 2.0, shape) for _ in range(3)]
    problem.set_row_weights(*rows)
    return rows


# -- against the undivided problem -----------------------------------------------------------------


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("threads", [1, 2])
def test_blocks_are_those_of_the_undivided_problem(monkeypatch, compiled, threads):
    if not compiled:
        monkeypatch.setattr(native, "load", lambda text: None)
    ends = {"x_end": START + 0.05}
    whole = CompiledProblem([described(20, x0=START, **ends)], threads)
    parts = [described(9, x0=START), described(2), described(9, **ends)]
    joined = PhasedProblem([octo.phases(parts)], threads)
    assert (joined.K, joined.nc, joined.ma) == (whole.K, whole.nc, whole.ma)
    nodes = START + 0.02 * np.random.default_rng(0).standard_normal((1, 22, 9))
    unknowns = whole.unknowns(nodes)
    np.testing.assert_array_equal(joined.unknowns(nodes), unknowns)
    one, two = whole.evaluate(unknowns), joined.evaluate(unknowns)
    for name in (*ARRAYS, "rows"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    np.testing.assert_allclose(two.energy, one.energy, rtol=1e-13)
    lam = np.random.default_rng(3).standard_normal(one.C.shape)
    rows = weighted(whole, one.rows.shape)
    weighted(joined, one.rows.shape)
    models = whole.linearize(one, lam), joined.linearize(two, lam)
    for name in ("H", "A", "b", "C"):
        first, second = (getattr(model, name) for model in models)
        np.testing.assert_allclose(second, first, rtol=1e-10, atol=1e-10 * np.abs(first).max())
    step = np.random.default_rng(4).standard_normal(unknowns.shape)
    products = whole.row_products(models[0], step), joined.row_products(models[1], step)
    np.testing.assert_allclose(products[1], products[0], rtol=1e-10, atol=1e-10)
    forces = whole.row_forces(models[0], rows[1]), joined.row_forces(models[1], rows[1])
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-10, atol=1e-9)
    for first, second in zip(whole.gradient(one), joined.gradient(two), strict=True):
        np.testing.assert_allclose(second, first, rtol=1e-10, atol=1e-10 * np.abs(first).max())
    for first, second in zip(whole.row_bounds, joined.row_bounds, strict=True):
        np.testing.assert_array_equal(first, second)


# -- derivatives across the joint ------------------------------------------------------------------


@pytest.mark.parametrize("ends", [False, True])
def test_slopes_of_energy_constraints_and_rows(remainder_slope, ends):
    problem = PhasedProblem([differing(ends)])
    unknowns, d = around(problem), direction(problem)
    at = problem.evaluate(unknowns)
    slope, rows = problem.gradient(at)
    weighted(problem, at.rows.shape)  # slopes of rows without weight are not made
    model = problem.linearize(at, None)

    def after(h: float) -> Any:
        return problem.evaluate(unknowns + h * d)

    assert remainder_slope(lambda h: after(h).energy, (slope * d).sum(), SIZES) > 1.9
    change = KKTBlocks(model.H, rows, slope, model.C).constraints_times(d)
    assert remainder_slope(lambda h: after(h).C, change, SIZES) > 1.9
    products = problem.row_products(model, d)
    assert remainder_slope(lambda h: after(h).rows, products, SIZES) > 1.9
    weights = np.random.default_rng(5).standard_normal(products.shape)
    forces = problem.row_forces(model, weights)
    assert (forces * d).sum() == pytest.approx((weights * products).sum(), rel=1e-10)


def test_second_derivatives_of_the_lagrangian():
    """Of terms that are linear in x and u, so that Gauss and Newton's model is the whole of it."""
    costs = [octo.Effort(), octo.Posture(reference=START), octo.JointAcceleration()]
    own = {"costs": costs, "constraints": []}
    phases = octo.phases(
        [described(3, x0=START, **own), described(2, dt=0.03, **own), described(3, dt=0.06, **own)]
    )
    problem = PhasedProblem([phases])
    unknowns, d = around(problem), direction(problem)
    lam = np.random.default_rng(6).standard_normal((1, problem.K, problem.ma))

    def slope(h: float) -> np.ndarray:
        at = problem.evaluate(unknowns + h * d)
        b, A = problem.gradient(at)
        return b + KKTBlocks(A, A, b, at.C).constraints_transposed_times(lam)

    model = problem.linearize(problem.evaluate(unknowns), lam)
    product = KKTBlocks(model.H, model.A, model.b, model.C).hessian_times(d)
    h = 1e-5
    change = (slope(h) - slope(-h)) / (2.0 * h)
    assert np.linalg.norm(change - product) < 1e-6 * np.linalg.norm(product)


def test_members_are_themselves_in_a_batch():
    """Also where each has its own dt."""
    one = differing()
    other = octo.phases(
        [p.replace(dt=1.3 * p.dt, basis="nodes") if k else p for k, p in enumerate(one.problems)]
    )
    both, alone = PhasedProblem([one, other]), PhasedProblem([other])
    unknowns = around(both)
    at, own = both.evaluate(unknowns), alone.evaluate(unknowns[1:])
    np.testing.assert_array_equal(at.energy[1:], own.energy)
    lam = np.random.default_rng(3).standard_normal(at.C.shape)
    model, image = both.linearize(at, lam), alone.linearize(own, lam[1:])
    taken = both.take(np.array([1]))
    again = taken.linearize(taken.evaluate(unknowns[1:]), lam[1:])
    for name in ("H", "A", "b", "C"):
        np.testing.assert_array_equal(getattr(model, name)[1:], getattr(image, name))
        np.testing.assert_array_equal(getattr(again, name), getattr(image, name))


# -- what is joined --------------------------------------------------------------------------------


def test_a_phase_begins_in_the_state_that_the_one_before_ends_in():
    problem = PhasedProblem([differing()])
    at = problem.evaluate(around(problem))
    before, middle, last = problem.evaluations(at)
    for one, dt, other, own in ((before, DT, middle, 0.025), (middle, 0.025, last, 0.07)):
        np.testing.assert_array_equal(other.nodes[:, 1], one.nodes[:, -1])
        ended = (one.nodes[:, -1] - one.nodes[:, -2]) / dt
        np.testing.assert_allclose(
            (other.nodes[:, 1] - other.nodes[:, 0]) / own, ended, rtol=1e-9, atol=1e-12
        )


def test_energy_is_the_mean_over_time():
    phases = differing()
    problem = PhasedProblem([phases])
    at = problem.evaluate(around(problem))
    durations = np.array([p.steps * p.dt for p in phases.problems])
    parts = [
        CompiledProblem([one]).evaluate_nodes(own.unknowns, own.nodes).energy
        for one, own in zip(phases.problems, problem.evaluations(at), strict=True)
    ]
    wanted = sum(durations[k] * energy for k, energy in enumerate(parts)) / durations.sum()
    np.testing.assert_allclose(at.energy, wanted, rtol=1e-12)
    np.testing.assert_allclose(problem.term_values(at).sum(axis=1), at.energy, rtol=1e-12)


def test_later_phases_look_at_the_first_ones_start():
    phases = octo.phases([described(3), described(3, dt=0.02, law=Smooth())])
    first, second = phases.problems
    np.testing.assert_array_equal(second.start, first.start)
    assert second.length == first.length
    stiff = phases.with_parameters([{"contact.w_perp": 1e5}, {}])
    np.testing.assert_array_equal(stiff.problems[1].start, stiff.problems[0].start)
    assert np.abs(stiff.problems[0].start - first.start).max() > 1e-4


def test_later_phases_of_a_list_need_no_time_to_get_going():
    robot = octo.gallery.mammal()
    walk = octo.Problem(robot, steps=40, dt=0.025, costs=octo.costs.robot(0.4))
    phases = octo.phases([walk, walk.replace(steps=20)])
    velocities = [np.asarray(one.costs[0].velocity) for one in phases.problems]
    assert velocities[0].shape == (40, 3) and velocities[0][0, 0] < 0.1
    np.testing.assert_array_equal(velocities[1], [0.4, 0.0, 0.0])
    again = octo.phases([walk, pickle.loads(pickle.dumps(walk))])  # as from another process
    np.testing.assert_array_equal(np.asarray(again.problems[1].costs[0].velocity), velocities[1])


def test_phases_in_words():
    said = repr(differing())
    assert said.startswith("3 phases of walker: 10 steps in 0.505 s\n")
    assert "  2 terms in phase 1, 1 steps of 0.025 s: Effort, Posture" in said


def test_one_phase_with_other_fields():
    before = differing()
    first = before.problems[0]
    again = before.replace(1, steps=3, costs=[octo.Effort(), octo.Posture()])
    middle = described(3, dt=0.025, costs=again.problems[1].costs, constraints=[])
    last = described(4, dt=0.07, parameters={"gravity_z": -5.0})
    made = octo.phases([first, middle, last])
    assert repr(again) == repr(made) and again.steps == before.steps + 2
    np.testing.assert_array_equal(again.shares, made.shares)
    assert again.problems[1].law is before.problems[1].law
    raised = before.replace(-1, x_end=before.start + 0.1)
    np.testing.assert_array_equal(raised.problems[-1].end, before.start + 0.1)
    moved = START + 0.01
    assert all((one.start == moved).all() for one in before.replace(0, x0=moved).problems)


# -- what is refused -------------------------------------------------------------------------------

OTHER = octo.CustomDynamics(lambda a, b, c, p: a - 2 * b + c, 2, [0], {})
CYCLE = octo.Cycle(speed=0.3, period=0.8, mirror=False)
REFUSED = {
    "phases is a Problem, must be a list": lambda: octo.phases(described()),
    "the list of phases is empty": lambda: octo.phases([]),
    "phase 1 is 3, must be an octo.Problem": lambda: octo.phases([described(), 3]),
    "x0 is given for phase 1: it begins where phase 0 ends": lambda: octo.phases(
        [described(), described(x0=START)]
    ),
    "v0 is given for phase 1": lambda: octo.phases([described(), described(v0=np.zeros(9))]),
    "pose is given for phase 1": lambda: octo.phases([described(), described(pose=START)]),
    "x_end is given for phase 0: it ends where phase 1 begins": lambda: octo.phases(
        [described(x_end=START), described()]
    ),
    "displacement is given for phase 0": lambda: octo.phases(
        [described(displacement=np.zeros(9)), described()]
    ),
    "phase 0 is a cycle": lambda: octo.phases(
        [octo.Problem(octo.gallery.mammal(), costs=[octo.Effort()], cycle=CYCLE), described()]
    ),
    "the basis of phase 1 is 'hermite', must be 'nodes'": lambda: octo.phases(
        [described(), described(4, basis=octo.Hermite(2))]
    ),
    "TorqueRate looks at two steps in a row, which phase 1 cannot have": lambda: octo.phases(
        [described(), described(costs=[octo.TorqueRate()])]
    ),
    "phase 0 has 1 step, must have at least 2": lambda: octo.phases([described(1), described()]),
    "phase 1 is of mammal, must be of the robot of phase 0, walker": lambda: octo.phases(
        [described(), octo.Problem(octo.gallery.mammal(), steps=4, dt=DT, costs=[octo.Effort()])]
    ),
    "phase 1 is of 2 coordinates of the user's dynamics, must be of the robot": lambda: octo.phases(
        [described(), octo.Problem(OTHER, steps=4, dt=DT, costs=[octo.Effort()])]
    ),
    "options.step is 'trust_region', must be 'line_search'": lambda: octo.solve(
        differing(), options=octo.SqpOptions.paper()
    ),
    "problems and phases cannot be solved as one batch": lambda: octo.solve(
        [differing(), described()]
    ),
    "phase is 3, must be at most 2": lambda: differing().replace(3, steps=4),
    "field of a Problem 'step' is not known": lambda: differing().replace(0, step=4),
    "phase 1: it begins where phase 0 ends, leave it out": lambda: differing().replace(1, x0=START),
    "one of a batch has 2 phases and another 3": lambda: octo.solve([differing(), divided(4, 4)]),
    "steps differ between problems of one batch": lambda: octo.solve(
        [divided(4, 4), divided(4, 5)]
    ),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_cannot_be_is_refused_by_name(sentence):
    with pytest.raises(OctoError, match=re.escape(sentence)) as refused:
        REFUSED[sentence]()
    assert "\n" not in str(refused.value)
