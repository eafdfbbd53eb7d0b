"""What octo says of a robot, what it reads back of what it wrote, and the lengths of what it
returns."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.errors import OctoError, RobotFileError
from octo.mpc import Controller, Log, walking_problem

URDF = """<robot name="pendulum"><link name="base"/>
<link name="rod"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
<inertia ixx="0.1" iyy="0.2" izz="0.3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="2.5" effort="7" velocity="3"/></joint></robot>"""


@pytest.fixture(scope="module")
def solution() -> octo.Solution:
    robot = octo.gallery.chain()
    return octo.solve(
        octo.Problem(robot, steps=6, dt=0.02, costs=[octo.Effort()]), passes=1, max_iterations=3
    )


@pytest.fixture(scope="module")
def log() -> Log:
    """Three ticks of a robot that stands, in octo's own simulation."""
    robot = octo.gallery.mammal()
    problem = walking_problem(robot, 6, 0.04)
    plant = octo.plant.SimulatorPlant(robot, law=problem.law)
    plant.reset_chart(problem.start)
    return octo.mpc.run(Controller(problem), plant, 0.03)


@pytest.fixture
def folders(solution: octo.Solution, log: Log, tmp_path: Path) -> Path:
    """Folders as `octo solve` and `octo mpc` leave them."""
    for name in ("plan", "loop"):
        (tmp_path / name).mkdir()
    solution.save(tmp_path / "plan" / "solution.npz")
    log.save(tmp_path / "loop" / "log.npz")
    return tmp_path


# -- octo info and robot.summary() ---------------------------------------------------------------


def pendulum(folder: Path) -> octo.Character:
    pytest.importorskip("mujoco")
    (folder / "pendulum.urdf").write_text(URDF)
    return octo.load(folder / "pendulum.urdf", "fixed")


def test_limits_and_inertia_of_a_file(tmp_path: Path) -> None:
    values = octo.describe(pendulum(tmp_path))
    (joint,) = values["joints"]
    found = {
        name: joint[name]
        for name in ("name", "kind", "lower", "upper", "torque_limit", "velocity_limit")
    }
    assert found == {
        "name": "pivot",
        "kind": "hinge",
        "lower": -1.5,
        "upper": 2.5,
        "torque_limit": 7.0,
        "velocity_limit": 3.0,
    }
    assert joint["actuated"]
    rod = values["links"][-1]
    assert rod["mass"] == 2.0 and np.allclose(rod["com"], [0.0, 0.0, -0.5])
    assert np.allclose(rod["inertia"], np.diag([0.1, 0.2, 0.3]))
    assert values["height"] is None and values["units"]["torque of a hinge"] == "N m"


def test_the_summary_names_what_it_lists(tmp_path: Path) -> None:
    words = str(pendulum(tmp_path).summary())
    row = next(line for line in words.splitlines() if line.startswith("pivot"))
    assert row.split()[1:6] == ["rad", "-1.5", "2.5", "3", "7"]
    for unit in ("rad/s", "N m", "kg m²", "kg", "m of a slide"):
        assert unit in words


@pytest.mark.parametrize("name", sorted(octo.gallery.CHARACTERS))
def test_summaries_of_the_gallery(name: str) -> None:
    robot = octo.load(name)
    words = robot.summary()
    assert repr(words) == str(words)  # what a session shows is what print shows
    for joint in robot.joints:
        assert re.search(rf"^{re.escape(joint.name)} ", words, re.M)
    for body in robot.bodies:
        assert re.search(rf"^{re.escape(body.name)} ", words, re.M)


def test_height_and_inertia_of_the_whole_are_those_of_the_default_pose() -> None:
    robot = octo.gallery.mammal()
    assert robot.default_pose is not None
    values, pose = octo.describe(robot), np.asarray(robot.default_pose)
    centers = octo.kinematics.sphere_centers(robot, pose)[list(robot.terrain_contacts), 2]
    lowest = (centers - [robot.contacts[k].radius for k in robot.terrain_contacts]).min()
    base = octo.kinematics.body_poses(robot, pose)[1][robot.base_body, 2]
    assert values["height"] == pytest.approx(base - lowest)
    inertia = np.array(values["inertia"])
    assert np.allclose(inertia, inertia.T) and (np.linalg.eigvalsh(inertia) > 0.0).all()
    rods = sum(body.mass * 0.01**2 for body in robot.bodies)
    assert np.trace(inertia) > rods and values["poses"]["default"] == pytest.approx(pose)


