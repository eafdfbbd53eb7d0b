"""What used to be a traceback: one line that says what is wrong, or the right value."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octo
from octo.cli.main import main, parser
from octo.errors import OctoError, ProblemError, RobotFileError, ValueRangeError
from octo.model import xml_file

pytest.importorskip("mujoco")
ROOT = Path(__file__).parents[2]
CASES = Path(__file__).parent / "cases"
MASS = '<mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
PAIR = f"""<robot name="r">
<link name="a"><inertial>{MASS}</inertial></link>
<link name="b"><inertial>{MASS}</inertial></link>
<joint name="j" type="continuous"><parent link="a"/>
  <child link="b"/>
  <origin xyz="0 0 1" rpy="0 0 0"/>
  <axis xyz="0 1 0"/>
</joint>
</robot>"""


def refused(make: Callable[[], Any], kind: type[OctoError] = OctoError) -> str:
    """The line that says why."""
    with pytest.raises(kind) as caught:
        make()
    line = str(caught.value)
    assert line.isprintable() and len(line) < 1500, line
    return line


# -- encodings --------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1", "ascii", "cp1252"])
def test_a_file_in_its_encoding_is_read(encoding: str, tmp_path: Path) -> None:
    declared = "utf-8" if encoding == "utf-8-sig" else encoding
    path = tmp_path / "r.urdf"
    path.write_bytes(f'<?xml version="1.0" encoding="{declared}"?>\n{PAIR}'.encode(encoding))
    assert octo.load(path).mass == pytest.approx(4.0)


ENCODINGS = {
    "bogus": "its encoding cannot be read, must be UTF-8: unknown encoding: bogus",
    "shift_jis": "multi-byte encodings are not supported",
    "zlib": "not a text encoding",
    "idna": "its encoding cannot be read",
    "utf-16": "not well-formed XML",  # it is UTF-8
    "x" * 5000: "its encoding cannot be read",
}


@pytest.mark.parametrize("declared", ENCODINGS, ids=lambda word: word[:10])
@pytest.mark.parametrize("ending", ["urdf", "xml"])
def test_other_encodings_are_one_line(declared: str, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"r.{ending}"
    path.write_text(f'<?xml version="1.0" encoding="{declared}"?>\n{PAIR}', encoding="utf-8")
    assert ENCODINGS[declared] in refused(lambda: octo.load(path), RobotFileError)


# -- long names and deep nesting ----------------------------------------------------------------

LONG = {
    "a mesh": PAIR.replace(
        "</link>",
        f'<collision><geometry><mesh filename="{"m" * 5000}.stl"/></geometry></collision></link>',
        1,
    ),
    "a link": PAIR.replace('"b"', f'"{"b" * 100_000}"'),
    "a joint": PAIR.replace('"j"', f'"{"é" * 5000}"'),
}


@pytest.mark.parametrize("name", LONG)
def test_long_names_are_names(name: str, tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(LONG[name], encoding="utf-8")
    assert octo.load(path).mass == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"continuous"', f'"{"c" * 9000}"'),
        ("0 0 1", "z" * 9000),
        ('"b"/>', f'"{"b" * 9000}"/>'),
        ("<robot", f"<{'r' * 9000}"),
    ],
)
def test_long_words_are_cut_in_a_message(old: str, new: str, tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(PAIR.replace(old, new, 1), encoding="utf-8")
    assert "…" in refused(lambda: octo.load(path)) or old == "<robot"


@pytest.mark.parametrize("name", ["n" * 300, "n" * 70_000, "a\0b", "/" * 5000])
def test_names_that_no_file_has(name: str) -> None:
    assert refused(lambda: octo.load(f"{name}.urdf"))
    assert main(["info", f"{name}.urdf"]) == 2


@pytest.mark.parametrize("tag", ["link", "a", "body", "geometry"])
@pytest.mark.parametrize("top", ["robot", "mujoco"])
def test_deep_nesting(tag: str, top: str, tmp_path: Path) -> None:
    path = tmp_path / "r.xml"
    path.write_text(f"<{top}>{f'<{tag}>' * 50_000}{f'</{tag}>' * 50_000}</{top}>", encoding="utf-8")
    assert "nested deeper than" in refused(lambda: octo.load(path), RobotFileError)


def fixed(links: int, parent: Callable[[int], int]) -> str:
    """A URDF of links that are fixed to one another."""
    text = [f'<link name="l{k}"><inertial>{MASS}</inertial></link>' for k in range(links)]
    for k in range(1, links):
        text.append(
            f'<joint name="j{k}" type="fixed"><parent link="l{parent(k)}"/><child '
            f'link="l{k}"/></joint>'
        )
    return f'<robot name="r">{"".join(text)}</robot>'


@pytest.mark.parametrize(
    "parent",
    [lambda k: 0, lambda k: k // 2, lambda k: max(0, k - 1) % 900],
    ids=["star", "tree", "rows"],
)
def test_the_work_of_fixed_links_grows_with_their_number(
    parent: Callable[[int], int], tmp_path: Path
) -> None:
    lines = []
    for links in (250, 1000):
        path = tmp_path / f"{links}.urdf"
        path.write_text(fixed(links, parent), encoding="utf-8")
        done = Lines()
        with done:
            robot = octo.load(path)
        assert robot.mass == pytest.approx(2.0 * links)
        lines.append(done.number)
    assert lines[1] < 6.0 * lines[0]  # 4, and 16 were it quadratic


class Lines:
    """How many lines of Python run inside the with-block."""

    def __init__(self) -> None:
        self.number = 0

    def _trace(self, frame: Any, event: str, value: Any) -> Any:
        self.number += event == "line"
        return self._trace

    def __enter__(self) -> None:
        self.before = sys.gettrace()
        sys.settrace(self._trace)

    def __exit__(self, *failure: object) -> None:
        sys.settrace(self.before)


def test_links_in_a_long_row_are_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(fixed(20_000, lambda k: k - 1), encoding="utf-8")
    began = time.process_time()
    assert "link 'l19999' hangs on 19999 others in a row" in refused(lambda: octo.load(path))
    assert time.process_time() - began < 10.0


# -- the user's line --------------------------------------------------------------------------

LINES = {
    "comma": (
        "0 0 1",
        "0, 0, 1",
        "joint 'j': origin xyz is '0, 0, 1', must be three numbers with spaces between them "
        "(line 6)",
    ),
    "two": ("0 1 0", "0 1", "joint 'j': axis xyz is '0 1', must be three numbers (line 7)"),
    "a word": (
        'rpy="0 0 0"',
        'rpy="0 pi 0"',
        "joint 'j': origin rpy is 'pi', must be a finite number (line 6)",
    ),
    "a type": ("continuous", "hinge", "joint 'j': type is 'hinge'"),
    "a parent": (
        'parent link="a"',
        'parent link="z"',
        "joint 'j': parent link is 'z', must be a link of the file (line 4)",
    ),
    "a mass": (
        'value="2"',
        'value="two"',
        "link 'a': mass is 'two', must be a finite number (line 2)",
    ),
    "a moment": (
        'ixx="1"',
        'ixx="1,0"',
        "link 'a': inertia ixx is '1,0', must be a finite number (line 2)",
    ),
    "no direction": ("0 1 0", "0 0 0", "joint 'j': axis is 0 0 0, must have a direction (line 7)"),
    "a radius": (
        "</link>",
        '<collision><geometry>\n<sphere radius="r"/></geometry></collision></link>',
        "radius of its sphere is 'r'",
    ),
    "a size": (
        "</link>",
        '\n<collision><geometry><box size="1 1"/></geometry></collision></link>',
        "box size is '1 1', must be three",
    ),
}


@pytest.mark.parametrize("name", LINES)
def test_a_mistake_names_joint_attribute_and_line(name: str, tmp_path: Path) -> None:
    old, new, said = LINES[name]
    path = tmp_path / "r.urdf"
    path.write_text(PAIR.replace(old, new, 1), encoding="utf-8")
    assert f"r.urdf: {said}" in refused(lambda: octo.load(path), RobotFileError) or said in refused(
        lambda: octo.load(path)
    )


def test_the_comma_of_the_case_is_in_line_14() -> None:
    line = refused(lambda: octo.load(CASES / "comma_in_line_14.urdf"), RobotFileError)
    assert "joint 'j': origin xyz is '0, 0, 0.5'" in line and "(line 14)" in line


def test_what_mujoco_names_is_the_users_line(tmp_path: Path) -> None:
    """Links and joints are given to MuJoCo on the lines that they have, whatever was taken out
    between them."""
    path = tmp_path / "r.urdf"
    path.write_text(PAIR, encoding="utf-8")
    tree = xml_file.read(path)
    tree.remove(tree[0])
    again = tmp_path / "again.urdf"
    again.write_text(xml_file.text_of(tree), encoding="utf-8")
    assert {e.tag: xml_file.line_of(e) for e in xml_file.read(again)} == {"link": 3, "joint": 4}


# -- options and numbers --------------------------------------------------------------------------

EVERY = [
    (name, option)
    for name, made in parser()[1].items()
    for option in made._option_string_actions
    if option.startswith("--")
]


@pytest.mark.parametrize("command", sorted({name for name, _ in EVERY}))
def test_two_dashes_are_no_value(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    for option in (option for name, option in EVERY if name == command):
        assert main([command, f"{option}=--"]) == 2
        assert (
            capsys.readouterr().err == f"octo: error: argument {option}: is '--', must be a value\n"
        )


HUGE = {
    "solve chain --passes 1000000000000000000000000000000 --costs paper": "passes is",
    "solve chain --seeds 1000000000000 --costs paper": "seeds is",
    "solve chain --threads 1000000000 --costs paper": "threads is",
    "solve chain --seconds 1e308": "seconds is",
    "solve chain --seconds 1e9 --dt 1e-3": "seconds is",
    "solve chain --speed 1e308": "speed is",
    "solve chain --goal jump --height 1e200": "height is",
    "mpc mammal --iterations 10000000000000000000000": "iterations is",
    "mpc mammal --seconds 1e308": "seconds is",
    "mpc mammal --rate 1e-308": "rate is",
    "mpc mammal --horizon 1000000000000": "steps is",
    "cycle chain --steps 1000000000000": "steps is",
}


@pytest.mark.parametrize("words", HUGE)
def test_what_would_never_end_is_refused(
    words: str, tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    began = time.process_time()
    assert main(words.split()) == 2
    assert HUGE[words] in capsys.readouterr().err and not list(tmp_path.iterdir())
    assert time.process_time() - began < 10.0


@pytest.mark.parametrize("value", ["1e308", "-1e308", "1e-308", "1e22", "9" * 400])
def test_extreme_numbers_in_every_option(
    value: str, tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a robot that does not exist: what is wrong with the number, or the robot."""
    monkeypatch.chdir(tmp_path)
    for command, option in EVERY:
        if command in ("solve", "cycle", "mpc", "compare", "simulate", "replay"):
            main(
                [command, "nothing.urdf", f"{option}={value}"] if option != "--help" else [command]
            )
            assert "Traceback" not in capsys.readouterr().err


