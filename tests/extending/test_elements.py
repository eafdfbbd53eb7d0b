"""Elements: what a file of its own adds to the dynamics, in every form that octo evaluates."""

from __future__ import annotations

import dataclasses
import json
import math

import casadi as ca
import numpy as np
import pytest
from rubber_band import RubberBand
from walker import START, walker, wiggle_near_ground

import octo
from octo import native
from octo.dynamics.evaluate import RobotDynamics
from octo.errors import MirrorError, ModelError, ProblemError, UnknownNameError, ValueRangeError
from octo.gpu.problem import DeviceProblem
from octo.model import store
from octo.model.character import Body, Character, floating_base
from octo.problem.compiled import CompiledProblem
from octo.problem.interpreted import Interpreted
from tests import emulator
from tests.emulator import EmulatedDevice

TOLERANCE = 1e-10  # of the largest entry
MASS, STIFFNESS = 2.0, 200.0  # kg, N/m, of a block that hangs on a spring
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")

# ends on two branches, on one branch, on the world; one kind of force twice; points off the bodies'
ELEMENTS = (
    RubberBand("shank", (0.0, 0.05, -0.1), "mast", (0.02, 0.0, 0.1), stiffness=3e3),
    octo.SpringDamper("base", (0.1, 0.0, 0.0), "shank", (0.0, 0.0, -0.2), 300.0, 6.0, 0.3),
    octo.SpringDamper(None, (0.3, 0.1, 0.8), "mast", (0.0, 0.0, 0.1), 120.0, 4.0, 0.1),
    RubberBand("thigh", (0.0, 0.0, -0.2), None, (-0.3, 0.2, 0.1)),
)


def robot(elements=ELEMENTS):
    return dataclasses.replace(walker(), elements=elements)


def nodes_of(steps, seed=0, dt=0.02):
    rng = np.random.default_rng(seed)
    return START + 0.3 * rng.standard_normal(9) + dt * rng.standard_normal((1, steps + 2, 9))


def interpreted(character):
    """The same on a machine without a compiler."""
    dynamics = RobotDynamics(character)
    dynamics._library = None
    return dynamics


@needs_compiler
@pytest.mark.parametrize("steps", [1, 13])
def test_compiled_is_interpreted(steps):
    nodes, rng = nodes_of(steps), np.random.default_rng(1)
    lam = rng.standard_normal((1, steps, 9))
    one, other = RobotDynamics(robot()), interpreted(robot())
    p = one.layout.pack(**{"spring2.stiffness": 90.0, "band3.length": 0.05})[None]
    for order in (0, 1, 2):
        found, expected = (d.evaluate(nodes, p, lam, order=order) for d in (one, other))
        for a, b in zip(found[: order + 1], expected, strict=False):
            np.testing.assert_allclose(a, b, rtol=0.0, atol=TOLERANCE * np.abs(b).max())
    without = RobotDynamics(walker())
    bare = without.evaluate(nodes, without.layout.pack()[None], lam, order=2)
    for a, b in zip(found, bare, strict=True):
        assert np.abs(a - b).max() > 1.0  # the elements are felt


def compiled(basis="nodes"):
    problem = octo.Problem(
        robot(), steps=6, dt=0.05, costs=[octo.costs.Effort()], basis=basis, x0=START
    )
    return CompiledProblem([problem, problem.replace(parameters={"spring1.stiffness": 500.0})])


@needs_compiler
@pytest.mark.parametrize("threads", [1, 5, 160])
def test_the_cuda_text_is_the_others(threads):
    """Run on the CPU: FD, and with multipliers H and A, that is Jacobian and curvature."""
    if emulator.compiler() is None:
        pytest.skip("no C++ compiler")
    problem, device = compiled(), EmulatedDevice(threads)
    unknowns = wiggle_near_ground(problem)
    lam = np.random.default_rng(0).standard_normal((2, problem.K, problem.ma))
    at, gpu = problem.evaluate(unknowns), DeviceProblem(problem, device)
    own = gpu.evaluate(device.array(unknowns))
    nc, ma = problem.nc, problem.ma
    out = tuple(
        np.empty((2, problem.K, *shape)) for shape in ((3, nc, nc), (3, ma, nc), (nc,), (ma,))
    )
    Interpreted(problem.program, problem.plan, problem.data).linearize(at, lam, None, out)
    out[0][:, problem.fixed, 0] = np.eye(nc)
    native_model, device_model = problem.linearize(at, lam), gpu.linearize(own, device.array(lam))
    np.testing.assert_allclose(own.fd, at.fd, rtol=0.0, atol=TOLERANCE * np.abs(at.fd).max())
    for name, expected in zip("HAbC", out, strict=True):
        for model in (native_model, device_model):
            atol = TOLERANCE * np.abs(expected).max()
            np.testing.assert_allclose(getattr(model, name), expected, rtol=0.0, atol=atol)
    assert np.abs(at.fd[0] - at.fd[1]).max() > 1e-3  # the two have different springs


