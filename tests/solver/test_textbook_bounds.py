"""Hard constraints on textbook problems: closed forms, quadratic programs solved by other means and
IPOPT.

Whether a bound holds is computed here from the motion, never read off ``Solution.bounds``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

import octo
from octo.model.kinematics import body_poses
from octo.solver.status import Status
from tests.solver.test_barrier import by_ipopt, swing_up

Array = NDArray[np.float64]
G = 9.81
HELD = 1e-6  # of a row


@lru_cache
def masses(count: int, dt: float, gravity: tuple[float, ...] = ()) -> octo.CustomDynamics:
    """Masses of 1 kg, each pushed along its own axis: a = u − ``gravity``."""
    pull = ca.DM(gravity or (0.0,) * count)

    def fd(x_next: ca.SX, x: ca.SX, x_prev: ca.SX, view: Any) -> ca.SX:
        return (x_next - 2 * x + x_prev) / view["dt"] ** 2 + pull

    return octo.CustomDynamics(fd, count, range(count), {"dt": dt})


def solved(problem: octo.Problem, **how: Any) -> octo.Solution:
    motion = octo.solve(problem, **how)
    assert motion.status is Status.CONVERGED, motion
    return motion


def row(
    function: Callable[..., ca.SX], lower: Any = -np.inf, upper: Any = np.inf, **more: Any
) -> octo.CustomConstraint:
    return octo.CustomConstraint(lambda step, p: function(step), lower, upper, **more)


# -- jumps and slopes: closed forms ----------------------------------------------------------------


@pytest.mark.parametrize("force", [1.5, 2.5])
def test_a_hopper_jumps_as_high_as_its_force_lets_it(force: float) -> None:
    """A leg of bounded force (in weights) and stroke d lifts a mass to d·force; to the step, as a
    linear program says."""
    dt, stroke, push = 0.01, 0.3, 40
    rise = np.sqrt(2.0 * (force - 1.0) * stroke / G)  # s, in flight
    steps = push + round(rise / dt)
    on_ground = np.arange(steps) < push
    leg = np.where(on_ground, force * G, 0.0)[:, None]
    stretched = np.where(on_ground, stroke, np.inf)[:, None]
    problem = octo.Problem(
        masses(1, dt, (G,)),
        steps=steps,
        dt=dt,
        costs=[octo.CustomCost(lambda step, p: step.x_next - 2.0, at="last", name="High")],
        constraints=[
            row(lambda step: step.u / G, 0.0 * leg, leg / G, name="Leg"),
            row(lambda step: step.x, 0.0, stretched, name="Stroke"),
        ],
        x0=np.zeros(1),
    )
    motion = solved(problem)
    height = motion.x[-1, 0]
    u, z = motion.u[:, 0], motion.x[1:-1, 0]
    assert (u >= -HELD * G).all() and (u <= leg[:, 0] + HELD * G).all()
    assert (z >= -HELD).all() and z[:push].max() <= stroke + HELD
    np.testing.assert_allclose(height, stroke * force, rtol=0.06)  # dt is short, not zero
    # x_k as sums of u
    i = np.arange(steps)
    sums = dt**2 * np.maximum(i[:, None] + 1 - i, 0.0)  # x_{k+1}
    fall = sums @ np.full(steps, G)
    held = sums[: push - 1]
    best = linprog(
        -sums[-1],
        np.vstack([held, -sums[:-1]]),
        np.concatenate([stroke + fall[: push - 1], -fall[:-1]]),
        bounds=[(0.0, top) for top in leg[:, 0]],
    )
    np.testing.assert_allclose(height, -best.fun - fall[-1], rtol=1e-5)


def on_a_slope(tangent: float, mu: float, **more: Any) -> octo.Problem:
    """A block of 1 kg; the ground's force along the slope and across it are the inputs."""
    angle = np.arctan(tangent)
    stays = row(lambda step: step.x_next[1], 0.0, 0.0, name="OnTheGround")
    cone = row(
        lambda step: ca.vertcat(mu * step.u[1] - step.u[0], mu * step.u[1] + step.u[0]) / G,
        lower=0.0,
        name="Cone",
    )
    constraints = [stays, cone, *more.pop("constraints", [])]
    given = {"costs": [octo.CustomCost(lambda s, p: s.x_next[0], at="last", name="Held")], **more}
    pull = (G * np.sin(angle), G * np.cos(angle))
    return octo.Problem(
        masses(2, 0.05, pull), steps=20, dt=0.05, constraints=constraints, x0=np.zeros(2), **given
    )


