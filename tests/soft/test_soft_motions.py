"""A soft body jumps, rolls and crawls; what is kept, told and refused."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from soft.clouds import cloud

import octo
from octo import errors, soft
from octo.result.solution import Solution
from octo.soft_motions import soft_course

G = 9.81  # m/s²
SECONDS, DT = 1.5, 0.025


@lru_cache
def moved(task: str) -> Solution:
    """A motion of a body of 60 points and 4 modes."""
    given = {"jump": (-0.2, 0.1), "roll": (0.3, None), "crawl": (0.05, None)}[task]
    how = {"height": given[1], "seconds": SECONDS, "dt": DT, "device": "cpu"}
    return octo.soft_motion(cloud(4, 60), task, given[0], limit=200.0, **how)


@pytest.mark.parametrize("task", ["jump", "roll", "crawl"])
def test_it_gets_there_within_the_motors_limits_and_rests(task: str) -> None:
    motion = moved(task)
    assert motion.converged, motion.sentence
    (asked,) = motion.asked
    assert asked.met, str(asked)
    assert np.abs(motion.u).max() <= 200.0 * (1.0 + 1e-6)
    assert np.abs(motion.v[-1, :3]).max() < 0.05
    flying = 1.0 - motion.loaded.any(axis=1).mean()
    assert flying > 0.1 if task == "jump" else flying < 0.05


def test_a_ball_rolls_without_slipping_much() -> None:
    """The innermost angle grows by the way over the height of the centre."""
    motion = moved("roll")
    turned = motion.x[-1, 5] - motion.x[1, 5]
    assert turned == pytest.approx(0.3 / motion.x[1, 2], rel=0.25)


def test_contacts_carry_the_weight_where_it_rests() -> None:
    motion = moved("jump")
    force = motion.contact_force[-1].sum(axis=0)
    np.testing.assert_allclose(force, [0.0, 0.0, motion.weight], atol=0.05 * motion.weight)
    np.testing.assert_allclose(motion.contact_normal - [0.0, 0.0, 1.0], 0.0, atol=1e-12)


def test_contacts_are_what_the_rows_of_the_frame_need() -> None:
    """m ẍ − mg of every step, which nothing but the ground can give; where no vertex touches, the
    flight is a parabola."""
    motion = moved("jump")
    mass, place = motion.weight / G, motion.x[:, :3]
    acceleration = (place[2:] - 2.0 * place[1:-1] + place[:-2]) / motion.dt**2
    needed = mass * (acceleration + [0.0, 0.0, G])
    np.testing.assert_allclose(motion.contact_force.sum(axis=1), needed, atol=1e-3)
    assert (np.abs(needed[~motion.loaded.any(axis=1)]) < 0.01 * motion.weight).all()


def test_the_surface_is_where_the_contacts_are() -> None:
    motion = moved("crawl")
    assert motion.soft is not None
    points = motion.soft.surface(motion.x)
    chosen = [int(name.removeprefix("vertex_")) for name in motion.contact_names]
    np.testing.assert_allclose(motion.contact_point, points[2:, chosen], atol=1e-12)
    speed = np.diff(points[1:, chosen], axis=0) / motion.dt
    np.testing.assert_allclose(motion.contact_velocity, speed, atol=1e-9)
    np.testing.assert_allclose(motion.contact_depth, -points[2:, chosen, 2], atol=1e-12)


@pytest.mark.parametrize("chart", ["zyx", "zxy"])
def test_the_surface_of_either_chart_is_that_of_the_dynamics(chart: str) -> None:
    """By octo.soft.nodes, whose rotations come from the chart's own expression."""
    from octo.soft.nodes import Nodes

    dynamics = soft.SoftDynamics(cloud(4, 60), chart=chart)
    x = np.random.default_rng(0).normal(size=(5, 10))
    turn, _, surface = dynamics._stages
    wanted = surface.places(Nodes.of(dynamics.moments, turn, x))
    np.testing.assert_allclose(dynamics.coordinates.surface(x), wanted, atol=1e-12)


def test_a_motion_says_whose_it_is_and_how_it_went() -> None:
    motion = moved("jump")
    base = "base_x base_y base_z base_yaw base_pitch base_roll"
    assert motion.joint_names[:6] == tuple(base.split())
    assert motion.actuated_names == ("mode_1", "mode_2", "mode_3", "mode_4")
    problem = soft_course(cloud(4, 60), "jump").problem
    assert repr(problem).startswith("Problem of cloud: ")
    text = str(motion)
    (bound,) = motion.bounds
    assert bound.row.startswith("mode_") and bound.held
    assert text.startswith("cloud, ") and "it sinks" in text and "in the air for" in text
    report = motion.report()
    assert report["robot"] == "cloud" and report["com_travel"][0] == pytest.approx(-0.2, abs=0.02)


