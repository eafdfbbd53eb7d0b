"""A step in which a coordinate leaps is said in the result, whatever the solver thinks of it."""

from __future__ import annotations

import json

import casadi as ca
import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.errors import OctoError
from octo.model.gallery import chain, mammal
from octo.result.solution import Solution
from octo.solve import evaluated
from octo.solver.status import Status


def pendulum(x_next, x, x_prev, p):
    """0.05 kg m², 1 N m at the horizontal; hanging and standing on its head it is at rest."""
    return 0.05 * (x_next - 2 * x + x_prev) / p["dt"] ** 2 + ca.sin(x_next)


def motion(x, dt: float = 0.05, model=None) -> Solution:
    """A given motion x_0 … x_N (N+1, nx) of free unit masses as a result."""
    x = np.asarray(x, dtype=float)
    free = octo.CustomDynamics(
        lambda a, b, c, p: (a - 2 * b + c) / p["dt"] ** 2, x.shape[1], [0], {}
    )
    given = octo.Problem(model or free, steps=len(x) - 1, dt=dt, x0=x[0], costs=[octo.Effort()])
    return evaluated(given, x, Status.CONVERGED)


def test_the_leap_of_a_solve_that_converges_is_said(tmp_path):
    """From hanging to 3.1 rad in four long steps."""
    model = octo.CustomDynamics(pendulum, 1, [0], {})
    target = octo.PoseTarget(target=[3.1], weight=100.0)
    costs = [target, octo.Effort()]
    problem = octo.Problem(model, steps=2, dt=2.0, x0=[0.0], costs=costs, step_limit=None)
    solution = octo.solve(problem, device="cpu")
    assert solution.converged
    assert "by more than 1 rad or m (x0 by " in str(solution) and "take a smaller dt" in str(
        solution
    )
    report = solution.report()
    assert report["largest_step"]["change"] > 1.0 and report["largest_step"]["leaps"] >= 1
    assert report["warnings"] == list(solution.warnings) and len(report["warnings"]) == 1
    json.dumps(report, allow_nan=False)
    solution.save(tmp_path / "leap.npz")
    assert Solution.load(tmp_path / "leap.npz").warnings == solution.warnings


LEAPS = {
    "one": (
        [[0.0], [0.2], [np.pi + 0.2], [np.pi]],
        1,
        "one step changes a coordinate",
        0.05,
        np.pi,
    ),
    "back": ([[0.0], [-1.5], [0.0], [0.3]], 2, "2 steps change a coordinate", 0.0, 1.5),
    "second coordinate": (
        [[0.0, 0.0], [0.1, 0.0], [0.2, 7.0]],
        1,
        r"\(x1 by 7 rad or m",
        0.05,
        7.0,
    ),
    "first step": ([[0.0], [1.01], [1.2]], 1, "one step", 0.0, 1.01),
    "last step": ([[0.0], [0.1], [0.2], [1.3]], 1, "at 0.1 s", 0.1, 1.1),
}


@pytest.mark.parametrize("what", LEAPS)
def test_where_and_how_far(what):
    x, count, said, time, change = LEAPS[what]
    solution = motion(x)
    largest = solution.report()["largest_step"]
    assert largest["leaps"] == count and largest["time"] == pytest.approx(time)
    assert largest["change"] == pytest.approx(change)
    with pytest.raises(AssertionError, match=said):
        raise AssertionError(str(solution))


def test_steps_of_a_radian_and_less_are_not_said():
    for x in ([[0.0], [1.0], [2.0]], [[0.0], [0.1], [0.2]], [[5.0], [5.0]]):
        assert motion(x).warnings == ()


def test_units_of_a_robot():
    """A slide of the base by 2 m, then its yaw by 2 rad."""
    robot = mammal()
    for coordinate, unit in ((0, "m"), (3, "rad")):
        x = np.repeat(robot.default_pose[None], 4, axis=0)
        x[2:, coordinate] += 2.0
        solution = motion(x, model=robot)
        name = robot.joints[coordinate].name
        assert f"({name} by 2 {unit} at 0.05 s)" in str(solution)


def test_numbers_that_are_not_finite_are_no_leap():
    assert motion([[0.0], [0.1]]).report()["largest_step"]["change"] == pytest.approx(0.1)
    broken = motion([[0.0], [0.1], [0.2]])
    broken.x[2] = np.nan
    assert broken.report()["largest_step"] is None and broken.warnings == ()


@pytest.mark.parametrize("dt", [25.0, 1.5, 1e6, np.inf, np.nan, 0.0, -0.1, "long", None])
def test_a_dt_that_no_robot_moves_by_is_refused(dt):
    robot = mammal()
    for make in (
        lambda: octo.Problem(robot, steps=4, dt=dt, x0=robot.default_pose, costs=[octo.Effort()]),
        lambda: octo.simulate(robot, robot.default_pose, steps=2, dt=dt),
        lambda: octo.jump(robot, dt=dt),
    ):
        with pytest.raises(OctoError, match="dt is"):
            make()


def test_a_dt_longer_than_the_fall_of_the_robot_is_said():
    robot = chain()
    x = np.repeat(robot.default_pose[None], 3, axis=0)
    assert "this robot falls by half its height: take a smaller dt" in str(motion(x, 0.6, robot))
    assert motion(x, 0.025, robot).warnings == ()


def test_a_user_s_own_units_of_time_are_theirs():
    free = octo.CustomDynamics(lambda a, b, c, p: (a - 2 * b + c) / p["dt"] ** 2, 1, [0], {})
    assert octo.Problem(free, steps=4, dt=25.0, x0=[0.0], costs=[octo.Effort()]).dt == 25.0


@pytest.mark.parametrize("command", ["solve", "simulate", "compare"])
def test_the_shell_refuses_it_too(command, tmp_path, capsys):
    out = ["--json", str(tmp_path / "a.json")] if command == "compare" else ["--out", str(tmp_path)]
    assert main([command, "mammal", "--dt", "25", "--seconds", "100", *out]) == 2
    assert "dt is 25.0 s, must be at most 1 s" in capsys.readouterr().err