def test_info_of_a_robot_is_the_summary_and_plain_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "biped"]) == 0
    assert capsys.readouterr().out.rstrip("\n") == str(octo.gallery.biped().summary())
    for words in (["info", "biped", "--json"], ["robots", "--json"]):
        assert main(words) == 0
        text = capsys.readouterr().out
        assert "Infinity" not in text and "NaN" not in text
        values = json.loads(text)
        assert (values if words[0] == "info" else values["biped"])["joints"][0]["lower"] is None


# -- what octo wrote, by its folder ---------------------------------------------------------------


def test_a_folder_is_read_as_its_file(folders: Path, solution: octo.Solution, log: Log) -> None:
    assert np.array_equal(octo.Solution.load(folders / "plan").x, solution.x)
    assert np.array_equal(Log.load(folders / "loop").x, log.x)


def test_a_log_that_was_read_says_what_it_said(folders: Path, log: Log) -> None:
    again = Log.load(str(folders / "loop" / "log.npz"))
    assert str(again) == str(log) and again.report() == log.report() and again.controller is None
    assert str(again.solution()) == str(log.solution())
    assert len(repr(again).splitlines()) <= 5 and again._repr_html_().startswith("<table>")
    again.save(folders / "again.npz")
    assert Log.load(folders / "again.npz").report() == log.report()