def test_a_motion_is_read_as_it_was_written(tmp_path: Path) -> None:
    for given, name in ((moved("jump"), "a.npz"), (bent(), "b.npz")):
        given.save(tmp_path / name)
        read = Solution.load(tmp_path / name)
        assert read.soft is not None and given.soft is not None
        np.testing.assert_array_equal(read.soft.surface(read.x), given.soft.surface(given.x))
        np.testing.assert_array_equal(read.contact_force, given.contact_force)
        assert read.actuated_names == given.actuated_names and read.soft.chart == given.soft.chart
        assert (read.soft.body.stvk is None) == (given.soft.body.stvk is None)
        again = soft.SoftDynamics(read.soft.body)  # it can be solved on
        assert again.nx == given.x.shape[1]


@lru_cache
def bent() -> Solution:
    """Of a body with St. Venant–Kirchhoff's energy and two motors, that nobody solved."""
    body = cloud(4, 60, bent=True)
    dynamics = soft.SoftDynamics(body, chart="zxy", actuated=[2, 0])
    x0 = dynamics.rest(dynamics.layout.pack())
    given = {"steps": 4, "dt": 0.025, "costs": [octo.Effort()], "x0": x0}
    return octo.solve(octo.Problem(dynamics, **given), max_iterations=2, device="cpu")


def test_a_damaged_body_is_one_line(tmp_path: Path) -> None:
    moved("jump").save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        arrays = {name: file[name] for name in file.files}
    for name, value, said in (
        ("soft_modes", arrays["soft_modes"][:-1], "modes"),
        ("soft_faces", np.array([0, 1]), "faces has 2 corners"),
        ("soft_points", arrays["soft_points"] * np.nan, "points is not finite"),
    ):
        np.savez(tmp_path / "b.npz", **{**arrays, name: value})
        with pytest.raises(errors.RobotFileError, match=said):
            Solution.load(tmp_path / "b.npz")


def test_where_it_ends_is_as_deep_in_the_ground_as_where_it_began() -> None:
    terrain = octo.Terrain(
        lambda point, p: point[2] - 0.05 * (1.0 + ca.tanh(60.0 * point[0] - 18.0))
    )
    course = soft_course(cloud(4, 60), "crawl", 0.6, terrain=terrain)
    end = next(term for term in course.problem.costs if term.label == "End")
    rise = end.values["target"][2] - course.problem.start[2]
    assert rise == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize(
    ("given", "kind", "said"),
    [
        ({"task": "fly"}, errors.UnknownNameError, "task 'fly' is not known"),
        ({"distance": 1e4}, errors.ValueRangeError, "distance is 10000 m, must be at most"),
        ({"distance": np.nan}, errors.OctoError, "distance"),
        ({"height": -1.0}, errors.ValueRangeError, "height"),
        ({"height": 0.1, "task": "roll"}, errors.ProblemError, "height is 0.1, must be left out"),
        ({"seconds": 1.51}, errors.ValueRangeError, "must be whole"),
        ({"seconds": 0.1}, errors.ValueRangeError, "must be at least 8 steps"),
        ({"limit": 0.0}, errors.ValueRangeError, "limit"),
        ({"body": "ball"}, errors.ProblemError, "octo.soft.Body"),
        ({"seeds": 0}, errors.ValueRangeError, "seeds"),
    ],
)
def test_what_is_not_possible_is_one_line(given: dict, kind: type, said: str) -> None:
    with pytest.raises(kind, match=said):
        octo.soft_motion(**{"body": cloud(4, 60), "device": "cpu", **given})


