"""octo.walk, stride, turn: from rest through strides to rest. What a whole walk is like,
benchmarks/cycles.py measures."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

import octo
from octo.errors import OctoError
from octo.model.kinematics import sphere_centers
from octo.motions.budget import Budget
from octo.motions.footholds import MARGIN, Laid, taut
from octo.motions.journey import Journey
from octo.motions.over import level_under, over, warn_of_its_end
from octo.motions.search import standing_as
from octo.problem.compiled import CompiledProblem
from octo.problem.hard import held
from octo.result import measure
from octo.solver.status import Status

EDGE, HIGH, WIDE = 0.5, 0.05, 0.25  # m, where a step or a gap begins, and their sizes
STEP = octo.worlds.blocks(height=HIGH, length=5.0, start=EDGE)
GAP = octo.worlds.gap(width=WIDE, start=EDGE)


@lru_cache
def walked() -> octo.Solution:
    return octo.walk(octo.gallery.mammal(), 0.4, 4.0, starts=1, period=0.6, device="cpu")


def test_it_goes_where_it_was_sent_from_rest_to_rest():
    motion = walked()
    assert motion.converged and motion.steps == 160
    travel = motion.x[-1] - motion.x[1]
    assert travel[0] == pytest.approx(1.6, abs=1e-9)
    np.testing.assert_allclose(np.delete(travel, 0), 0.0, atol=1e-9)  # the pose it stood in
    np.testing.assert_allclose(motion.x[1], motion.x[0], atol=1e-12)
    np.testing.assert_allclose(motion.x[-1], motion.x[-2], atol=1e-12)
    feet = motion.normal_force.mean(axis=0) > 0.02 * motion.weight
    assert (motion.normal_force[-1, feet] > 0.05 * motion.weight).all()


def test_a_world_that_ends_under_a_walk_is_said(caplog):
    motion, shapes = walked(), octo.shapes
    table = shapes.Box((2.0, 2.0, 1.0), position=(0.0, 0.0, -0.5))
    warn_of_its_end(octo.World([table]), motion.character, motion)
    (record,) = caplog.records
    time, x, _ = record.args
    assert x == pytest.approx(1.0, abs=0.02) and x > 1.0
    assert motion.x[1 + round(time / motion.dt), 0] == x and "the world ends" in caplog.text
    caplog.clear()
    warn_of_its_end(octo.World([table, shapes.Ground()]), motion.character, motion)
    assert not caplog.records


def test_a_taut_string_lies_on_what_is_highest():
    np.testing.assert_allclose(taut(np.array([0.0, 0.0, 3.0, 0.0, 1.0])), [0, 1.5, 3, 2, 1])
    np.testing.assert_allclose(taut(np.array([2.0, -9.0, -9.0, -1.0])), [2, 1, 0, -1])
    np.testing.assert_allclose(taut(np.array([1.0, 1.0])), [1, 1])


def test_over_level_ground_a_motion_is_what_it_was():
    ground = octo.World([octo.shapes.Ground(height=0.1)])
    nodes, own = Laid(walked(), ground, 0.0).nodes(), walked().x[1:].copy()
    own[:, walked().character.base_coordinate + 2] += 0.1
    np.testing.assert_allclose(nodes, own, atol=1e-6)


@pytest.mark.parametrize(("world", "edges"), [(STEP, [EDGE]), (GAP, [EDGE, EDGE + WIDE])])
def test_feet_are_laid_where_they_can_stand(world, edges):
    motion = walked()
    laid, robot = Laid(motion, world, 0.0), motion.character
    feet, own = (sphere_centers(robot, x)[:, laid.feet] for x in (laid.nodes(), motion.x[1:]))
    above = world.distance(feet.reshape(-1, 3)).reshape(laid.standing.shape)
    on = laid.standing
    for edge in edges:
        room = robot.contacts[laid.feet[0]].radius + MARGIN * motion.length
        assert np.abs(feet[on][:, 0] - edge).min() > 0.7 * room  # the rim is a polygon, feet creep
    # as deep as before, but where a leg does not reach
    assert np.mean(np.abs(above[on] - own[on][:, 2]) < 4e-3) > 0.98
    assert above.min() > own[..., 2].min() - 4e-3 and feet[..., 2].min() > 0.0
    rise = HIGH if world is STEP else 0.0
    np.testing.assert_allclose(feet[-1, :, 2] - own[-1, :, 2], rise, atol=4e-3)


def test_the_level_is_that_of_the_ground_where_the_robot_stands():
    for height in (0.0, -0.7):
        world = octo.World([octo.shapes.Ground(height=height)])
        own = Journey(octo.gallery.mammal(), (0.4, 0.0), 0.0, 4.0, terrain=world)
        assert level_under(own, world) == pytest.approx(height, abs=1e-5)


def up_a_step(constraints: Any, **options: Any) -> octo.Solution:
    """From the walk on level ground on."""
    flat = walked()
    journey = Journey(flat.character, (0.4, 0.0), 0.0, 4.0, terrain=STEP, constraints=constraints)
    return over(journey, STEP, Budget({"device": "cpu", **options}), lambda level: flat)


@pytest.mark.slow
def test_a_robot_walks_up_a_step():
    motion, flat = up_a_step(()), walked()
    first, travel = flat.character.base_coordinate, motion.x[-1] - motion.x[1]
    assert motion.converged and motion.iterations > flat.iterations
    assert travel[first] == pytest.approx(1.6, abs=1e-9)
    assert travel[first + 2] == pytest.approx(HIGH, abs=1e-3)
    assert motion.energy < 1.5 * flat.energy
    assert motion.gait.shortest_swing >= 0.1 - 1e-9


@pytest.mark.slow
def test_limits_over_a_world_are_priced_first_and_then_held():
    hard = held(walked().character, "hard")
    motion = up_a_step(hard, max_iterations=2)
    assert len(motion.bounds) == len(hard) and "TorqueLimit" not in motion.terms
    assert motion.iterations == walked().iterations + 4


def test_the_laws_hold_at_every_step():
    """Evaluated anew as one plain problem: the joints between the pieces too."""
    motion = walked()
    keep = {name: value for name, value in motion.parameters.items() if name.startswith("contact.")}
    problem = octo.Problem(
        motion.character,
        steps=motion.steps,
        dt=motion.dt,
        costs=[octo.Effort()],
        x0=motion.x[1],
        parameters=keep,
    )
    compiled = CompiledProblem([problem])
    at = compiled.evaluate(compiled.unknowns(motion.x[None]))
    assert measure.violations(compiled, at)[1][0] <= 2e-6 * motion.weight
    np.testing.assert_allclose(at.fd[0][:, problem.dynamics.actuated], motion.u, atol=1e-9)


def test_it_is_a_walk_that_one_would_keep():
    gait = walked().gait
    assert (
        gait.touchdowns <= 2.5
        and gait.shortest_stance >= 0.1 - 1e-9
        and gait.shortest_swing >= 0.1 - 1e-9
    )
    assert gait.clearance >= 0.015 and gait.limit_excess <= 0.01
    assert walked().slip <= 0.05 and walked().friction_use <= 1.0 and walked().torque_excess <= 1.0
    sideways = np.linalg.norm(walked().contact_force[..., :2].sum(axis=1), axis=1) / walked().weight
    assert max(sideways[:10].max(), sideways[-10:].max()) <= 0.6


def test_passes_are_those_of_the_stride():
    """What enters it has its stiffness from the beginning: one pass, in which this walk stops."""
    given = {"starts": 1, "period": 0.6, "passes": 2, "device": "cpu"}
    motion = octo.walk(octo.gallery.mammal(), 0.4, 4.0, callback=lambda at: at.passes == 1, **given)
    assert motion.status is Status.INTERRUPTED
    assert [record["converged"] for record in motion.passes] == [True, True]


def test_strides_in_the_middle_are_faster_than_the_whole():
    journey = Journey(octo.gallery.mammal(), (0.5, 0.0), 0.0, 10.0)
    count = journey.periods()[0]
    slow = 2.0 * journey.ends(count) * journey.dt
    assert journey.cycle(count).cycle.velocity * (10.0 - 0.5 * slow) == pytest.approx(0.5 * 10.0)


def test_who_strides_about_as_high_as_it_stands_keeps_its_pose():
    journey = Journey(octo.gallery.mammal(), (0.4, 0.0), 0.0, 4.0)
    joints = journey.robot.actuated
    np.testing.assert_allclose(walked().x[1, joints], journey.whole.start[joints], atol=1e-9)


@pytest.mark.slow
def test_a_spider_walks_as_high_as_its_strides_want():
    """It stands 16 cm high and strides 28 cm high: with the length and periods of the pose at rest
    it stumbled."""
    crouched = Journey(octo.gallery.spider(), (0.3, 0.0), 0.0, 4.0)
    motion = octo.walk(octo.gallery.spider(), 0.3, 4.0, seed=1, starts=1, device="cpu")
    gait = motion.gait
    assert motion.converged and motion.length > 1.4 * crouched.whole.length
    assert (
        gait.touchdowns <= 2.5
        and gait.shortest_stance >= 0.1 - 1e-9
        and gait.shortest_swing >= 0.1 - 1e-9
    )
    assert gait.torque_high <= 0.3 and gait.limit_excess <= 0.01
    # one stride of the pose at rest, the others of the higher one
    periods = [start["period"] for start in motion.starts]
    assert periods[0] == crouched.periods()[0] * crouched.dt and min(periods[1:]) > 1.3 * periods[0]


def test_the_pose_at_rest_stays_where_the_other_one_has_no_time_or_was_not_asked_for():
    journey = Journey(octo.gallery.spider(), (0.3, 0.0), 0.0, 10.0)
    strides = octo.solve(journey.cycle(journey.periods()[0]), seeds=1, device="cpu")
    assert standing_as(journey, [strides]).whole.length > 1.4 * journey.whole.length
    short = replace(journey, seconds=1.9)
    assert short.counts() and standing_as(short, [strides]) is None
    assert standing_as(replace(journey, pose=journey.whole.start), [strides]) is None
    assert standing_as(journey, []) is None
    # one whose mean pose stands on other feet is not what it rests in
    robot, x = journey.robot, strides.x.copy()
    names = [joint.name for joint in robot.joints]
    x[:, [names.index(f"front_{side}_thigh_pitch") for side in ("left", "right")]] -= 1.0
    lifted = replace(strides, x=x)
    poses = [standing_as(journey, own).whole.start for own in ([lifted, strides], [strides])]
    assert np.array_equal(*poses) and standing_as(journey, [lifted]) is None


@pytest.mark.slow
def test_what_cannot_stride_is_one_problem_and_a_line_that_says_so(caplog):
    motion = octo.walk(octo.gallery.mammal(), 0.3, 0.5, max_iterations=3, device="cpu")
    assert motion.steps == 20 and "too short" in caplog.text
    hills = octo.Terrain(lambda point, p: point[2] - 0.02 * point[0] ** 2)
    octo.walk(
        octo.gallery.mammal(), 0.3, 4.0, terrain=hills, max_iterations=3, passes=1, device="cpu"
    )
    assert "same everywhere" in caplog.text


def test_ctrl_c_keeps_strides():
    calls = []

    def stop(iterate):
        calls.append(iterate)
        return len(calls) > 5

    motion = octo.walk(
        octo.gallery.mammal(), 0.4, 4.0, starts=1, period=0.6, device="cpu", callback=stop
    )
    assert motion.status is Status.INTERRUPTED and motion.cycle is not None


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda robot: octo.walk(robot, float("nan")), "speed is not finite"),
        (lambda robot: octo.walk(robot, 0.5, -1.0), "seconds is -1.0 s, must be positive"),
        (lambda robot: octo.turn(robot, "fast"), "rate is 'fast', must be numbers"),
        (lambda robot: octo.walk(robot, 0.5, period=0.0), "period is 0.0 s, must be positive"),
    ],
)
def test_refused_in_one_line(call, words):
    with pytest.raises(OctoError) as error:
        call(octo.gallery.mammal())
    assert words in str(error.value) and "\n" not in str(error.value)
