"""Physics that a person can check with a pencil: slopes, free flight, drops."""

from __future__ import annotations

import numpy as np
import pytest

from octo.dynamics.laws import Coulomb, Smooth, Viscous
from octo.dynamics.simulate import Motion, Stepper, simulate, step
from octo.dynamics.static_pose import static_pose
from octo.dynamics.symbolic import mass_matrix_of_points
from octo.errors import ProblemError, ShapeError, UnknownNameError, ValueRangeError
from octo.model.character import Character
from octo.model.gallery import CHARACTERS
from octo.model.kinematics import body_poses, center_of_mass, sphere_centers

G = 9.81  # m/s²


def momentum(robot: Character, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Linear (N+1, 3) kg m/s and angular momentum (N+1, 3) kg m²/s about the centre of mass, at x_0
    … x_N."""
    rotation, origin = body_poses(robot, motion.x)
    center = center_of_mass(robot, motion.x)
    linear, angular = np.zeros((len(motion.x) - 1, 3)), np.zeros((len(motion.x) - 1, 3))
    for b, body in enumerate(robot.bodies):
        R, com = rotation[:, b], origin[:, b] + rotation[:, b] @ body.com
        v, turn = np.diff(com, axis=0) / motion.dt, np.diff(R, axis=0) / motion.dt
        linear += body.mass * v
        # Σ m r×v over the body's points: that of its centre, and the axial vector of Ṙ M Rᵀ
        angular += body.mass * np.cross((com - center)[1:], v)
        spin = turn @ mass_matrix_of_points(body) @ np.swapaxes(R[1:], -1, -2)
        angular += np.stack(
            [spin[:, k, i] - spin[:, i, k] for i, k in ((1, 2), (2, 0), (0, 1))], axis=-1
        )
    return linear, angular


def energy(robot: Character, motion: Motion) -> np.ndarray:
    """Kinetic energy and weight times height (N+1,) J, at x_0 … x_N."""
    rotation, origin = body_poses(robot, motion.x)
    total = np.zeros(len(motion.x) - 1)
    for b, body in enumerate(robot.bodies):
        com = origin[:, b] + rotation[:, b] @ body.com
        v, turn = np.diff(com, axis=0) / motion.dt, np.diff(rotation[:, b], axis=0) / motion.dt
        total += 0.5 * body.mass * np.sum(v**2, axis=1) + body.mass * G * com[1:, 2]
        total += 0.5 * np.einsum("nij,jk,nik->n", turn, mass_matrix_of_points(body), turn)
    return total


def slide(dynamics, p, dt: float, steps: int) -> Motion:
    """A block let go from its static pose on the slope."""
    names = dynamics.layout.names
    parameters = {name: p[k] for k, name in enumerate(names) if name != "dt"}
    return simulate(dynamics, static_pose(dynamics, p), steps=steps, dt=dt, parameters=parameters)


def test_a_block_creeps_down_a_slope_as_fast_as_eq_6_says(block_dynamics):
    """w_par d² v = mg sin, w_perp d² = mg cos: v = tan(slope) w_perp/w_par."""
    slope, w_perp = 0.25, 3e4
    dynamics = block_dynamics(Smooth(), slope)
    for ratio in (3.0, 10.0, 30.0):  # s/m
        p = dynamics.layout.pack(**{"contact.w_perp": w_perp, "contact.w_par": ratio * w_perp})
        motion = slide(dynamics, p, dt=0.05, steps=400)
        assert motion.converged.all()
        velocity = motion.velocity[-1]
        downhill = np.array([-np.cos(slope), 0.0, -np.sin(slope)])
        assert velocity[:3] @ downhill == pytest.approx(np.tan(slope) / ratio, rel=1e-6)
        np.testing.assert_allclose(velocity[3:], 0.0, atol=1e-9)


def test_coulomb_holds_below_the_friction_angle(block_dynamics):
    """mu N v/√(v² + creep²) = N tan(slope) gives the speed that is left of sticking."""
    mu, creep, slope = 0.5, 0.02, np.arctan(0.9 * 0.5)
    dynamics = block_dynamics(Smooth(friction=Coulomb(mu, creep)), slope)
    motion = slide(dynamics, dynamics.layout.pack(), dt=0.05, steps=100)
    assert motion.converged.all()
    speed = np.linalg.norm(motion.velocity[-1, :3])
    assert speed == pytest.approx(creep * 0.9 / np.sqrt(1.0 - 0.9**2), rel=1e-6)


def test_coulomb_slides_above_the_friction_angle(block_dynamics):
    """It accelerates by g (sin - mu cos) once it is much faster than the creep speed."""
    mu, creep, slope = 0.5, 0.02, np.arctan(1.5 * 0.5)
    dynamics = block_dynamics(Smooth(friction=Coulomb(mu, creep)), slope)
    motion = slide(dynamics, dynamics.layout.pack(), dt=0.02, steps=100)
    speed = np.linalg.norm(motion.velocity[:, :3], axis=1)
    acceleration = (speed[-1] - speed[-26]) / (25 * motion.dt)
    assert acceleration == pytest.approx(G * (np.sin(slope) - mu * np.cos(slope)), rel=1e-4)


@pytest.fixture
def thrown(gallery):
    """A mammal thrown into the air with a turn of its trunk and of its legs."""
    dynamics, _ = gallery("mammal")
    rng = np.random.default_rng(0)
    x0 = dynamics.character.default_pose.copy()
    x0[2] += 5.0
    v0 = np.concatenate([[0.5, -0.3, 2.0], rng.normal(0.0, 1.0, 3), rng.normal(0.0, 0.5, 12)])

    def throw(dt: float) -> Motion:
        return simulate(
            dynamics, x0, v0, seconds=0.4, dt=dt, parameters={"w_joint": 0.0, "w_self": 0.0}
        )

    return dynamics.character, throw


def test_in_free_flight_the_centre_of_mass_falls_with_g(thrown):
    """Translations are linear in the points: the discrete parabola is exact at every dt."""
    robot, throw = thrown
    motion = throw(0.025)
    center = center_of_mass(robot, motion.x)
    second = np.diff(center, 2, axis=0) / motion.dt**2
    np.testing.assert_allclose(second, np.tile([0.0, 0.0, -G], (len(second), 1)), atol=1e-6)


def test_in_free_flight_angular_momentum_is_kept_to_first_order(thrown):
    robot, throw = thrown
    drift = []
    for dt in (0.01, 0.005, 0.0025):
        _, angular = momentum(robot, throw(dt))
        drift.append(np.linalg.norm(angular[-1] - angular[0]))
    size = np.linalg.norm(momentum(robot, throw(0.0025))[1][0])
    assert drift[-1] < 0.02 * size
    np.testing.assert_allclose(np.divide(drift[:-1], drift[1:]), 2.0, atol=0.25)


@pytest.mark.parametrize("w_perp", [3e4, 1e6])
def test_a_dropped_block_comes_to_rest_as_deep_as_its_load_says(block, block_dynamics, w_perp):
    """w_perp d² = mg/4 under each of the four corners."""
    dynamics = block_dynamics(Smooth(), 0.0)
    x0 = np.array([0.0, 0.0, 0.3, 0.4, 0.05, -0.03])  # m and rad: it lands on a corner
    parameters = {"contact.w_perp": w_perp, "contact.w_par": 10.0 * w_perp}
    motion = simulate(dynamics, x0, seconds=20.0, dt=0.05, parameters=parameters)
    assert motion.converged.all()
    depth = 0.01 - sphere_centers(block, motion.x[-1])[:, 2]
    np.testing.assert_allclose(depth, np.sqrt(block.mass * G / 4.0 / w_perp), rtol=1e-6)
    carried = w_perp * np.sum(depth**2)
    assert carried == pytest.approx(block.mass * G, rel=1e-6)


@pytest.mark.parametrize("name", CHARACTERS)
def test_every_character_survives_a_fall_at_a_large_time_step(gallery, name):
    """Dropped from 0.2 m, limp, at dt = 0.05: finite, never above the energy it started with, and
    down at the end."""
    dynamics, p = gallery(name)
    robot = dynamics.character
    x0 = static_pose(dynamics, p)
    x0[2] += 0.2
    weights = {key: p[dynamics.layout.index(key)] for key in ("contact.w_perp", "contact.w_par")}
    motion = simulate(dynamics, x0, seconds=1.5, dt=0.05, parameters=weights)
    assert np.isfinite(motion.x).all()
    assert motion.converged.all()
    total = energy(robot, motion)
    assert np.all(total <= total[0] + 1e-6 * robot.mass * G)
    assert total[-1] < total[0] - 0.2 * robot.mass * G


def test_torques_are_found_again_in_fd(gallery):
    """A step under u leaves U FD = u and U_/ FD = 0."""
    dynamics, p = gallery("biped")
    rng = np.random.default_rng(1)
    x = static_pose(dynamics, p)
    u = rng.normal(0.0, 5.0, dynamics.nu)
    x_next = step(dynamics, x, x, u, p)
    fd, _, _ = dynamics.evaluate(np.stack([x, x, x_next])[None], p[None])
    np.testing.assert_allclose(fd[0, 0, dynamics.actuated], u, atol=1e-6)
    np.testing.assert_allclose(fd[0, 0, dynamics.unactuated], 0.0, atol=1e-6)


def test_some_coordinates_can_be_held(gallery):
    dynamics, p = gallery("biped")
    x = dynamics.character.default_pose + 0.0
    x_next, residual = Stepper(dynamics, p, dynamics.unactuated)(x, x)
    assert residual < 1e-9
    np.testing.assert_array_equal(x_next[dynamics.actuated], x[dynamics.actuated])
    assert x_next[2] < x[2]


def test_controls_as_a_table_and_as_a_function_agree(gallery):
    dynamics, _ = gallery("chain")
    x0 = dynamics.character.default_pose
    table = np.sin(np.arange(12.0))[:, None] * np.ones(dynamics.nu)
    played = simulate(dynamics, x0, controls=table, dt=0.02)
    asked = simulate(
        dynamics,
        x0,
        controls=lambda t, q, v: np.sin(t / 0.02) * np.ones(dynamics.nu),
        steps=12,
        dt=0.02,
    )
    np.testing.assert_allclose(asked.x, played.x, atol=1e-12)
    np.testing.assert_array_equal(played.u, table)
    assert played.x.shape == (14, dynamics.nx) and played.time[-1] == pytest.approx(0.24)


def test_a_character_without_motors_is_simulated(block):
    motion = simulate(
        block, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), steps=3, law=Smooth(friction=Viscous())
    )
    assert motion.u.shape == (3, 0) and motion.converged.all()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"x0": np.zeros(5), "steps": 2}, ShapeError, "x0 has shape"),
        ({"x0": np.full(6, np.nan), "steps": 2}, ValueRangeError, "x0 is not finite"),
        ({"v0": np.zeros(7), "steps": 2}, ShapeError, "v0 has shape"),
        (
            {"controls": np.zeros((4, 2))},
            ShapeError,
            r"controls has shape \(4, 2\), expected \(4, 0\)",
        ),
        ({"controls": lambda t, q, v: np.zeros(3), "steps": 2}, ShapeError, "controls at step 0"),
        ({"controls": lambda t, q, v: np.zeros(0)}, ProblemError, "controls is a function"),
        ({}, ProblemError, "how long"),
        ({"steps": 2, "seconds": 1.0}, ProblemError, "both given"),
        ({"steps": 0}, ValueRangeError, "steps is 0"),
        ({"seconds": np.inf}, ValueRangeError, "seconds is inf"),
        ({"steps": 2, "dt": -1.0}, ValueRangeError, "dt is -1.0"),
        ({"steps": 2, "parameters": {"gravity": 1.0}}, UnknownNameError, "gravity"),
        ({"steps": 2, "parameters": {"gravity_z": np.nan}}, ValueRangeError, "gravity_z"),
    ],
)
def test_wrong_arguments_are_named(block, arguments, error, message):
    with pytest.raises(error, match=message):
        simulate(block, arguments.pop("x0", np.zeros(6)), **arguments)