def test_a_replay_in_shorter_steps_follows_the_plan_and_better_with_springs() -> None:
    body = soft.ball(divisions=2, modes=4)
    plan = octo.soft_motion(body, "roll", 0.5, seconds=1.5, dt=0.0125, device="cpu")
    off = {}
    for stiffness in (0.0, 3000.0):
        played = octo.soft_replay(plan, times=5, stiffness=stiffness, damping=0.01 * stiffness)
        assert played.converged.all() and played.dt == pytest.approx(plan.dt / 5)
        off[stiffness] = np.linalg.norm(played.x[1::5, :3] - plan.x[1:, :3], axis=1).max()
    assert off[3000.0] < 0.6 * off[0.0]
    same = octo.soft_replay(plan, times=1, stiffness=0.0, damping=0.0)  # to the plan's tolerance
    np.testing.assert_allclose(same.x[:5], plan.x[:5], atol=1e-3)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"times": 0}, "times"),
        ({"stiffness": -1.0}, "must be at least 0"),
        ({"dynamics": "ball"}, "SoftDynamics"),
        ({"plan": "ball"}, "Solution"),
    ],
)
def test_a_replay_that_is_not_possible_is_one_line(given: dict, said: str) -> None:
    with pytest.raises(errors.OctoError, match=said):
        octo.soft_replay(**{"plan": moved("roll"), **given})


def test_a_replay_is_of_the_same_body_and_ground() -> None:
    plan = moved("roll")
    body = plan.soft.body if plan.soft is not None else cloud(4, 60)
    with pytest.raises(errors.ProblemError, match="another body, chart or other motors"):
        octo.soft_replay(plan, soft.SoftDynamics(body))  # its chart is zyx
    terrain = octo.Terrain(lambda point, p: point[2] - p["h"], {"h": 0.0})
    with pytest.raises(errors.ProblemError, match="another law or ground"):
        octo.soft_replay(plan, soft.SoftDynamics(body, terrain=terrain, chart="zxy"))


def test_a_ball_that_rolls_heads_on() -> None:
    motion = moved("roll")
    assert np.abs(motion.yaw).max() < 0.5 and np.abs(motion.x[1:, 5]).max() > 1.0


def test_the_radius_of_a_roll_is_over_the_ground() -> None:
    high = octo.Terrain(lambda point, p: point[2] - 1.0)
    low, up = (soft_course(cloud(4, 60), "roll", 0.3, terrain=own) for own in (None, high))
    guesses = [course.guess(0) for course in (low, up)]
    lifted = np.broadcast_to(np.eye(10)[2], guesses[0].shape)
    np.testing.assert_allclose(guesses[1] - guesses[0], lifted, atol=1e-6)
    assert np.ptp(guesses[0][:, 5]) == pytest.approx(0.3 / 0.148, rel=0.1)


def test_where_there_is_no_ground_is_refused() -> None:
    table = octo.World([octo.shapes.Box((1.0, 1.0, 0.2), position=(0.0, 0.0, -0.1))])
    with pytest.raises(errors.StaticPoseError, match="there is no ground to lie on at x = 5"):
        soft_course(cloud(4, 60), "crawl", 5.0, terrain=table)


def test_phases_of_one_body_are_joined() -> None:
    """Each knows other vertices; the whole has all of them."""
    body = cloud(4, 60)
    first = soft_course(body, "jump", -0.1, seconds=0.5).problem
    low = first.replace(costs=[octo.Effort()], constraints=[])
    both = octo.solve(octo.phases([low, low.replace(x0=None)]), max_iterations=2, device="cpu")
    assert both.soft is not None and both.name == "cloud"
    assert both.contact_force.shape == (40, len(both.contact_names), 3)
    one, other = both.phases
    for k, axis in enumerate("xy"):  # the ground is under all of it
        assert (
            both.ground[axis][0] < both.x[:, k].min() <= both.x[:, k].max() < both.ground[axis][-1]
        )
    np.testing.assert_allclose(both.ground["z"], 0.0, atol=1e-9)
    for k, name in enumerate(both.contact_names):
        for phase, part in ((one, slice(0, 20)), (other, slice(20, 40))):
            own = np.zeros((20, 3))
            if name in phase.contact_names:
                own = phase.contact_force[:, phase.contact_names.index(name)]
            np.testing.assert_array_equal(both.contact_force[part, k], own)
    with pytest.raises(errors.ProblemError, match="phase 1 is of"):
        other = soft_course(cloud(5, 60, size=0.2), "jump", -0.1).problem
        octo.phases([low, other.replace(x0=None, constraints=[])])


def test_films_show_it_and_skeletons_do_not(tmp_path: Path) -> None:
    with pytest.raises(errors.ModelError, match="a soft body has no joints"):
        octo.export(moved("roll"), tmp_path / "a.bvh")
    pytest.importorskip("imageio_ffmpeg")
    body = soft.ball(divisions=2, modes=4)
    motion = octo.soft_motion(body, "crawl", 0.05, seconds=0.5, device="cpu", max_iterations=5)
    octo.export(motion, tmp_path / "a.gif", fps=10)
    assert (tmp_path / "a.gif").stat().st_size > 5000
