"""Saved solutions that are damaged or made up: one line that says what. Replays that end at once.
Clocks that cannot be."""

from __future__ import annotations

import io
import json
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.cli.simulate import measured_motion
from octo.dynamics.simulate import Motion
from octo.errors import RobotFileError, ValueRangeError
from octo.mpc import Controller, walking_problem
from octo.result.solution import Solution
from octo.solver.status import Status

MAMMAL = octo.gallery.mammal()
Parts = tuple[dict[str, Any], dict[str, Any]]


def standing(dt: float = 0.05, steps: int = 6) -> Solution:
    """The start held still."""
    problem = octo.Problem(MAMMAL, steps=steps, dt=dt, costs=[octo.Effort()])
    x = np.repeat(problem.start[None], steps + 2, axis=0)
    return measured_motion(
        problem,
        Motion(x, np.zeros((steps, MAMMAL.nu)), dt, np.ones(steps, bool), np.zeros(1)),
        0.1,
        0.2,
    )


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("saved") / "solution.npz"
    standing().save(path)
    return path


@pytest.fixture(scope="module")
def cycle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cycle") / "solution.npz"
    problem = octo.Problem(MAMMAL, costs=[octo.Effort()], cycle=octo.Cycle(speed=0.5), steps=8)
    octo.solve(problem, max_iterations=1, passes=1, device="cpu").save(path)
    return path


def taken_apart(path: Path) -> Parts:
    """Arrays, and the JSON."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    return arrays, json.loads(str(arrays.pop("plain")))


def put_together(path: Path, parts: Parts) -> Path:
    np.savez(path, **parts[0], plain=np.array(json.dumps(parts[1])))
    return path


def refused(path: Path) -> str:
    """The line that says why."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(RobotFileError) as caught:
            Solution.load(path)
    line = str(caught.value)
    assert "\n" not in line and len(line) < 400 and line.isprintable() and path.name in line
    return line


def spoiled(name: str, value: float) -> Callable[[Parts], object]:
    def spoil(parts: Parts) -> None:
        parts[0][name] = parts[0][name].astype(float)
        parts[0][name].flat[-1] = value

    return spoil


def shaped(name: str, change: Callable[[np.ndarray], Any]) -> Callable[[Parts], object]:
    return lambda parts: parts[0].update({name: change(parts[0][name])})


def said(**values: Any) -> Callable[[Parts], object]:
    return lambda parts: parts[1].update(values)


def joint(**values: Any) -> Callable[[Parts], object]:
    return lambda parts: parts[1]["character"]["bodies"][0]["joints"][0].update(values)


def goal(**values: Any) -> Callable[[Parts], object]:
    whole = {"name": "a", "what": "b", "found": [1.0], "wanted": [1.0], "unit": "m", "size": 1.0}
    return said(asked=[{**whole, **values}])