@pytest.fixture(scope="module")
def problem() -> octo.Problem:
    return octo.Problem(octo.gallery.chain(), steps=3, dt=0.05, costs=[octo.Effort()])


ENDLESS = {
    "passes": 10**30,
    "seeds": 10**9,
    "seed": -1,
    "threads": 10**6,
    "max_iterations": 10**30,
    "start": np.zeros((2, 3)),
}


@pytest.mark.parametrize("name", ENDLESS)
def test_numbers_of_a_solve(name: str, problem: octo.Problem) -> None:
    assert refused(lambda: octo.solve(problem, device="cpu", **{name: ENDLESS[name]})).startswith(
        name
    )


def test_more_memory_than_there_is(problem: octo.Problem) -> None:
    long = problem.replace(steps=1_000_000)
    assert "of memory" in refused(lambda: octo.solve(long, seeds=1000, device="cpu"), ProblemError)


# -- wrong types --------------------------------------------------------------------------------

WORDS = np.array(["a", "b"])
ROBOT = octo.gallery.chain()
TYPES: dict[str, tuple[Callable[[], Any], str]] = {
    "an array for a name": (
        lambda: octo.BaseHeight(0.3, body=WORDS),
        "BaseHeight.body is an array of shape (2,), must be a text",
    ),
    "a list for a label": (lambda: octo.Effort(name=["a"]), "Effort.name is ['a'], must be a text"),
    "an array for steps": (
        lambda: octo.Effort(steps=WORDS),
        "Effort.steps is an array of shape (2,), must be 'all', 'last'",
    ),
    "an array for a joint": (
        lambda: ROBOT.joint_index(WORDS),
        "joint an array of shape (2,) is not known",
    ),
    "an array for a goal": (lambda: octo.Goal(WORDS), "goal an array of shape (2,) is not known"),
    "an array for a base": (lambda: octo.load("chain", WORDS), "base is an array of shape (2,)"),
    "an array for a device": (lambda: octo.walk(ROBOT, device=WORDS), "device"),
    "a text for a number": (lambda: octo.Goal(speed="0.5"), "speed is '0.5', must be numbers"),
    "a text for a velocity": (
        lambda: octo.costs.natural("0.5", length=0.3),
        "speed is '0.5', must be numbers",
    ),
    "a text for a length": (
        lambda: octo.costs.natural(0.5, length="0.3"),
        "length is '0.3' m, must be positive",
    ),
    "a text for dt": (lambda: octo.walk(ROBOT, dt="0.1"), "dt is '0.1' s, must be positive"),
    "texts for a pose": (
        lambda: octo.kinematics.center_of_mass(ROBOT, ["0"] * ROBOT.nx),
        "x is ['0', '0'",
    ),
    "complex numbers": (
        lambda: octo.costs.paper([1j, 0, 0]),
        "velocity is [1j, 0, 0], must be numbers",
    ),
    "dates": (
        lambda: octo.costs.paper(np.array(["2020"] * 3, dtype="datetime64[Y]")),
        "velocity is an array of shape (3,), must be",
    ),
    "a large whole number": (
        lambda: octo.Cycle(turn=10**400),
        "cycle.turn is a number of 1329 bits, must be numbers",
    ),
    "None for a robot": (lambda: octo.describe(None), "character is None, must be a Character"),
    "a text for a robot": (
        lambda: octo.mirror_of("chain"),
        "robot is 'chain', must be a Character",
    ),
    "a path of None": (lambda: octo.load(None), "path is None, must be a robot file's path"),
    "a generator for a path": (lambda: octo.load(k for k in "ab"), "path is a generator, must be"),
    "a generator for costs": (
        lambda: octo.Problem(ROBOT, steps=3, dt=0.1, costs=(c for c in "a")),
        "costs is a generator",
    ),
    "a generator for a weight": (
        lambda: octo.solve(_weighing(k for k in "a"), device="cpu"),
        "Effort.weight is a generator",
    ),
    "a list that holds itself": (
        lambda: octo.solve(_weighing(_holding_itself()), device="cpu"),
        "Effort.weight is a list",
    ),
    "a number for parameters": (
        lambda: octo.Problem(ROBOT, steps=3, dt=0.1, costs=[octo.Effort()], parameters=3),
        "parameters is 3",
    ),
    "a number for pairs": (
        lambda: octo.mirror_of(ROBOT, 3),
        "pairs is 3, must be names of joints by name",
    ),
    "a number for a ground": (
        lambda: octo.simulate(ROBOT, np.zeros(ROBOT.nx), steps=1, terrain=3),
        "terrain is 3, must be an octo.Plane",
    ),
    "a number for a callback": (
        lambda: octo.walk(ROBOT, callback=3),
        "callback is 3, must be a function",
    ),
    "an array for options": (
        lambda: octo.walk(ROBOT, options=WORDS),
        "options is an array of shape (2,), must be an octo.SqpOptions",
    ),
    "a seed of -1": (
        lambda: octo.walk(ROBOT, seed=-1),
        "seed is -1, must be a whole number of at least 0",
    ),
    "a seed of 0.5": (
        lambda: octo.jump(octo.gallery.biped(), seed=0.5),
        "seed is 0.5, must be a whole number",
    ),
    "NaN for a plateau": (
        lambda: octo.SqpOptions(plateau_change=float("nan")),
        "plateau_change is not finite",
    ),
    "an array for a limit": (
        lambda: octo.SqpOptions(time_limit=np.zeros(2)),
        "time_limit is an array of shape (2,)",
    ),
    "lists in lists": (lambda: octo.Effort(weight=_deep()), "cannot be copied"),
}