def slope_of(remainder):
    """Exponent of h in a remainder(h)."""
    h = np.array([1e-2, 1e-3])
    return float(np.diff(np.log10([remainder(value) for value in h]))[0] / np.diff(np.log10(h))[0])


def test_derivatives_by_taylor():
    """What is left of FD beyond its first, and of the gradient of lamᵀFD, falls with h²."""
    dynamics, rng = RobotDynamics(robot()), np.random.default_rng(2)
    p, nodes = dynamics.layout.pack()[None], nodes_of(1)
    way, lam = rng.standard_normal(nodes.shape), rng.standard_normal((1, 1, 9))
    step = way[0, ::-1].ravel()  # next, now, previous
    fd, jac, hess = (value[0, 0] for value in dynamics.evaluate(nodes, p, lam, order=2))

    def moved(h):
        return [value[0, 0] for value in dynamics.evaluate(nodes + h * way, p, lam, order=2)]

    def first(h):
        return np.abs(moved(h)[0] - fd - h * jac @ step).max()

    def second(h):
        return np.abs(lam[0, 0] @ (moved(h)[1] - jac) - h * hess @ step).max()

    assert slope_of(first) == pytest.approx(2.0, abs=0.1)
    assert slope_of(second) == pytest.approx(2.0, abs=0.1)


def block():
    body = Body("block", -1, floating_base(), mass=MASS, inertia=0.01 * np.eye(3))
    return Character("block", (body,))


def hung_block(damping, seconds, dt=1e-3, drop=0.05):
    """Heights over the level at which the spring carries the weight, m."""
    spring = octo.SpringDamper("block", (0, 0, 0), None, (0, 0, 2.0), STIFFNESS, rest_length=0.5)
    hung = dataclasses.replace(block(), elements=(spring,))
    level = 1.5 - MASS * 9.81 / STIFFNESS
    start = np.array([0.0, 0.0, level + drop, 0.0, 0.0, 0.0])
    values = {"spring0.damping": damping}
    motion = octo.simulate(hung, x0=start, seconds=seconds, dt=dt, parameters=values)
    assert motion.converged.all()
    return motion.x[1:, 2] - level


def energy(height, dt=1e-3):
    """J, of the oscillation."""
    return (0.5 * STIFFNESS * height**2 + 0.5 * MASS * np.gradient(height, dt) ** 2)[1:-1]


def test_a_hung_block_oscillates_as_the_textbook_says():
    """Period 2π√(m/k); of the energy is lost what backward Euler, a damper of k·dt, takes."""
    height = hung_block(damping=0.0, seconds=3.0)
    rising = np.flatnonzero((height[:-1] < 0.0) & (height[1:] >= 0.0))
    assert len(rising) >= 4
    period = 2.0 * math.pi * math.sqrt(MASS / STIFFNESS)
    assert np.diff(rising).mean() * 1e-3 == pytest.approx(period, rel=0.01)
    left = energy(height)[-1] / energy(height)[0]
    assert left == pytest.approx(math.exp(-STIFFNESS * 1e-3 / MASS * 3.0), rel=0.03)


def test_a_damper_takes_the_energy_that_it_should():
    """exp(-c t/m), on top of what the time steps take."""
    left = [energy(hung_block(damping, 2.0))[-1] for damping in (0.0, 2.0)]
    assert left[1] / left[0] == pytest.approx(math.exp(-2.0 / MASS * 2.0), rel=0.05)


@needs_compiler
def test_octo_and_ipopt_agree():
    problem = octo.Problem(
        robot(ELEMENTS[:3]),
        steps=5,
        dt=0.05,
        x0=START + np.array([0, 0, 0.3, 0, 0, 0, 0, 0, 0]),
        costs=[octo.costs.Effort(), octo.costs.Posture(weight=0.1)],
        parameters={"contact.onset": 0.004, "contact.w_perp": 3e4, "contact.w_par": 3e5},
    )
    start = np.repeat(problem.start[None], 6, axis=0)
    own = octo.solve(problem, start=start, device="cpu")
    other = octo.reference.ipopt(problem)
    assert own.converged and other.solution.converged and other.compiled
    assert other.solution.energy == pytest.approx(own.energy, rel=1e-6)