CONTENTS: dict[str, tuple[Callable[[Parts], object], str]] = {
    "a goal in words": (said(asked=["far"]), "asked must hold records only"),
    "a goal without numbers": (goal(found=None), "found holds object values, must be numbers"),
    "a goal of two lengths": (goal(wanted=[1.0, 2.0]), "wanted has shape (2,), expected (1)"),
    "a goal not finite": (goal(wanted=[float("nan")]), "wanted is not finite"),
    "a goal of no size": (goal(size=0.0), "size is 0.0, must be a positive"),
    "dt of zero": (said(dt=0.0), "dt is 0.0, must be a positive"),
    "negative dt": (said(dt=-0.05), "dt is -0.05"),
    "dt not finite": (said(dt=float("nan")), "dt is nan"),
    "dt in words": (said(dt="fast"), "dt is of type str, must be a number"),
    "dt that is true": (said(dt=True), "dt is True"),
    "no dt": (lambda parts: parts[1].pop("dt"), "dt is missing"),
    "no nodes": (lambda parts: parts[0].pop("x"), "x is missing"),
    "nodes not finite": (spoiled("x", np.nan), r"x is not finite at index (7, 17)"),
    "infinite torque": (spoiled("u", np.inf), "u is not finite"),
    "one node": (shaped("x", lambda x: x[:1]), "x has shape (1, 18)"),
    "no step": (shaped("x", lambda x: x[:2]), "at least one step"),
    "another robot's nodes": (
        shaped("x", lambda x: x[:, :-1]),
        "x has shape (8, 17), expected (any, 18)",
    ),
    "flat nodes": (shaped("x", np.ravel), "x has shape (144,)"),
    "nodes in words": (shaped("x", lambda x: x.astype(str)), "must be numbers"),
    "complex nodes": (shaped("x", lambda x: x + 1j), "x holds complex128 values"),
    "nodes that are true": (shaped("x", lambda x: x > 0), "x holds bool values"),
    "a step too few torques": (
        shaped("u", lambda u: u[1:]),
        "u has shape (5, 12), expected (6, 12)",
    ),
    "torques of fewer motors": (shaped("u", lambda u: u[:, 1:]), "u has shape (6, 11)"),
    "forces of fewer feet": (
        shaped("contact_force", lambda f: f[:, 1:]),
        "contact_force has shape",
    ),
    "forces in two axes": (
        shaped("contact_normal", lambda f: f[..., :2]),
        "contact_normal has shape",
    ),
    "depths not finite": (spoiled("contact_depth", np.nan), "contact_depth is not finite"),
    "fewer names of feet": (lambda parts: parts[1]["contact_names"].pop(), "contact_names has"),
    "numbers for names": (said(contact_names=[1, 2]), "contact_names must hold words"),
    "a limit that is none": (spoiled("torque_limit", np.nan), "torque_limit is not a number"),
    "limits of fewer motors": (shaped("torque_limit", lambda v: v[1:]), "torque_limit has shape"),
    "flat unknowns": (shaped("unknowns", np.ravel), "unknowns has shape"),
    "multipliers not finite": (
        lambda parts: parts[0].update(multipliers=np.full((2, 2), np.nan)),
        "multipliers is not finite",
    ),
    "ground without heights": (lambda parts: parts[0].pop("ground_z"), "ground_z is missing"),
    "ground of another size": (shaped("ground_z", lambda z: z[1:]), "ground_z has shape"),
    "columns of two lengths": (
        lambda parts: parts[0].update(history_energy=np.zeros(3)),
        "differ in length",
    ),
    "an unknown status": (said(status="perfect"), "status 'perfect' is not known"),
    "a status that is a number": (said(status=3), "status is of type int"),
    "weight of zero": (said(weight=0.0), "weight is 0.0"),
    "infinite length": (said(length=float("inf")), "length is inf"),
    "half an iteration": (said(iterations=1.5), "iterations is of type float"),
    "a negative seed": (said(seed=-1), "seed is -1"),
    "terms in words": (said(terms={"Effort": "little"}), "terms has 'little'"),
    "terms in a list": (said(terms=[1.0]), "terms is of type list"),
    "parameters not finite": (said(parameters={"dt": float("nan")}), "parameters has"),
    "passes that are numbers": (said(passes=[1, 2]), "passes must hold records"),
    "an entry that octo never wrote": (said(evil=1), "entry 'evil' is not known"),
    "a robot that is a list": (said(character=[]), "list"),
    "a robot without bodies": (
        lambda parts: parts[1]["character"].pop("bodies"),
        "bodies is missing, must be a list",
    ),
    "a robot of no mass": (
        lambda parts: [b.update(mass=0.0) for b in parts[1]["character"]["bodies"]],
        "mass",
    ),
    "a joint with an unknown field": (joint(colour="red"), "colour"),
    "a joint that is actuated by 3": (
        joint(actuated=3),
        "actuated is of type int, must be of type bool",
    ),
    "a joint of axes in one number": (joint(axis=1.0), "axis has shape ()"),
    "a pose of another robot": (
        lambda parts: parts[1]["character"].update(default_pose=[1.0]),
        "default_pose has shape (1,)",
    ),
    "a mass in words": (
        lambda parts: parts[1]["character"]["bodies"][0].update(mass="heavy"),
        "mass is of type str",
    ),
    "a joint in words": (joint(axis="up"), "axis is 'up', must be numbers"),
    "no robot, but its feet": (said(character=None, contact_names=[]), "contact_depth has shape"),
    "a cycle that is a word": (said(cycle="yes"), "cycle is of type str"),
    "a cycle without arrays": (
        said(cycle={"period": 1.0, "speed": 0.0, "sideways": 0.0, "turn": 0.0, "mirrored": False}),
        "matrix is missing",
    ),
    "deep JSON": (said(starts=[{"a": [[[]]]}, 3]), "starts must hold records"),
}


@pytest.mark.parametrize("kind", CONTENTS)
def test_contents_that_octo_never_wrote(kind: str, saved: Path, tmp_path: Path) -> None:
    spoil, sentence = CONTENTS[kind]
    parts = taken_apart(saved)
    spoil(parts)
    line = refused(put_together(tmp_path / "spoiled.npz", parts))
    assert sentence in line, line