def _weighing(weight: Any) -> octo.Problem:
    return octo.Problem(ROBOT, steps=3, dt=0.1, costs=[octo.Effort(weight=weight)])


def _holding_itself() -> list[Any]:
    found: list[Any] = []
    found.append(found)
    return found


def _deep() -> Any:
    found: Any = 1.0
    for _ in range(5000):
        found = [found]
    return found


@pytest.mark.parametrize("name", TYPES)
def test_wrong_types_are_one_line(name: str) -> None:
    make, said = TYPES[name]
    line = refused(make)
    assert said in line, line


def test_numbers_of_other_kinds_are_numbers() -> None:
    from decimal import Decimal
    from fractions import Fraction

    for value in (np.float32(0.5), Fraction(1, 2), Decimal("0.5"), np.array(0.5)):
        assert octo.costs.natural(value, length=0.3)[0].velocity[0] == pytest.approx(0.5)


NEVER = ("Problem(", "Character(", "bodies=", "object at 0x", "Effort(")


@pytest.mark.parametrize(
    "where",
    ["terrain", "law", "cycle", "costs", "x0", "pose", "parameters", "basis", "steps", "dt"],
)
@pytest.mark.parametrize("kind", ["robot", "problem", "list of robots"])
def test_no_message_holds_a_robot_or_a_problem(
    where: str, kind: str, problem: octo.Problem
) -> None:
    value = {"robot": ROBOT, "problem": problem, "list of robots": [ROBOT, ROBOT]}[kind]
    line = refused(
        lambda: octo.Problem(
            ROBOT, **{"steps": 3, "dt": 0.1, "costs": [octo.Effort()], where: value}
        )
    )
    assert not any(word in line for word in NEVER), line