def test_a_spring_in_mujoco_is_the_same():
    """Accelerations of a robot without contacts at rest and moving, octo's by a short step."""
    springs = (
        octo.SpringDamper("base", (0.1, 0.05, 0.0), "shank", (0.0, 0.1, -0.2), 300.0, 6.0, 0.3),
        octo.SpringDamper(None, (0.3, 0.1, 0.8), "mast", (0.0, 0.0, 0.1), 120.0, 4.0, 0.1),
    )
    plain = dataclasses.replace(walker(), contacts=(), pairs=())
    rng = np.random.default_rng(4)
    x, v = START + 0.3 * rng.standard_normal(9), rng.standard_normal(9)
    felt = []
    for elements in ((), springs):
        character = dataclasses.replace(plain, elements=elements)
        plant = octo.plant.MujocoPlant(character)
        q, rate = octo.plant.from_chart(character, x, v)
        plant.reset(q, rate)
        felt.append(np.array(plant.data.qfrc_passive))
        dynamics = RobotDynamics(character)
        dt = 1e-7
        nodes = np.array([[x - 2.0 * dt * v, x - dt * v, x]])
        p = dynamics.layout.pack(dt=dt)[None]
        felt.append(dynamics.evaluate(nodes, p)[0][0, 0])
    mujoco_force, octo_force = felt[2] - felt[0], felt[1] - felt[3]
    # generalised forces of the joints are the same in both; those of a free base have other axes
    np.testing.assert_allclose(mujoco_force[6:], octo_force[6:], rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(mujoco_force[:3], octo_force[:3], rtol=1e-5, atol=1e-4)
    assert np.abs(octo_force).max() > 10.0


def test_mujoco_refuses_what_it_has_no_tendon_for(tmp_path):
    with pytest.raises(ModelError, match="element band0 is a RubberBand, must be one that MuJoCo"):
        octo.export_mjcf(robot(), tmp_path / "robot.xml")


def test_the_mirror_looks_at_elements():
    mammal = octo.gallery.mammal()
    left, right = (
        octo.SpringDamper("trunk", (0.1, y, 0.0), f"front_{side}_shank", (0.0, 0.0, -0.1), 80.0)
        for side, y in (("left", 0.05), ("right", -0.05))
    )
    swapped = octo.SpringDamper(right.body_b, right.point_b, "trunk", right.point_a, 80.0)
    both = dataclasses.replace(mammal, elements=(left, right))
    np.testing.assert_array_equal(octo.mirror_of(both).matrix, octo.mirror_of(mammal).matrix)
    octo.mirror_of(dataclasses.replace(mammal, elements=(left, swapped)))
    stiffer = dataclasses.replace(right, stiffness=160.0)
    for elements in ((left,), (left, stiffer)):
        with pytest.raises(MirrorError, match="element spring0 has no image"):
            octo.mirror_of(dataclasses.replace(mammal, elements=elements))


def test_a_cycle_is_not_held_to_the_world():
    mammal = octo.gallery.mammal()
    spring = octo.SpringDamper("trunk", (0, 0, 0), None, (0, 0, 1), 10.0)
    held = dataclasses.replace(mammal, elements=(spring,))
    cycle = octo.Cycle(speed=0.4, period=0.4, mirror=False)
    with pytest.raises(ProblemError, match="element spring0 must not hold robot 'mammal'"):
        octo.Problem(held, steps=8, cycle=cycle, costs=[octo.costs.Effort()])


def test_files_keep_octos_elements_and_name_the_others():
    plain = json.loads(json.dumps(store.to_plain(robot())))
    found = store.from_plain(plain)
    assert found.elements == ELEMENTS[1:3]
    assert sum("user-written RubberBand" in sentence for sentence in found.dropped) == 2
    plain["elements"][1]["stiffness"] = "soft"
    with pytest.raises(ValueRangeError, match="stiffness"):
        store.from_plain(plain)
    named = octo.describe(robot())["elements"][1]
    assert named["name"] == "spring1" and named["parameters"]["stiffness"] == 300.0
    assert "spring2 (world – mast)" in robot().summary()


def test_a_batch_of_springs_and_of_others():
    """Stiffness is a number; where a spring acts is structure."""
    problems = [
        octo.Problem(robot((spring,)), steps=4, dt=0.05, x0=START, costs=[octo.costs.Effort()])
        for spring in (
            ELEMENTS[1],
            dataclasses.replace(ELEMENTS[1], stiffness=10.0),
            dataclasses.replace(ELEMENTS[1], point_a=(0.0, 0.0, 0.0)),
        )
    ]
    index = problems[0].dynamics.layout.index("spring0.stiffness")
    np.testing.assert_array_equal(CompiledProblem(problems[:2]).p[:, index], [300.0, 10.0])
    with pytest.raises(ProblemError, match="model differ"):
        CompiledProblem([problems[0], problems[2]])


class NoForce(RubberBand):
    def force(self, p_a, v_a, p_b, v_b, p):
        return p["missing"] * p_a


class Flat(RubberBand):
    def force(self, p_a, v_a, p_b, v_b, p):
        return ca.dot(p_a, p_b)


@pytest.mark.parametrize(
    ("make", "error", "match"),
    [
        (lambda: robot((RubberBand("leg", (0, 0, 0), None, (0, 0, 0)),)), UnknownNameError, "leg"),
        (lambda: robot((3,)), ModelError, r"elements is \(3,\), must be a tuple of octo.Element"),
        (
            lambda: RubberBand("base", (0, 0, np.nan), None, (0, 0, 0)),
            ValueRangeError,
            "point_a is not finite",
        ),
        (
            lambda: RubberBand("base", (0, 0, 0), None, (0, 0, 0), stiffness="stiff"),
            ValueRangeError,
            "stiffness is 'stiff'",
        ),
        (lambda: RubberBand(None, (0, 0, 0), None, (0, 0, 0)), ModelError, "both None"),
        (
            lambda: octo.SpringDamper("base", (0, 0, 0), None, (0, 0, 0), damping=-1.0),
            ModelError,
            "damping is -1.0, must not be negative",
        ),
        (
            lambda: RobotDynamics(robot((NoForce("base", (0, 0, 0), None, (0, 0, 0)),))),
            ModelError,
            "force of element NoForce cannot be built: KeyError",
        ),
        (
            lambda: RobotDynamics(robot((Flat("base", (0, 0, 0), None, (0, 0, 0)),))),
            ModelError,
            r"shape \(1, 1\), must be \(3, 1\)",
        ),
    ],
)
def test_refused(make, error, match):
    with pytest.raises(error, match=match):
        make()


@dataclasses.dataclass(frozen=True)
class Repulsion(octo.Element):
    """What a pair of spheres does (octo.dynamics.symbolic.pair_potential)."""

    radii: float = 0.5  # m
    weight: float = 1e3  # N/m²
    rounding: float = 1e-3  # m

    def force(self, p_a, v_a, p_b, v_b, p):
        apart = p_b - p_a
        length = ca.sqrt(ca.dot(apart, apart) + p["rounding"] ** 2)
        gap = ca.if_else(length < p["radii"], length - p["radii"], 0.0)
        return 3.0 * p["weight"] * gap**2 * apart / length


@needs_compiler
def test_a_pair_written_as_an_element_is_the_pair():
    """Two paths to the same numbers, of which pairs.c is the short one of a potential."""
    first, second = walker().contacts[:2]
    ends = [(walker().bodies[s.body].name, tuple(s.position)) for s in (first, second)]
    radii = first.radius + second.radius + 0.6
    thick = tuple(
        dataclasses.replace(s, radius=s.radius + 0.3, touches_terrain=False)
        for s in (first, second)
    )
    pair = dataclasses.replace(walker(), contacts=thick, pairs=((0, 1),))
    element = dataclasses.replace(pair, pairs=(), elements=(Repulsion(*ends[0], *ends[1], radii),))
    lam, found = np.random.default_rng(1).standard_normal((1, 9, 9)), []
    for character in (pair, element, dataclasses.replace(pair, pairs=())):
        dynamics = RobotDynamics(character)
        p = dynamics.layout.pack(w_self=1e3)[None]
        found.append(dynamics.evaluate(nodes_of(9), p, lam, order=2))
    for a, b, without in zip(*found, strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=TOLERANCE * np.abs(b).max())
        assert np.abs(a - without).max() > 0.01 * np.abs(a).max()
