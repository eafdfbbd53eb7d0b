"""Cycles: how they close, derivatives of E and C, native code, batches, what is asked of a stride,
what is refused."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from walker import START, walker

import octo
from octo import native
from octo.errors import OctoError
from octo.model.character import Body, floating_base
from octo.problem.compiled import CompiledProblem
from octo.problem.cycle import Cycle
from octo.problem.interpreted import Interpreted
from octo.problem.problem import Problem
from octo.solver.blocks import KKTBlocks
from octo.starts import first_nodes
from tests.dense import kkt_matrix

SIZES = np.geomspace(1e-3, 1e-5, 5)  # of a step along a direction of length 1
FIELDS = ("H", "A", "b", "C")
SLOPE = octo.Plane(slope=0.1, height=0.05)
HILL = octo.Plane(slope=0.1, direction=0.7, height=-0.1)
CYCLES = {  # the cycle, the steps, the ground
    "mirrored": (Cycle(speed=0.5, period=0.6), 12, None),
    "odd": (Cycle(shift=0.3, period=0.6), 13, None),
    "slope": (Cycle(speed=-0.4, period=0.6), 12, SLOPE),
    "turning": (Cycle(speed=0.3, sideways=0.1, turn=-0.4, period=0.6, mirror=False), 19, None),
    "sideways": (Cycle(sideways=0.2, period=0.6, mirror=False), 12, HILL),
}
every_cycle = pytest.mark.parametrize("name", CYCLES)


@lru_cache
def mammal() -> octo.Character:
    return octo.gallery.mammal()


def described(name: str, **changes) -> Problem:
    cycle, steps, ground = CYCLES[name]
    given = {"steps": steps, "costs": octo.costs.natural(), "cycle": cycle, "terrain": ground}
    return Problem(mammal(), **{**given, **changes})


@lru_cache
def compiled(name: str, threads: int = 1) -> CompiledProblem:
    """Two members: the second is faster and heavier, and starts with a heading where it may."""
    one = described(name)
    pose = mammal().default_pose.copy()
    pose[:2], pose[3] = (0.3, -0.2), 0.0 if one.cycle.mirrored else 0.5
    faster = dataclasses.replace(one.cycle, sideways=1.5 * one.cycle.sideways)
    if one.cycle.shift is None:
        faster = dataclasses.replace(faster, speed=1.5 * one.cycle.velocity)
    other = one.replace(cycle=faster, parameters={"gravity_z": -12.0}, pose=pose)
    like = None if (name, threads) == ("mirrored", 1) else compiled("mirrored")
    return CompiledProblem([one, other], threads, like=like)


def wiggle(problem: CompiledProblem) -> np.ndarray:
    """(batch, K, nc) unknowns of a motion with its feet in the ground."""
    nodes = np.stack([first_nodes(each, 3 + k, None) for k, each in enumerate(problem.problems)])
    return problem.unknowns(nodes + 0.01 * np.random.default_rng(0).standard_normal(nodes.shape))


def direction(problem: CompiledProblem) -> np.ndarray:
    """(batch, K, nc) of length 1, in the variables that a node is made of."""
    d = np.random.default_rng(1).standard_normal((problem.batch, problem.K, problem.nc))
    d = d.reshape(problem.batch, problem.K, problem.stencil.parts, problem.n)
    d[:, problem.basis.dummies(problem.steps)] = 0.0
    return (d / np.linalg.norm(d)).reshape(problem.batch, problem.K, problem.nc)


def multipliers(problem: CompiledProblem) -> np.ndarray:
    return np.random.default_rng(2).standard_normal((problem.batch, problem.K, problem.ma))


def blocks(problem: CompiledProblem, unknowns: np.ndarray, lam: np.ndarray | None) -> KKTBlocks:
    model = problem.linearize(problem.evaluate(unknowns), lam)
    return KKTBlocks(model.H, model.A, model.b, model.C)


def turned(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


# -- how a cycle closes ----------------------------------------------------------------------------


@every_cycle
def test_the_last_state_is_the_first_one_carried_on(name):
    problem = compiled(name)
    nodes = problem.evaluate(wiggle(problem)).nodes
    for each, own in zip(problem.problems, nodes, strict=True):
        closure = each.closure
        carried = own[:2] @ closure.forward.T + closure.forward_constant
        np.testing.assert_allclose(own[-2:], carried, atol=1e-12)
    first = np.stack([first_nodes(each, 0, None) for each in problem.problems])
    again = problem.evaluate(problem.unknowns(first)).nodes
    np.testing.assert_allclose(again, first, atol=1e-12)


def carried_on(problem: Problem) -> None:
    """FD (N, n) of any motion carried on is G FD: what follows from it is what followed before."""
    closure, random = problem.closure, np.random.default_rng(0)
    nodes = problem.start + 0.05 * random.standard_normal((8, problem.dynamics.nx))
    on = nodes @ closure.forward.T + closure.forward_constant
    fd, image = (problem.dynamics.evaluate(x[None], problem.p[None])[0][0] for x in (nodes, on))
    np.testing.assert_allclose(image, fd @ closure.forward.T, atol=1e-9 * np.abs(fd).max())


@every_cycle
def test_the_laws_of_motion_are_the_same_a_stride_later(name):
    for problem in compiled(name).problems:
        carried_on(problem)


def test_gravity_may_be_tilted_where_the_stride_allows_it():
    tilted = {"gravity_x": 2.0, "gravity_z": -9.6}
    carried_on(described("slope", parameters=tilted))
    carried_on(described("sideways", parameters={**tilted, "gravity_y": -1.0}))


def behind_a_rock() -> octo.Character:
    """The walker in the zxy chart; its base is not the first body."""
    robot = walker()
    rock = Body("rock", -1)
    first = dataclasses.replace(robot.bodies[0], joints=floating_base(chart="zxy"))
    moved = [dataclasses.replace(b, parent=b.parent + 1) for b in robot.bodies[1:]]
    contacts = tuple(dataclasses.replace(c, body=c.body + 1) for c in robot.contacts)
    bodies = (rock, first, *moved)
    return dataclasses.replace(
        robot, bodies=bodies, contacts=contacts, chart="zxy", default_pose=START
    )


def test_a_turn_in_the_other_chart_of_a_base_that_is_not_the_first_body():
    robot, cycle = behind_a_rock(), Cycle(speed=0.4, turn=0.7, period=0.6, mirror=False)
    assert robot.base_body == 1
    problem = Problem(robot, steps=12, costs=[octo.Effort()], cycle=cycle)
    carried_on(problem)
    assert problem.closure.held.nonzero()[0].tolist() == [0, 1, 3]


@pytest.mark.parametrize("heading", [0.0, 0.8])
def test_displacement_and_turn_of_a_stride(heading):
    """Over level ground a chord of the arc, 2r sin(turn/2) long, from half of the turn left of the
    heading."""
    pose = mammal().default_pose.copy()
    pose[3] = heading
    cycle = Cycle(speed=0.5, turn=0.6, period=0.8, mirror=False)
    problem = Problem(mammal(), costs=[octo.Effort()], cycle=cycle, pose=pose)
    end = problem.closure.forward @ problem.start + problem.closure.forward_constant
    chord = 2.0 * 0.5 * 0.8 / 0.6 * np.sin(0.3)
    expected = chord * np.array([np.cos(heading + 0.3), np.sin(heading + 0.3)])
    np.testing.assert_allclose((end - problem.start)[:2], expected, atol=1e-12)
    assert end[3] - problem.start[3] == pytest.approx(0.6)
    uphill = described("slope")
    end = uphill.closure.forward @ uphill.start + uphill.closure.forward_constant
    travel = (end - uphill.start)[[0, 2]]
    np.testing.assert_allclose(travel, [-0.12, -0.12 * np.tan(0.1)], atol=1e-12)


# -- derivatives -----------------------------------------------------------------------------------


@every_cycle
def test_slopes_of_the_terms_and_the_constraints(name, remainder_slope):
    problem = compiled(name)
    at, d = wiggle(problem), direction(problem)
    model = blocks(problem, at, None)
    energy = lambda h: problem.evaluate(at + h * d).energy.sum()  # noqa: E731
    assert remainder_slope(energy, (model.b * d).sum(), SIZES) > 1.9
    residual = lambda h: problem.evaluate(at + h * d).C  # noqa: E731
    assert remainder_slope(residual, model.constraints_times(d), SIZES) > 1.9


@every_cycle
def test_hessian_where_only_torques_are_curved(name):
    """Terms linear in x and u: H is the whole second derivative of E + lamᵀC."""
    exact = ("Effort", "JointAcceleration", "Anchor")
    full = compiled(name)
    off = lambda t: t if t.label in exact else dataclasses.replace(t, weight=0.0)  # noqa: E731
    members = [p.replace(costs=[off(t) for t in p.costs]) for p in full.problems]
    problem = CompiledProblem(members, like=full)
    at, d, lam, h = wiggle(problem), direction(problem), multipliers(problem), 1e-5
    product = blocks(problem, at, lam).hessian_times(d)

    def gradient(unknowns: np.ndarray) -> np.ndarray:
        model = blocks(problem, unknowns, None)
        found = model.b + model.constraints_transposed_times(lam)
        found[:, problem.fixed] = 0.0
        return found

    difference = (gradient(at + h * d) - gradient(at - h * d)) / (2 * h)
    np.testing.assert_allclose(product, difference, atol=1e-6 * np.abs(difference).max())


@every_cycle
def test_a_part_that_no_node_is_made_of_stays(name):
    """The dummy of the fold and the odd half of a pair: no gradient, no column of A, one on H's
    diagonal."""
    problem = compiled(name)
    model = blocks(problem, wiggle(problem), multipliers(problem))
    unused = np.repeat(problem.basis.dummies(problem.steps).ravel(), problem.n)
    assert unused.sum() == problem.n * (2 + problem.steps % 2)
    dense, size = kkt_matrix(model), len(unused)
    np.testing.assert_array_equal(model.b.reshape(2, -1)[:, unused], 0.0)
    np.testing.assert_array_equal(dense[:, size:, :size][:, :, unused], 0.0)
    expected = np.eye(size)[unused]
    np.testing.assert_array_equal(dense[:, :size, :size][:, unused], [expected, expected])


# -- native code, batches, threads -----------------------------------------------------------------


def close(found: np.ndarray, expected: np.ndarray) -> None:
    scale = max(1e-300, np.abs(expected).max(initial=0.0))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11 * scale)


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_native_equals_interpreted():
    """The terms, C and the blocks by NumPy from the same FD and its derivatives."""
    first = compiled("mirrored")
    machine = Interpreted(first.program, first.plan, first.data)
    for name in CYCLES:
        problem = compiled(name)
        plainly = machine.select(problem.data)  # the same of all: built once
        plainly.plan = problem.plan
        at = problem.evaluate(wiggle(problem))
        terms = np.empty_like(at.terms)
        plainly.fill_terms(at.nodes, at.fd, terms, np.empty_like(at.rows))
        close(at.terms, terms)
        close(at.C, problem.reduce(at.fd))
        for lam in (None, multipliers(problem)):
            model = problem.linearize(at, lam)
            plain = [np.zeros_like(getattr(model, field)) for field in FIELDS]
            plainly.linearize(at, lam, None, tuple(plain))
            unused = np.repeat(problem.basis.dummies(problem.steps), problem.n, axis=1)
            for k, own in enumerate(unused):  # which the interpreter leaves to its caller
                plain[0][:, k, 0, own, own] = 1.0
            for field, expected in zip(FIELDS, plain, strict=True):
                close(getattr(model, field), expected)


@every_cycle
def test_members_and_threads_do_not_disturb_each_other(name):
    one, three = compiled(name), compiled(name, 3)
    unknowns, lam = wiggle(one), multipliers(one)
    at = one.evaluate(unknowns)
    model = one.linearize(at, lam)
    with_threads = three.evaluate(unknowns)
    same = three.linearize(with_threads, lam)
    np.testing.assert_array_equal(with_threads.energy, at.energy)
    for k in (0, 1):
        alone = one.take(np.array([k]))
        own_at = alone.evaluate(unknowns[k : k + 1])
        own = alone.linearize(own_at, lam[k : k + 1])
        np.testing.assert_array_equal(own_at.nodes[0], at.nodes[k])
        np.testing.assert_array_equal(own_at.energy[0], at.energy[k])
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(own, field)[0], getattr(model, field)[k])
            np.testing.assert_array_equal(getattr(same, field)[k], getattr(model, field)[k])


# -- solved ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["mirrored", "turning", "sideways"])
def test_a_solved_cycle_does_what_was_asked(name):
    """The anchor costs nothing, the first pose is where the search began, and the robot looks where
    it should."""
    problem = described(name, terrain=None)
    found = octo.solve(problem, passes=1, device="cpu", max_iterations=500)
    assert found.converged
    assert found.terms["Anchor"] < 1e-6 * found.energy
    closure, cycle = problem.closure, problem.cycle
    travel = found.x[-1] - found.x[1]
    if name == "mirrored":
        assert travel[0] == pytest.approx(0.5 * cycle.speed * cycle.period, abs=1e-9)
        return
    asked = closure.forward @ problem.start + closure.forward_constant
    np.testing.assert_allclose(found.x[-1, [0, 1, 3]], asked[[0, 1, 3]], atol=1e-5)
    np.testing.assert_allclose(found.x[1, [0, 1, 3]], problem.start[[0, 1, 3]], atol=2e-5)
    assert travel[3] == pytest.approx(cycle.turn, abs=1e-9)
    assert found.x[2:, 3].mean() == pytest.approx(problem.start[3] + 0.5 * cycle.turn, abs=0.05)


# -- what may change, what is refused --------------------------------------------------------------


def test_the_anchor_follows_what_is_replaced():
    problem = described("turning")
    end = lambda p: p.closure.forward @ p.start + p.closure.forward_constant  # noqa: E731
    for changes in (
        {"cycle": Cycle(speed=0.6, mirror=False)},
        {"cycle": Cycle(speed=0.6, period=0.5)},
        {"pose": problem.start + np.eye(18)[0]},
        {"parameters": {"contact.w_perp": 1e5}},
        {"cycle": Cycle(speed=0.6, mirror=False), "costs": [*problem.costs, octo.BaseHeight()]},
    ):
        changed = problem.replace(**changes)
        (anchor,) = [term for term in changed.costs if term.label == "Anchor"]
        np.testing.assert_array_equal(anchor.target, end(changed))
        np.testing.assert_array_equal(anchor.coordinates, changed.closure.held)
        places = [term.label for term in changed.costs].index("Anchor")
        assert places == len(problem.costs) - 1
    own = octo.PoseTarget(target=problem.start, name="Anchor", weight=0.0)
    kept = problem.replace(costs=[octo.Effort(), own]).replace(cycle=Cycle())
    assert kept.costs[-1] is own
    straight = problem.replace(cycle=None)
    assert "Anchor" not in [term.label for term in straight.costs] and straight.closure is None


def test_steps_and_dt_follow_from_the_period():
    assert described("mirrored", steps=0).steps == 12
    problem = described("mirrored", steps=0, dt=0.02)
    assert (problem.steps, problem.dt) == (15, 0.02)
    longer = problem.replace(cycle=Cycle(speed=0.5, period=0.9))
    assert (longer.steps, longer.dt) == (15, pytest.approx(0.03))
    finer = problem.replace(steps=30)
    assert (finer.steps, finer.dt) == (30, pytest.approx(0.01))
    assert problem.replace(dt=0.05).steps == 6
    spread = Cycle(period=(0.4, 0.9))
    assert spread.duration == pytest.approx(0.3)


def rough() -> octo.Terrain:
    return octo.Terrain(lambda point, p: point[2] - 0.1 * ca.sin(point[0]))


REFUSED = [
    (lambda: Cycle(turn=0.1), "turning stride cannot be mirrored"),
    (lambda: Cycle(sideways=0.1), "a stride sideways cannot be mirrored"),
    (lambda: Cycle(speed=1.0, shift=1.0), "speed 1 m/s and shift 1 m: one follows from the other"),
    (lambda: Cycle(period=(0.8, 0.4)), "the shortest must be less than the longest"),
    (lambda: Cycle(period=(0.8,)), r"must be a number of seconds or \(shortest, longest\)"),
    (lambda: Cycle(period=-1.0), "cycle.period is -1"),
    (lambda: Cycle(mirror="left"), "cycle.mirror is 'left', must be True"),
    (lambda: described("mirrored", steps=3), "steps is 3: a cycle needs at least 4 steps"),
    (lambda: described("mirrored", dt=0.07, steps=0), "must be a whole number of steps"),
    (lambda: described("mirrored", dt=0.02), "must be the 12 steps"),
    (lambda: described("mirrored", basis="hermite"), "basis is 'hermite', must be 'nodes'"),
    (lambda: described("mirrored", x0=mammal().default_pose), "x0 is given with cycle"),
    (lambda: described("mirrored", cycle=Cycle(period=(0.4, 0.9)), dt=0.02), "a range: give steps"),
    (lambda: described("mirrored", terrain=rough()), "terrain must be an octo.Plane"),
    (lambda: described("mirrored", terrain=HILL), "rises along the stride only"),
    (lambda: described("turning", terrain=SLOPE), "a turning cycle needs level ground"),
    (lambda: described("turning", parameters={"gravity_x": 1.0}), "a turning cycle needs level"),
    (lambda: described("mirrored", pose=np.eye(18)[3] + mammal().default_pose), "heading of 1 rad"),
    (
        lambda: described("mirrored", cycle=Cycle(mirror=octo.mirror_of(octo.gallery.biped()))),
        "cycle.mirror is of a robot with",
    ),
    (
        lambda: Problem(walker(), costs=[octo.Effort()], pose=START, cycle=Cycle()),
        "robot 'walker' has no left-right mirror",
    ),
]


@pytest.mark.parametrize("make,sentence", REFUSED, ids=[sentence for _, sentence in REFUSED])
def test_refused(make, sentence):
    with pytest.raises(OctoError, match=sentence) as error:
        make()
    assert "\n" not in str(error.value)