def test_a_message_is_one_line_whatever_it_quotes() -> None:
    for word in ("a\nb", "\x1b[31m", "\u202e", "\ud800", "a\tb\rc", "x" * 10_000):
        assert refused(lambda word=word: octo.load(word))  # type: ignore[misc]
        line = str(ValueRangeError(f"name is {word}, must be another"))
        assert line.isprintable() and len(line) < 400 and line.endswith("must be another")


# -- consoles ---------------------------------------------------------------------------------

CONSOLES = {
    "ascii": {"PYTHONIOENCODING": "ascii"},
    "latin-1": {"PYTHONIOENCODING": "latin-1"},
    "cp1252": {"PYTHONIOENCODING": "cp1252"},
    "C": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "utf-16": {"PYTHONIOENCODING": "utf-16"},
}


def run(
    words: str, folder: Path, stream: str = "", **environment: str
) -> subprocess.CompletedProcess[bytes]:
    own = {**os.environ, "PYTHONPATH": str(ROOT), **environment}
    line = f'"{sys.executable}" -m octo {words}{stream}'
    return subprocess.run(line, shell=True, cwd=folder, env=own, capture_output=True)


@pytest.mark.parametrize("console", CONSOLES)
def test_a_console_prints_what_it_can(console: str, tmp_path: Path) -> None:
    told = run("info mammal", tmp_path, **CONSOLES[console])
    assert told.returncode == 0 and told.stderr == b""
    assert b"mammal" in told.stdout.replace(b"\0", b"")
    wrong = run("info nothing-\u00e9-\u65e5.urdf", tmp_path, **CONSOLES[console])
    assert (
        wrong.returncode == 2
        and b"no such file" in wrong.stderr.replace(b"\0", b"")
        and b"Traceback" not in wrong.stderr
    )