CYCLES: dict[str, tuple[Callable[[Parts], object], str]] = {
    "a period of zero": (lambda parts: parts[1]["cycle"].update(period=0.0), "period is 0.0"),
    "a mirror in words": (
        lambda parts: parts[1]["cycle"].update(mirrored="no"),
        "mirrored is of type str, must be",
    ),
    "a foot that is not there": (spoiled("cycle_contacts", 99), "contacts holds float64"),
    "feet beyond the last": (
        lambda parts: parts[0]["cycle_contacts"].fill(99),
        "contacts has an index out of",
    ),
    "a flat rotation": (shaped("cycle_rotation", np.ravel), "rotation has shape"),
    "a shift not finite": (spoiled("cycle_shift", np.nan), "shift is not finite"),
}


@pytest.mark.parametrize("kind", CYCLES)
def test_cycles_that_octo_never_wrote(kind: str, cycle: Path, tmp_path: Path) -> None:
    parts = taken_apart(cycle)
    CYCLES[kind][0](parts)
    assert CYCLES[kind][1] in refused(put_together(tmp_path / "spoiled.npz", parts))


def _archive(*entries: tuple[str, bytes]) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as file:
        for name, content in entries:
            file.writestr(name, content)
    return made.getvalue()


def _array(value: Any, **options: Any) -> bytes:
    made = io.BytesIO()
    np.save(made, value, **options)
    return made.getvalue()


SHAPE = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,)}".ljust(117) + b"\n"
HUGE = b"\x93NUMPY\x01\x00" + len(SHAPE).to_bytes(2, "little") + SHAPE
FILES: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda whole: b"",
    "cut in half": lambda whole: whole[: len(whole) // 2],
    "cut by a byte": lambda whole: whole[:-1],
    "zeroed": lambda whole: bytes(len(whole)),
    "a text": lambda whole: b"hello\n" * 100,
    "a single array": lambda whole: _array(np.zeros(3)),
    "an empty archive": lambda whole: _archive(),
    "an archive of texts": lambda whole: _archive(("x.npy", b"hello"), ("plain.npy", b"{}")),
    "no JSON": lambda whole: _archive(("plain.npy", _array("not JSON"))),
    "JSON that is a list": lambda whole: _archive(("plain.npy", _array("[1]"))),
    "JSON that never ends": lambda whole: _archive(("plain.npy", _array("[" * 20000))),
    "objects": lambda whole: _archive(
        ("plain.npy", _array(np.array([{}], dtype=object), allow_pickle=True))
    ),
    "an array of petabytes": lambda whole: _archive(("x.npy", HUGE)),
    "zeros in the middle": lambda whole: whole[:400] + bytes(400) + whole[800:],
}


