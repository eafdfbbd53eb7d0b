"""A jump starts at rest, leaves the ground, comes down where it was asked to and stands there."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import octo
from octo.cli.main import main, parse
from octo.cli.solve import described
from octo.errors import OctoError, ProblemError, ValueRangeError
from octo.goals import Goal
from octo.jump import first_guesses, jump_problem, slide, solve_jump
from octo.model.character import Body, Character, Joint
from octo.model.kinematics import sphere_centers
from octo.problem.problem import Problem
from octo.result.solution import Solution

HEIGHT, DISTANCE, DT = 0.15, 0.2, 0.025
MAMMAL = octo.gallery.mammal()
FEET = ["front_left", "front_right", "hind_left", "hind_right"]


@pytest.fixture(scope="module")
def jumped() -> Solution:
    return octo.jump(MAMMAL, HEIGHT, DISTANCE, dt=DT, seeds=2, seed=3, device="cpu")


def test_it_converges_and_meets_its_goal(jumped: Solution) -> None:
    assert jumped.converged
    assert Goal("jump", height=HEIGHT, distance=DISTANCE).error(jumped) < 0.05
    assert [record["seed"] for record in jumped.starts] == [3, 4] and jumped.seed in (3, 4)
    assert jumped.torque_excess <= 1.0
    assert jumped.gait is not None and jumped.gait.limit_excess <= 0.01  # type: ignore[operator]


def test_it_flies_lands_and_stands(jumped: Solution) -> None:
    """Every load is zero in the air; before and after it the feet alone carry the robot, all of
    them at the end."""
    load = jumped.normal_force / jumped.weight  # (N, c)
    rise = np.sqrt(2.0 * HEIGHT / 9.81)
    from_top = np.abs(jumped.times[1:] - jumped.dt * (jumped.steps // 2))
    assert load[from_top < 0.8 * rise].max() < 1e-3
    assert (load.sum(axis=1)[from_top > 1.4 * rise] > 0.2).all()
    others = [k for k, name in enumerate(jumped.contact_names) if name not in FEET]
    assert load[:, others].max() < 0.05
    assert load[-1].sum() == pytest.approx(1.0, abs=1e-3)
    assert np.sum(load[-1] > 0.1) == 4
    assert load.sum(axis=1).max() < 4.0


def test_both_ends_are_the_static_pose_of_the_last_pass(jumped: Solution) -> None:
    problem = jump_problem(MAMMAL, HEIGHT, DISTANCE, dt=DT)
    stiff = {
        name: jumped.parameters[name]
        for name in ("contact.w_perp", "contact.w_par", "contact.onset")
    }
    last = problem.replace(parameters=stiff)
    assert abs(last.start - problem.start).max() > 1e-3  # else this says nothing
    moved = np.zeros(MAMMAL.nx)
    moved[slide(MAMMAL, 0)] = DISTANCE
    np.testing.assert_allclose(jumped.x[:2], np.stack([last.start] * 2), atol=1e-9)
    np.testing.assert_allclose(jumped.x[-2:], np.stack([last.start + moved] * 2), atol=1e-6)


def test_the_first_guess_leaves_the_ground_and_keeps_its_footholds() -> None:
    problem = jump_problem(MAMMAL, HEIGHT, DISTANCE, dt=DT)
    guesses = first_guesses(problem, 3)
    assert guesses.shape == (3, problem.steps + 1, MAMMAL.nx)
    touching = [MAMMAL.contact_index(name) for name in FEET]
    feet = (
        sphere_centers(MAMMAL, guesses)[:, :, touching]
        - sphere_centers(MAMMAL, problem.start)[touching]
    )
    rise = np.sqrt(2.0 * HEIGHT / 9.81)
    from_top = DT * (np.arange(problem.steps + 1) - problem.steps // 2)
    before, after, top = from_top < -rise, from_top > rise, from_top == 0.0
    np.testing.assert_allclose(feet[:, before], 0.0, atol=0.04)  # 2 cm of noise in the joints
    np.testing.assert_allclose(feet[:, after] - [DISTANCE, 0.0, 0.0], 0.0, atol=0.04)
    assert feet[:, top, :, 2].min() > HEIGHT
    depth = guesses[:, :, slide(MAMMAL, 2)].min(axis=1) - problem.start[slide(MAMMAL, 2)]
    np.testing.assert_allclose(depth / problem.length, [-0.4, -0.3, -0.5], atol=0.05)


def test_a_given_length_has_its_top_in_the_middle() -> None:
    problem = jump_problem(MAMMAL, HEIGHT, DISTANCE, seconds=3.0, dt=DT)
    assert problem.steps == 120
    (top,) = np.flatnonzero(problem.costs[0].weight)
    assert (problem.costs[0].label, top + 1) == ("Top", 60)
    short = jump_problem(MAMMAL, HEIGHT, DISTANCE, seconds=1.2, dt=DT)
    np.testing.assert_allclose(first_guesses(short, 1)[0, 0], short.start)


def test_on_a_slope_it_lands_higher() -> None:
    terrain = octo.Plane(slope=0.1)
    problem = jump_problem(MAMMAL, HEIGHT, DISTANCE, dt=DT, terrain=terrain)
    assert problem.displacement is not None
    assert problem.displacement[slide(MAMMAL, 2)] == pytest.approx(DISTANCE * np.tan(0.1), abs=1e-3)


REFUSED: dict[str, tuple[Callable[[], object], type[OctoError], str]] = {
    "height": (
        lambda: octo.jump(MAMMAL, height=0.0),
        ValueRangeError,
        "height is 0.0 m, must be positive",
    ),
    "distance": (
        lambda: octo.jump(MAMMAL, distance=np.inf),
        ValueRangeError,
        "distance is not finite",
    ),
    "seconds": (
        lambda: octo.jump(MAMMAL, seconds=0.5),
        ValueRangeError,
        "seconds is 0.5, a jump of 0.2 m takes at least 0.98 s",
    ),
    "seeds": (
        lambda: octo.jump(MAMMAL, seeds=0),
        ValueRangeError,
        "seeds is 0, must be a whole number of at least 1",
    ),
    "another problem": (
        lambda: solve_jump(Problem(MAMMAL, steps=10, dt=DT, costs=[octo.Effort()])),
        ProblemError,
        "the problem has no term 'Top'",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str) -> None:
    call, error, message = REFUSED[name]
    with pytest.raises(error, match=message):
        call()


def test_what_cannot_jump() -> None:
    hinge = Joint("hinge", "hinge", np.array([0.0, 1.0, 0.0]))
    arm = Character("arm", (Body("link", -1, (hinge,), mass=1.0),), base="fixed")
    with pytest.raises(ProblemError, match="robot 'arm' cannot jump"):
        octo.jump(arm)


# -- the command line ------------------------------------------------------------------------------


def test_octo_solve_jumps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command hands over a jump of the size it was asked for, and reports how near it came."""
    asked = []

    def solve(problem: Problem, **options: object) -> Solution:
        asked.append(problem)
        return solve_jump(problem, **{**options, "passes": 1, "progress": False})  # type: ignore[arg-type]

    monkeypatch.setattr(sys.modules["octo.jump"], "solve_jump", solve)
    size = ["--height", str(HEIGHT), "--distance", str(DISTANCE), "--dt", str(DT)]
    assert (
        main(
            ["solve", "mammal", "--goal", "jump", *size, "--device", "cpu", "--out", str(tmp_path)]
        )
        == 0
    )
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["goal"] == "jump" and report["goal_met"] and report["goal_error"] < 0.05
    (problem,) = asked
    assert problem.steps == jump_problem(MAMMAL, HEIGHT, DISTANCE, dt=DT).steps == report["steps"]


def test_octo_solve_refuses_a_jump_in_splines() -> None:
    words = parse(["solve", "mammal", "--goal", "jump", "--basis", "hermite"])
    with pytest.raises(ProblemError, match="a jump is solved in the nodes basis"):
        described(MAMMAL, Goal("jump"), None, words)