HOLD = row(lambda step: step.x_next[0], 0.0, 0.0, name="Hold")


@pytest.mark.parametrize("tangent", [0.3, 0.49, 0.5])
def test_a_block_holds_on_a_slope_within_the_cone(tangent: float) -> None:
    """To the very edge, tan = μ."""
    motion = solved(on_a_slope(tangent, 0.5, costs=[octo.Effort()], constraints=[HOLD]))
    np.testing.assert_allclose(motion.x[1:], 0.0, atol=HELD)
    np.testing.assert_allclose(motion.u[:, 0], G * np.sin(np.arctan(tangent)), rtol=1e-4)
    assert (np.abs(motion.u[:, 0]) <= 0.5 * motion.u[:, 1] + HELD * G).all()


def test_a_block_beyond_the_cone_cannot_hold() -> None:
    problem = on_a_slope(0.6, 0.5, costs=[octo.Effort()], constraints=[HOLD])
    motion = octo.solve(problem, max_iterations=200)
    assert not motion.converged and not all(bound.held for bound in motion.bounds)


@pytest.mark.parametrize("tangent", [0.51, 0.6, 1.0])
def test_a_block_beyond_the_cone_slides_as_far_as_friction_lets_it(tangent: float) -> None:
    motion = solved(on_a_slope(tangent, 0.5))
    angle = np.arctan(tangent)
    slid = G * (np.sin(angle) - 0.5 * np.cos(angle)) * 0.05**2 * 20 * 21 / 2
    np.testing.assert_allclose(motion.x[-1, 0], -slid, atol=1e-4)
    assert (np.abs(motion.u[:, 0]) <= 0.5 * motion.u[:, 1] + HELD * G).all()


@pytest.mark.slow
def test_a_robot_on_a_plane_keeps_within_its_cones() -> None:
    """A plane of tan 0.35 under a robot that is asked to stay, with μ = 0.5 under two feet."""
    angle, robot = np.arctan(0.35), octo.gallery.mammal()
    ground = [contact.name for contact in robot.contacts if contact.touches_terrain]
    names = [name for name in ground if name in ("front_left", "hind_right")]
    problem = octo.Problem(
        robot,
        steps=12,
        dt=0.05,
        terrain=octo.Plane(slope=angle),
        costs=[octo.CenterOfMassVelocity((0.0, 0.0, 0.0)), *octo.costs.natural()],
        constraints=[octo.FrictionCones(0.5, contacts=names)],
    )
    motion = octo.solve(problem)
    assert motion.converged
    own = [ground.index(name) for name in names]
    assert len(own) == 2
    force, normal = motion.contact_force[:, own] / motion.weight, motion.contact_normal[:, own]
    along = np.sum(force * normal, axis=2)
    across = np.linalg.norm(force - along[..., None] * normal, axis=2)
    rounded = across**2 / np.hypot(across, 0.01) / (0.5 * (along + np.hypot(along, 0.02)))
    assert rounded.max() <= 0.5 + HELD
    loaded = along > 0.25
    assert loaded.any() and (across[loaded] <= 0.5 * 1.01 * along[loaded]).all()
    assert np.linalg.norm(motion.com[-1] - motion.com[0]) < 0.05


# -- pendulums -------------------------------------------------------------------------------------