@pytest.mark.parametrize(
    "words",
    [["info", "plan"], ["info", "plan/solution.npz"], ["info", "loop"], ["info", "loop", "--json"]],
)
def test_info_of_a_folder(
    folders: Path, words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    monkeypatch.chdir(folders)
    assert main(words) == 0
    assert (
        "chain" if "plan" in words[1] else "falls"
    ) in capsys.readouterr().out or "mammal" in words


@pytest.mark.parametrize(
    ("source", "target"),
    [("plan", "a.csv"), ("loop", "b.csv"), ("loop/log.npz", "c.csv"), ("plan", "d.png")],
)
def test_view_of_a_folder(
    folders: Path, source: str, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folders)
    assert main(["view", source, "--out", target]) == 0
    assert (folders / target).stat().st_size > 100


def test_pictures_take_paths_and_logs(folders: Path, log: Log) -> None:
    pytest.importorskip("matplotlib")
    assert octo.plot(folders / "plan").axes
    assert octo.filmstrip(folders / "loop", moments=2).axes
    assert octo.filmstrip(log, moments=2).axes  # type: ignore[arg-type]


def test_a_start_in_python_may_be_a_path(folders: Path, solution: octo.Solution) -> None:
    problem = octo.Problem(octo.gallery.chain(), steps=6, dt=0.02, costs=[octo.Effort()])
    options: dict[str, Any] = {"passes": 1, "max_iterations": 2}
    found = octo.solve(problem, start=folders / "plan", **options)
    assert np.array_equal(found.x, octo.solve(problem, start=solution, **options).x)
    both = octo.solve(
        [problem, problem], start=[str(folders / "plan" / "solution.npz"), None], **options
    )
    assert np.array_equal(both[0].x[:2], found.x[:2]) and not np.array_equal(both[1].x, found.x)
    with pytest.raises(RobotFileError, match="does not exist"):
        octo.solve(problem, start="nowhere.npz")


def test_a_gallery_name_is_a_robot_also_beside_a_folder_of_that_name(
    folders: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (folders / "plan").rename(folders / "biped")
    monkeypatch.chdir(folders)
    assert main(["info", "biped"]) == 0 and capsys.readouterr().out.startswith("name      biped")
    assert main(["info", "./biped"]) == 0 and capsys.readouterr().out.startswith("chain, 6 steps")


def test_a_start_may_be_a_folder(folders: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "solve",
        "chain",
        "--costs",
        "paper",
        "--seconds",
        "0.12",
        "--dt",
        "0.02",
        "--passes",
        "1",
        "--max-iterations",
        "2",
    ]
    assert main([*words, "--start", str(folders / "plan"), "--out", str(folders / "out")]) == 1
    assert (folders / "out" / "solution.npz").is_file()


REFUSED = {
    "a log as a plan": (
        lambda f: octo.Solution.load(f / "loop"),
        "holds no solution.npz",
        "log.npz",
    ),
    "a plan as a log": (lambda f: Log.load(f / "plan"), "holds no log.npz", "solution.npz"),
    "an empty folder": (
        lambda f: octo.Solution.load(f / "none"),
        "holds no solution.npz",
        "nothing",
    ),
    "a file of a plan as a log": (lambda f: Log.load(f / "plan" / "solution.npz"), "is not a log"),
    "no file": (lambda f: Log.load(f / "nowhere.npz"), "does not exist"),
    "a robot": (lambda f: Log.load(octo.gallery.chain()), "path is a Character"),  # type: ignore[arg-type]
    "a long name": (lambda f: octo.Solution.load("x" * 5000), "is not a solution"),
    "nothing": (lambda f: octo.Solution.load(None), "path is None"),  # type: ignore[arg-type]
    "text": (lambda f: Log.load(f / "text.npz"), "is not a log"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_there_is_said(folders: Path, name: str) -> None:
    (folders / "none").mkdir()
    (folders / "text.npz").write_text("hello")
    call, *fragments = REFUSED[name]
    with pytest.raises(RobotFileError) as caught:
        call(folders)  # type: ignore[operator]
    for fragment in fragments:
        assert str(fragment) in str(caught.value)


@pytest.mark.parametrize("name", ["plot", "view", "filmstrip", "replay"])
def test_pictures_of_something_else_are_refused(name: str) -> None:
    with pytest.raises(OctoError, match="solution is a Character, must be a Solution"):
        getattr(octo, name)(octo.gallery.chain())


def test_info_of_a_long_name_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "x" * 5000 + ".npz"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_cut_log_is_one_line(folders: Path) -> None:
    whole = (folders / "loop" / "log.npz").read_bytes()
    for part in (0, 10, len(whole) // 2, len(whole) - 5):
        (folders / "cut.npz").write_bytes(whole[:part])
        with pytest.raises(RobotFileError, match="is not a log"):
            Log.load(folders / "cut.npz")


def spoiled(path: Path, **changes: Any) -> Path:
    """A log with other arrays, or with other entries of its JSON."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    plain = json.loads(str(arrays.pop("log")))
    arrays.update({name: value for name, value in changes.items() if name in arrays})
    plain.update({name: value for name, value in changes.items() if name not in arrays})
    np.savez(path, **arrays, log=np.array(json.dumps(plain)))
    return path


WORLD = {"weight": 50.0, "length": 0.3, "normal": [0.0, 0.0, 1.0], "height": 0.0}
LOGS: dict[str, tuple[dict[str, Any], str]] = {
    "fewer rows": ({"u": np.zeros((1, 12))}, "u has shape (1, 12), expected (3, 12)"),
    "words for numbers": ({"seconds": np.array(["a", "b", "c"])}, "must be numbers"),
    "a time that is none": ({"t": np.array([0.0, np.nan, 0.02])}, "t is not finite"),
    "fewer statuses": ({"statuses": np.array(["good"])}, "statuses has shape (1,)"),
    "numbers for statuses": (
        {"statuses": np.zeros(3)},
        "statuses holds float64 values, must be words",
    ),
    "a tick of zero": ({"tick": 0.0}, "tick is 0.0, must be a positive"),
    "interrupted in words": ({"interrupted": "no"}, "interrupted is of type str"),
    "no weight": ({"world": {**WORLD, "weight": 0.0}}, "weight is 0.0"),
    "a normal of two": ({"world": {**WORLD, "normal": [0.0, 1.0]}}, "normal has shape (2,)"),
    "no world": ({"world": None}, "world is of type NoneType"),
    "another robot": ({"robot": []}, "is missing"),
}


@pytest.mark.parametrize("name", LOGS)
def test_a_log_that_octo_never_wrote_is_one_line(folders: Path, name: str) -> None:
    changes, sentence = LOGS[name]
    with pytest.raises(RobotFileError, match="is not a log that octo saved") as caught:
        Log.load(spoiled(folders / "loop" / "log.npz", **changes))
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


def test_a_moved_folder_is_still_read(folders: Path) -> None:
    shutil.move(folders / "plan", folders / "elsewhere.d")
    assert octo.Solution.load(folders / "elsewhere.d").steps == 6


# -- lengths, velocities, starts, terms ------------------------------------------------------------


def test_the_table_of_lengths_holds(solution: octo.Solution) -> None:
    steps, nx, nu, contacts = solution.steps, 14, 8, len(solution.contact_names)
    shapes = {
        "times": (steps + 1,),
        "x": (steps + 2, nx),
        "v": (steps + 1, nx),
        "com": (steps + 1, 3),
        "yaw": (steps + 1,),
        "u": (steps, nu),
        "contact_force": (steps, contacts, 3),
        "normal_force": (steps, contacts),
        "loaded": (steps, contacts),
        "stance": (steps, contacts),
        "contact_depth": (steps, contacts),
    }
    for name, shape in shapes.items():
        assert getattr(solution, name).shape == shape, name
    assert octo.Solution.__doc__ is not None
    page = (Path(octo.__file__).parents[1] / "docs" / "solver.md").read_text()
    for name in ("times", "x[1:]", "v", "u", "stance"):
        assert name in octo.Solution.__doc__ and f"`{name}`" in page


def test_velocity_is_the_difference_over_the_step(solution: octo.Solution) -> None:
    assert np.allclose(solution.v[0], (solution.x[1] - solution.x[0]) / 0.02)
    assert np.allclose(solution.x[1] + 0.02 * np.cumsum(solution.v[1:], axis=0), solution.x[2:])


def test_stance_does_not_flicker(solution: octo.Solution) -> None:
    """Between the two thresholds a foot does what it did: lifted by 4 % after it stood, down by 4 %
    it does not."""
    mg = solution.weight
    force = np.zeros_like(solution.contact_force[:6, :1])
    force[:, 0, 2] = mg * np.array([0.04, 0.5, 0.04, 0.5, 0.005, 0.04])
    normal = np.zeros_like(force)
    normal[..., 2] = 1.0
    made = dataclasses.replace(solution, contact_force=force, contact_normal=normal)
    assert made.stance[:, 0].tolist() == [False, True, True, True, False, False]


@pytest.mark.parametrize("steps", [3, 6, 12, 40])
def test_a_start_is_resampled(solution: octo.Solution, steps: int) -> None:
    from octo.starts import first_nodes

    problem = octo.Problem(octo.gallery.chain(), steps=steps, dt=0.02, costs=[octo.Effort()])
    nodes = first_nodes(problem, 0, solution)
    assert nodes.shape == (steps + 2, 14)
    assert np.allclose(nodes[-1], solution.x[-1])  # it still ends where it ended
    if steps == 12:
        assert np.allclose(nodes[3::2], solution.x[2:])
    again = octo.solve(problem, start=solution.x[1:], passes=1, max_iterations=1)
    assert again.steps == steps


def test_a_start_of_a_straight_line_stays_one() -> None:
    from octo.starts import resampled

    line = np.linspace([0.0, 1.0], [2.0, -1.0], 5)
    assert np.allclose(resampled(line, 11), np.linspace([0.0, 1.0], [2.0, -1.0], 12))
    assert np.allclose(resampled(line[[0, -1]], 4), line)


@pytest.mark.parametrize(
    "start",
    [np.zeros((7, 13)), np.zeros((1, 14)), np.zeros(14), np.full((7, 14), np.nan), [["a"]]],
    ids=str,
)
def test_a_start_of_something_else_is_refused(start: Any) -> None:
    problem = octo.Problem(octo.gallery.chain(), steps=6, dt=0.02, costs=[octo.Effort()])
    with pytest.raises(OctoError, match="start"):
        octo.solve(problem, start=start, passes=1, max_iterations=1)


def fields_of(term: octo.Cost) -> dict[str, Any]:
    return {f.name: getattr(term, f.name) for f in dataclasses.fields(term)}


def test_terms_of_a_robot_need_no_dummy_problem() -> None:
    """The same terms, to the last number, as with the length and the times of a problem made for
    that."""
    robot = octo.gallery.mammal()
    made = octo.Problem(robot, steps=10, dt=0.02, costs=octo.costs.robot(0.4))
    dummy = octo.Problem(robot, steps=10, dt=0.02, costs=[octo.Effort()])
    times = [0.02 * (i + 1) for i in range(10)]
    for found, expected in zip(
        made.costs, octo.costs.robot(0.4, length=dummy.length, times=times), strict=True
    ):
        assert type(found) is type(expected)
        for name, value in fields_of(expected).items():
            assert np.array_equal(getattr(found, name), value), (found.label, name)


def test_terms_that_wait_may_be_joined_renamed_and_weighted() -> None:
    robot = octo.gallery.mammal()
    waiting = octo.costs.natural()
    heavy = dataclasses.replace(waiting[0], weight=3.0, name="Work")
    made = octo.Problem(robot, steps=10, dt=0.02, costs=[heavy, *waiting[1:], octo.Slip()])
    assert [term.label for term in made.costs][:2] == ["Work", "JointAcceleration"]
    assert made.costs[0].weight == pytest.approx(0.06) and isinstance(made.costs[0], octo.Effort)
    assert made.costs[-1].label == "Slip"


def test_terms_of_a_motion_that_does_not_begin_at_rest_want_the_speed_at_once() -> None:
    robot = octo.gallery.mammal()
    moving = octo.Problem(
        robot, steps=10, dt=0.02, costs=octo.costs.robot(0.4), v0=np.eye(robot.nx)[0]
    )
    rest = octo.Problem(robot, steps=10, dt=0.02, costs=octo.costs.robot(0.4))
    assert np.shape(moving.costs[0].velocity) == (3,)  # type: ignore[attr-defined]
    assert np.shape(rest.costs[0].velocity) == (10, 3)  # type: ignore[attr-defined]