@pytest.mark.parametrize("kind", FILES)
def test_files_that_are_damaged(
    kind: str, saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "damaged.npz"
    path.write_bytes(FILES[kind](saved.read_bytes()))
    line = refused(path)
    for words in (
        ["info", str(path)],
        ["view", str(path), "--out", str(tmp_path / "x.csv")],
        ["replay", str(path)],
    ):
        assert main(words) == 2
        assert capsys.readouterr().err == f"octo: error: {line}\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_and_nothing(tmp_path: Path) -> None:
    (tmp_path / "folder.npz").mkdir()
    for name in ("folder.npz", "nothing.npz", "n" * 300):
        with pytest.raises(RobotFileError) as caught:
            Solution.load(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_flipped_bits_are_refused_or_harmless(saved: Path, tmp_path: Path) -> None:
    whole, rng, path = saved.read_bytes(), np.random.default_rng(0), tmp_path / "flipped.npz"
    loaded = 0
    for _ in range(150):
        spoiled = bytearray(whole)
        for place in rng.integers(0, len(whole), size=int(rng.integers(1, 4))):
            spoiled[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(spoiled)
        try:
            found = Solution.load(path)
            loaded += np.isfinite(found.x).all() and found.dt > 0.0
        except RobotFileError as error:
            assert "\n" not in str(error)
    assert loaded < 60


def test_what_octo_wrote_is_read_as_it_was(saved: Path, cycle: Path, tmp_path: Path) -> None:
    for path in (saved, cycle):
        first = Solution.load(path)
        first.save(tmp_path / "again.npz")
        again = Solution.load(tmp_path / "again.npz")
        assert (
            str(again) == str(first)
            and again.report() == first.report()
            and np.array_equal(again.x, first.x)
        )
    parts = taken_apart(saved)
    parts[0]["x"] = parts[0]["x"].astype(np.float32)
    for name in ("processor_seconds", "seed", "stages", "starts"):
        parts[1].pop(name)  # as in files of earlier versions
    found = Solution.load(put_together(tmp_path / "old.npz", parts))
    assert found.x.dtype == np.float64 and found.seed == 0 and found.starts == ()
    replace(standing(), u=np.full((6, 12), np.nan), status=Status.NOT_FINITE).save(
        tmp_path / "failed.npz"
    )
    assert np.isnan(Solution.load(tmp_path / "failed.npz").u).all()


def test_names_cannot_command_a_terminal(
    saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = Solution.load(saved)
    names = tuple(f"foot\x1b[2J{k}" for k in range(len(found.contact_names)))
    replace(found, name="robot\x1b]0;owned\x07\n", contact_names=names).save(tmp_path / "named.npz")
    assert main(["info", str(tmp_path / "named.npz")]) == 0
    assert all(c.isprintable() or c == "\n" for c in capsys.readouterr().out)
    assert all(name.isprintable() for name in Solution.load(tmp_path / "named.npz").contact_names)


# -- replays that fall at once ---------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.3, 0.5, 1.0])
def test_a_replay_that_falls_before_its_first_node(dt: float, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    plan = standing(dt=dt, steps=2)
    pushed = replace(plan, u=plan.u - 50.0)
    done = octo.replay(pushed, kp=1e-6, kd=1e-6, feedback="none", timestep=0.002)
    motion = done.motion
    assert done.starts[0].fell and done.starts[0].seconds_upright < dt
    assert (motion.x.shape, motion.u.shape, motion.contact_force.shape[0]) == ((3, 18), (1, 12), 1)
    assert np.isfinite(motion.x).all() and motion.report()["steps"] == 1 and str(motion)
    motion.save(tmp_path / "motion.npz")
    assert Solution.load(tmp_path / "motion.npz").steps == 1
    motion.to_csv(tmp_path / "motion.csv")
    if dt == 1.0:
        pytest.importorskip("viser")
        octo.view([done.plan, motion], tmp_path / "motion.html")
        octo.plot(motion, tmp_path / "plot.png")


def test_a_command_that_replays_a_fall(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    plan = standing(dt=0.5, steps=2)
    replace(plan, u=plan.u - 50.0).save(tmp_path / "solution.npz")
    words = (
        f"replay {tmp_path}/solution.npz --kp 1e-6 --kd 1e-6 --feedback none --out {tmp_path}/out"
    )
    assert main(words.split()) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["falls"] == 1 and report["seconds_upright"] < 0.5


# -- clocks ----------------------------------------------------------------------------------------

CLOCKS = (1e308, -1e308, np.finfo(float).max, 1e18, np.float64(-1e200), 10**400, "1e308", 2e11)


@pytest.fixture(scope="module")
def described() -> octo.Problem:
    return walking_problem(MAMMAL, 8, 0.04)


@pytest.mark.parametrize("curvature", ["gauss-newton", "exact"])
def test_a_clock_that_cannot_be_is_an_invalid_measurement(
    curvature: str, described: octo.Problem
) -> None:
    controller = Controller(described, curvature=curvature)
    q, v = controller.convention.from_octo(described.start, np.zeros(MAMMAL.nx))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for t in CLOCKS:
            controller.reset(q, v, 0.0)
            for _ in range(3):
                assert controller.step(t, q, v).status.label == "invalid"  # type: ignore[arg-type]
            controller.prepare(t)  # type: ignore[arg-type]
            assert np.isfinite(controller.command(t, q, v)).all()  # type: ignore[arg-type]
            assert controller.step(0.01, q, v).status.label == "solved"
            assert controller.step(t, q, v).status.label == "invalid"  # type: ignore[arg-type]
            assert controller.step(0.02, q, v).status.label == "solved"


@pytest.mark.parametrize("t", CLOCKS[:5])
def test_a_clock_cannot_begin_where_it_cannot_go_on(t: float, described: octo.Problem) -> None:
    controller = Controller(described)
    q, v = controller.convention.from_octo(described.start, np.zeros(MAMMAL.nx))
    for begin in (
        lambda: controller.reset(q, v, t),
        lambda: controller.warm_start(standing(0.04, 8), t),
    ):
        with pytest.raises(ValueRangeError, match="t is .* s, must be at most 1e"):
            begin()
    controller.reset(q, v, 1.7e9)  # a computer's own clock
    assert [controller.step(1.7e9 + 0.01 * k, q, v).status.label for k in (1, 2)] == [
        "solved",
        "solved",
    ]