def places(q: Any) -> Any:
    """(4,) m, of two masses on links of 0.5 m; zero hangs."""
    first = ca.vertcat(0.5 * ca.sin(q[0]), -0.5 * ca.cos(q[0]))
    return ca.vertcat(first, first + ca.vertcat(0.5 * ca.sin(q[1]), -0.5 * ca.cos(q[1])))


def double_pendulum(**more: Any) -> octo.Problem:
    """Both links are turned by motors; from hanging to standing in 2 s, the force of the masses
    projected at x_next."""

    def fd(x_next: ca.SX, x: ca.SX, x_prev: ca.SX, view: Any) -> ca.SX:
        a = (places(x_next) - 2 * places(x) + places(x_prev)) / 0.05**2
        return ca.jtimes(places(x_next), x_next, a + ca.DM([0.0, G, 0.0, G]), True)

    given = {
        "steps": 40,
        "dt": 0.05,
        "costs": [octo.Effort(weight=0.01, reference=1.0)],
        "x0": np.zeros(2),
        "x_end": np.array([np.pi, np.pi]),
        "v_end": np.zeros(2),
        **more,
    }
    return octo.Problem(octo.CustomDynamics(fd, 2, [0, 1], {"dt": 0.05}), **given)


def test_a_double_pendulum_leaps_by_pi_unless_steps_are_limited() -> None:
    leap = np.zeros((41, 2))
    leap[20:] = np.pi
    free = octo.solve(double_pendulum(step_limit=None), start=leap)
    assert np.abs(np.diff(free.x[1:], axis=0)).max() > 2.0
    held = solved(double_pendulum(constraints=[octo.StepLimit(0.4)]), start=leap)
    assert np.abs(np.diff(held.x[1:], axis=0)).max() <= 0.4 * (1.0 + HELD)
    assert held.energy > free.energy
    np.testing.assert_allclose(held.x[-2:], np.pi, atol=1e-9)


def test_a_tighter_limit_never_costs_less() -> None:
    """Along one family of solutions, each started from the one before."""
    limits, energies = (0.5, 0.35, 0.25, 0.2), []
    motion: octo.Solution | None = None
    for largest in limits:
        motion = solved(double_pendulum(constraints=[octo.StepLimit(largest)]), start=motion)
        assert np.abs(np.diff(motion.x[1:], axis=0)).max() <= largest * (1.0 + HELD)
        energies.append(motion.energy)
    assert (np.diff(energies) >= -1e-6 * energies[0]).all()


# -- keyframes and bounds at some steps: quadratic programs ----------------------------------------

STEPS, DT = 30, 0.05
SUMS = DT**2 * np.maximum(np.arange(STEPS)[:, None] + 1 - np.arange(STEPS), 0.0)


def glide(count: int = 1, **more: Any) -> octo.Problem:
    """A mass that moves with the least force."""
    given = {"costs": [octo.Effort(weight=1.0, reference=1.0)], "x0": np.zeros(count), **more}
    return octo.Problem(masses(count, DT), steps=STEPS, dt=DT, **given)


def quadratic(rows: Array, lower: Array, upper: Array, most: float = np.inf) -> Array:
    """(N,) the least u with lower ≤ rows u ≤ upper and |u| ≤ most."""
    u = ca.SX.sym("u", STEPS)
    problem = {"x": u, "f": ca.sumsqr(u) / STEPS, "g": ca.DM(rows) @ u}
    solver = ca.qpsol("least", "qrqp", problem, {"print_iter": False, "print_header": False})
    return np.ravel(solver(lbx=-most, ubx=most, lbg=lower, ubg=upper)["x"])


@pytest.mark.parametrize("basis", ["nodes", octo.Hermite(3)], ids=["nodes", "hermite"])
def test_three_keyframes(basis: Any) -> None:
    """Poses at three times, with the least force between them."""
    seconds, poses = [0.5, 1.0, 1.5], np.array([0.4, -0.2, 0.3])
    targets = np.zeros((STEPS, 1))
    own = np.rint(np.array(seconds) / DT).astype(int) - 1
    targets[own, 0] = poses
    keyframes = octo.PoseTarget(target=targets, at=octo.At(seconds=seconds))
    motion = solved(glide(constraints=[keyframes], basis=basis))
    np.testing.assert_allclose(motion.x[2:][own, 0], poses, atol=1e-6)
    if basis == "nodes":
        rows = SUMS[own]
        least = rows.T @ np.linalg.solve(rows @ rows.T, poses)
        np.testing.assert_allclose(motion.u[:, 0], least, atol=1e-4)


