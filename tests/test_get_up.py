"""A robot that lies, in a random pose at rest, gets up and stands in its balanced pose, at rest."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.continuation.schedule import on_the_way, schedule, stiffened
from octo.dynamics.static_pose import balanced_pose
from octo.errors import (
    OctoError,
    ProblemError,
    ShapeError,
    StaticPoseError,
    UsageError,
    ValueRangeError,
)
from octo.get_up import Rise, first_guesses, get_up_problems
from octo.goals import Goal
from octo.model.character import Body, Character, Joint
from octo.model.charted import charted, in_chart
from octo.model.feet import terrain_bottoms
from octo.model.kinematics import body_poses, sphere_centers
from octo.problem.limits import FrictionCones, StepLimit
from octo.result.solution import Solution

DT = 0.05
MAMMAL = octo.gallery.mammal()


@pytest.fixture(scope="module")
def risen() -> Solution:
    return octo.get_up(MAMMAL, "lying:3", dt=DT, constraints="hard", seeds=1, device="cpu")


@pytest.mark.slow
def test_it_stands_at_the_end_and_rests_at_both(risen: Solution) -> None:
    assert risen.converged
    assert Goal("up").met(risen) and Goal("up").error(risen) < 1e-3
    assert np.abs(risen.x[[0, -2]] - risen.x[[1, -1]]).max() == 0.0
    joints = MAMMAL.actuated
    assert risen.x[-1, joints] == pytest.approx(balanced_pose(MAMMAL)[joints])
    up = body_poses(MAMMAL, risen.x[[1, -1]])[0][:, MAMMAL.base_body, 2, 2]
    assert up[0] < 0.1 and up[1] > 0.999  # it lay on its side


@pytest.mark.slow
def test_limits_hold_and_no_step_leaps(risen: Solution) -> None:
    joints = MAMMAL.actuated
    moved = risen.x[1:, joints]
    assert (moved >= MAMMAL.lower[joints] - 1e-5).all()
    assert (moved <= MAMMAL.upper[joints] + 1e-5).all()
    assert (np.abs(risen.u) <= MAMMAL.torque_limit + 1e-4).all()
    assert np.abs(np.diff(risen.x[1:], axis=0)).max() <= 0.5 + 1e-6


@pytest.mark.parametrize("seed", range(10))
def test_random_poses_lie_at_rest(seed: int) -> None:
    """Low, on the ground, held by the joints alone, in a chart that is regular; the same for the
    same seed."""
    problem = get_up_problems(MAMMAL, f"lying:{seed}", dt=DT)[0]
    robot, x = problem.character, problem.start
    assert robot is not None
    still = np.repeat(x[None, None], 3, axis=1)
    force = problem.dynamics.evaluate(still, problem.p[None])[0][0, 0, robot.unactuated]
    assert np.abs(force).max() < 1e-4 * problem.weight
    base = robot.base_coordinate
    assert abs(np.sin(x[base + 4])) <= 0.87
    lowest = terrain_bottoms(robot, x).min()
    assert x[base + 2] - lowest <= 0.5 * problem.length and lowest > -0.05
    assert (x[robot.actuated] > robot.lower[robot.actuated]).all()
    assert (x[robot.actuated] < robot.upper[robot.actuated]).all()
    again = get_up_problems(MAMMAL, f"lying:{seed}", dt=DT)[0].start
    np.testing.assert_array_equal(x, again)


@pytest.mark.parametrize(("side", "faces"), [("back", 1.0), ("front", -1.0)])
def test_a_biped_lies_on_its_back_and_on_its_front_and_stands_level_in_every_pass(
    side: str, faces: float
) -> None:
    """Its first axis, which looks ahead, looks up or down. Where soft ground lets it tip over with
    its joints held, these move a little."""
    biped = octo.gallery.humanoid()
    problem = get_up_problems(biped, f"lying:{side}", dt=DT, constraints="hard")[0]
    robot = problem.character
    assert robot is not None
    assert body_poses(robot, problem.start)[0][robot.base_body, 2, 0] * faces > 0.95
    passes = [each for each in schedule(problem, None) if each is not None]
    steps = [*on_the_way(passes[0], passes[1]), *passes]
    upright = body_poses(robot, balanced_pose(robot))[0][robot.base_body, :, 2]
    for own in stiffened([problem] * len(steps), steps):
        assert own.end is not None
        for x in (own.start, own.end):
            still = np.repeat(x[None, None], 3, axis=1)
            force = own.dynamics.evaluate(still, own.p[None])[0][0, 0, robot.unactuated]
            assert np.abs(force).max() < 1e-4 * own.weight
        assert body_poses(robot, own.end)[0][robot.base_body, :, 2] @ upright > np.cos(0.011)
        moved = (own.end - balanced_pose(robot))[robot.actuated]
        assert np.abs(moved).max() < 0.05


def test_sides_of_a_level_trunk() -> None:
    problem = get_up_problems(MAMMAL, "lying:back", dt=DT)[0]
    assert problem.character is not None
    up = body_poses(problem.character, problem.start)[0][problem.character.base_body, 2, 2]
    assert up < -0.95
    with pytest.raises(StaticPoseError, match="let down on its front it does not lie"):
        get_up_problems(MAMMAL, "lying:front", dt=DT)


def test_another_chart_is_the_same_robot() -> None:
    rng = np.random.default_rng(1)
    other = charted(MAMMAL, "zxy")
    assert other.chart == "zxy" and charted(MAMMAL, "zyx") is MAMMAL
    for _ in range(5):
        x = rng.uniform(-1.0, 1.0, MAMMAL.nx)
        turned = in_chart(MAMMAL, x, "zxy")
        np.testing.assert_allclose(
            sphere_centers(other, turned), sphere_centers(MAMMAL, x), atol=1e-12
        )
        np.testing.assert_allclose(in_chart(other, turned, "zyx"), x, atol=1e-12)


def test_a_pose_on_its_nose_is_turned_by_the_other_chart() -> None:
    """Held up steeply the base falls over; where it lies its angles are regular."""
    pose = balanced_pose(MAMMAL).copy()
    pose[2], pose[4] = 0.5, 0.5 * np.pi
    problem = get_up_problems(MAMMAL, pose, dt=DT)[0]
    assert problem.character is not None
    assert abs(np.sin(problem.start[problem.character.base_coordinate + 4])) <= 0.87


def test_terms_look_at_the_robot_that_stands() -> None:
    problem = get_up_problems(MAMMAL, "lying:0", dt=DT, constraints="hard")[0]
    assert isinstance(problem, Rise)
    assert problem.length == pytest.approx(0.25, abs=0.03)
    assert len(problem.setting.feet) == 4
    cones = [one for one in problem.constraints if isinstance(one, FrictionCones)]
    assert cones and cones[0].contacts is None
    assert list(problem.priced.constraints) == [problem.constraints[-1]]
    assert isinstance(problem.constraints[-1], StepLimit)


def test_on_its_back_it_may_roll_over_both_sides_and_guesses_touch_the_ground() -> None:
    problems = get_up_problems(MAMMAL, "lying:0", dt=DT)
    first, second = (one.start[MAMMAL.base_coordinate + 5] for one in problems)
    assert abs(first - second) == pytest.approx(2.0 * np.pi)
    for problem, nodes in zip(problems, first_guesses(problems, 2), strict=True):
        assert nodes[0] == pytest.approx(problem.start) and nodes.shape == (61, MAMMAL.nx)
        assert np.abs(terrain_bottoms(MAMMAL, nodes).min(axis=1)).max() < 0.05


@pytest.mark.parametrize(
    ("pose", "kind", "text"),
    [
        ("sitting", UsageError, "must be 'lying:SEED'"),
        ("lying:x", UsageError, "must be 'lying:SEED'"),
        ("lying:-1", UsageError, "must be 'lying:SEED'"),
        (np.zeros(3), ShapeError, "pose"),
    ],
)
def test_a_pose_that_is_none_is_refused(pose: object, kind: type[OctoError], text: str) -> None:
    with pytest.raises(kind, match=text):
        octo.get_up(MAMMAL, pose)  # type: ignore[arg-type]


def test_what_cannot_get_up_is_refused() -> None:
    hinge = Joint("hinge", "hinge", np.array([0.0, 1.0, 0.0]))
    arm = Character("arm", (Body("link", -1, (hinge,), mass=1.0),), base="fixed")
    with pytest.raises(ProblemError, match="cannot get up: its base must be floating"):
        octo.get_up(arm)
    with pytest.raises(ValueRangeError, match="seconds"):
        octo.get_up(MAMMAL, seconds=-1.0)


def test_the_command_line_says_what_a_lying_pose_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", "mammal", "--goal", "up", "--pose", "lying:x"]) == 2
    assert "must be 'lying:SEED'" in capsys.readouterr().err