STREAMS = {
    " >/dev/full": 2,
    " >&-": 0,
    " 2>&-": 0,
    " | head -c 1 >/dev/null": 0,
    " >&- 2>&-": 0,
    " <&-": 0,
}


@pytest.mark.parametrize("stream", STREAMS)
def test_a_console_that_takes_nothing(stream: str, tmp_path: Path) -> None:
    told = run("info mammal", tmp_path, stream)
    assert (
        told.returncode == STREAMS[stream]
        and b"Traceback" not in told.stderr
        and b"Exception" not in told.stderr
    )
    assert (b"cannot be written: No space left" in told.stderr) == (stream == " >/dev/full")


def test_octo_reads_its_own_texts_as_utf_8(tmp_path: Path) -> None:
    """Python warns where a file is opened in whatever the system's encoding is."""
    code = """
import sys, warnings
warnings.filterwarnings("error", category=EncodingWarning, module="octo")
from octo.cli import run
sys.argv = "octo simulate chain --seconds 0.1 --dt 0.05 --out out".split()
run()
"""
    own = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "OCTO_CACHE": str(tmp_path / "cache"),
        "PYTHONUTF8": "0",
        "LC_ALL": "C",
    }
    done = subprocess.run(
        [sys.executable, "-X", "warn_default_encoding", "-c", code],
        cwd=tmp_path,
        env=own,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