def test_a_body_is_at_three_places_on_time() -> None:
    """A robot's trunk, to a millionth of a metre, by the motors of its legs."""
    robot, seconds = octo.gallery.mammal(), [0.2, 0.4, 0.6]
    own = np.rint(np.array(seconds) / DT).astype(int) - 1
    problem = octo.Problem(robot, steps=12, dt=DT, costs=octo.costs.natural())
    targets = np.tile(problem.start[:3], (12, 1))
    targets[own] += [[0.01, 0.0, -0.01], [0.02, 0.01, 0.0], [0.0, 0.0, 0.01]]
    place = octo.PointPosition(target=targets, at=octo.At(seconds=seconds))
    motion = octo.solve(problem.replace(constraints=[place, octo.TorqueLimits()]))
    assert motion.converged
    found = body_poses(robot, motion.x[2:])[1][own, robot.base_body]
    np.testing.assert_allclose(found, targets[own], atol=1e-6)
    assert (np.abs(motion.u) <= motion.torque_limit * (1.0 + HELD)).all()


def test_bounds_at_some_steps_only() -> None:
    """A gate at three steps, and a limit of force everywhere: as a quadratic program."""
    gate = row(lambda step: step.x_next, 0.5, 0.6, at=[9, 10, 11], name="Gate")
    home = row(lambda step: step.x_next, -0.1, 0.1, at="last", name="Home")
    motion = solved(glide(constraints=[gate, home, octo.TorqueLimits(limit=6.0)]))
    rows = SUMS[[9, 10, 11, STEPS - 1]]
    best = quadratic(rows, np.array([0.5, 0.5, 0.5, -0.1]), np.array([0.6, 0.6, 0.6, 0.1]), 6.0)
    np.testing.assert_allclose(motion.u[:, 0], best, atol=5e-3)
    assert motion.x[11:14].min() >= 0.5 - HELD and abs(motion.x[-1, 0]) <= 0.1 + HELD
    assert motion.x[2:11].min() < 0.45  # free where nothing is asked


def test_a_bound_that_is_active_at_the_start() -> None:
    """The mass stands at its stop, and moves at its largest speed towards where it may not go."""
    stop = row(lambda step: step.x_next, lower=0.0, name="Stop")
    pulled = octo.CustomCost(lambda step, p: step.x_next + 1.0, name="Pulled")
    motion = solved(glide(costs=[pulled, octo.Effort(weight=1e-3)], constraints=[stop]))
    assert motion.x[1:].min() >= -HELD and motion.x[1:].max() < 1e-3
    fast = row(lambda step: (step.x_next - step.x) / DT, -1.0, 1.0, name="Fast")
    far = octo.CustomCost(lambda step, p: step.x_next - 5.0, at="last", name="Far")
    motion = solved(glide(costs=[far], constraints=[fast], v0=np.ones(1)))
    np.testing.assert_allclose(np.diff(motion.x[1:, 0]) / DT, 1.0, rtol=1e-4)


def test_a_limit_of_zero_lets_nothing_move() -> None:
    limits = octo.TorqueLimits(limit=[0.0, np.inf])
    goal = octo.CustomCost(lambda step, p: step.x_next - 1.0, name="Goal")
    motion = solved(glide(2, costs=[goal], constraints=[limits]))
    np.testing.assert_allclose(motion.x[1:, 0], 0.0, atol=HELD)
    np.testing.assert_allclose(motion.x[3:, 1], 1.0, atol=0.05)


def test_bounds_and_a_fixed_end_on_cubic_pieces() -> None:
    """The least force on Hermite pieces stays within its limit, as on nodes."""
    ends = {"x_end": np.array([0.5]), "v_end": np.zeros(1)}
    limits = [octo.TorqueLimits(limit=1.2)]
    nodes = solved(glide(constraints=limits, **ends))
    hermite = solved(glide(constraints=limits, basis=octo.Hermite(3), **ends))
    for motion in (nodes, hermite):
        assert np.abs(motion.u).max() <= 1.2 * (1.0 + HELD)
        np.testing.assert_allclose(motion.x[-1], 0.5, atol=1e-9)
    # a last velocity of zero is a step of rest on nodes
    np.testing.assert_allclose(hermite.energy, nodes.energy * (29 / 30) ** 3, rtol=0.05)


def test_an_equality_and_a_bound_on_the_same_row() -> None:
    """Redundant where they agree; each twice is the same as once."""
    there = row(lambda step: step.x_next, 0.5, 0.5, at="last", name="There")
    below = row(lambda step: step.x_next, upper=0.5, name="Below")
    once = solved(glide(constraints=[there]))
    twice = solved(glide(constraints=[there, below, replace(below, name="Again")]))
    np.testing.assert_allclose(twice.energy, once.energy, rtol=1e-4)
    np.testing.assert_allclose(twice.x[-1], 0.5, atol=HELD)


def test_a_warm_start_is_the_solution_at_once() -> None:
    gate = row(lambda step: step.x_next, 0.5, 0.6, at=[9, 10, 11], name="Gate")
    problem = glide(constraints=[gate, octo.TorqueLimits(limit=6.0)])
    cold = solved(problem)
    warm = solved(problem, start=cold)
    np.testing.assert_allclose(warm.energy, cold.energy, rtol=1e-4)
    assert warm.iterations <= cold.iterations


def test_a_batch_has_bounds_of_its_own_at_some_steps() -> None:
    def through(lower: float) -> octo.Problem:
        gate = row(lambda step: step.x_next, lower, at=[14], name="Gate")
        return glide(constraints=[gate, octo.TorqueLimits(limit=4.0 * lower + 1.0)])

    heights = (0.2, 0.5, 0.9)
    for height, motion in zip(heights, octo.solve([through(h) for h in heights]), strict=True):
        assert motion.status is Status.CONVERGED
        best = quadratic(SUMS[[14]], np.array([height]), np.array([np.inf]), 4.0 * height + 1.0)
        np.testing.assert_allclose(motion.u[:, 0], best, atol=5e-3)
        assert motion.x[16, 0] >= height - HELD


@pytest.mark.parametrize("weight", [1e-4, 1.0, 1e6, 1e8, 1e10])
def test_multipliers_of_any_size(weight: float) -> None:
    """A goal behind a stop, at weights of 14 decades: what is priced high must not break what is
    hard, nor keep a solve from ending."""
    stop = row(lambda step: step.x_next, upper=0.3, name="Stop")
    goal = octo.CustomCost(lambda step, p: step.x_next - 1.0, weight=weight, name="Goal")
    effort = octo.Effort(weight=1e-4 * weight, reference=1.0)
    motion = solved(glide(costs=[goal, effort], constraints=[stop]))
    assert 0.25 <= motion.x.max() <= 0.3 + HELD and motion.iterations <= 40


@pytest.mark.parametrize("limit", [8.0, 9.0, 12.0, 15.0])
def test_a_swing_up_is_that_of_ipopt_from_several_starts(limit: float) -> None:
    for seed in (1, 2):
        start = 1e-3 * np.random.default_rng(seed).standard_normal((62, 2))
        motion = solved(swing_up(limit), start=start)
        best = by_ipopt(limit, 60, start)  # now and then another optimum, 6e-4 above
        assert (1.0 - 1e-3) * best <= motion.energy <= (1.0 + 1e-5) * best
        assert np.abs(motion.u).max() <= limit * (1.0 + HELD) and motion.iterations <= 60
