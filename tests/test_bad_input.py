"""Bad input on the command line: one line that names the field and what is allowed, exit code 2,
nothing written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from octo.cli.main import main

LEG = (
    '<body pos="0 0 -.2"><joint name="knee" axis="0 1 0" range="-1 1"/>'
    '<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".03"/></body>'
)
FIXED = (
    '<mujoco><compiler angle="radian"/><worldbody><body name="post" pos="0 0 1">'
    f'<geom size=".1"/>{LEG}</body></worldbody>%s</mujoco>'
)
FLOATING = FIXED.replace('pos="0 0 1">', 'pos="0 0 1"><freejoint/>')
MOTOR = '<actuator><motor joint="knee"/></actuator>'
URDF = """<robot name="two"><link name="base">
<inertial><mass value="{base}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm">{arm}</link><joint name="hinge" type="revolute"><parent link="base"/><child
  link="arm"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="1"/></joint></robot>"""
ARM = (
    '<inertial><mass value="{mass}"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)
TERRAINS = """
import casadi as ca

def hills(point, p):
    return point[2] - 0.01 * ca.sin(point[0])

def vector(point, p):
    return point

def constant(point, p):
    return 1.0

def broken(point, p):
    return point["z"]
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with legal and illegal files; commands run in it."""
    monkeypatch.chdir(tmp_path)
    files = {
        "no_actuator.xml": FLOATING % "",
        "fixed.xml": FIXED % MOTOR,
        "broken.xml": "<mujoco><worldbody>",
        "page.html": "<html/>",
        "empty.urdf": "",
        "macro.xacro": "<robot/>",
        "massless.urdf": URDF.format(base=0, arm=ARM.format(mass=0)),
        "negative.urdf": URDF.format(base=1, arm=ARM.format(mass=-1)),
        "no_inertia.urdf": URDF.format(base=1, arm=""),
        "ghost.xml": (FLOATING % MOTOR).replace("<geom", '<geom contype="0" conaffinity="0"'),
        "text.npz": "no archive",
        "terrains.py": TERRAINS,
        "raises.py": "import nowhere",
        "short.json": "[0, 1, 2]",
        "words.json": '{"a": "b"}',
        "torn.json": "[0, 1",
        "nan.txt": "nan " * 18,
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    (tmp_path / "occupied" / "report.json").mkdir(parents=True)
    return tmp_path


WALK = "solve mammal --seconds 1"
CASES = {
    "no command": ("", "command is missing", "solve, cycle, learn, graph, mpc, compare"),
    "unknown command": ("sovle mammal", "command 'sovle'", "solve"),
    "unknown option": ("solve mammal --sped 1", "option '--sped'", "--speed"),
    "an option cut short": ("solve mammal --sec 1", "option '--sec'", "--seconds"),
    "one argument too many": ("solve mammal spider", "'spider' is not expected"),
    "no robot": ("solve --speed 1", "ROBOT"),
    "an option without its value": ("solve mammal --speed", "--speed: expected one argument"),
    "unknown robot": ("solve mamal", "robot 'mamal'", "mammal"),
    "missing file": ("solve nowhere/go2.urdf", "nowhere/go2.urdf", "no such file"),
    "a folder for a robot": ("solve ./occupied", "'./occupied'", "not known"),
    "malformed XML": ("solve broken.xml", "broken.xml", "XML"),
    "empty file": ("solve empty.urdf", "empty.urdf", "not well-formed"),
    "not a robot file": ("solve page.html", "<html>", "<robot> (URDF) or <mujoco> (MJCF)"),
    "macros": ("solve macro.xacro", "macro.xacro", "URDF or MJCF"),
    "no mass at all": ("solve massless.urdf", "mass", "0"),
    "negative mass": ("solve negative.urdf", "arm", "mass", "negative"),
    "a moving link without inertia": ("solve no_inertia.urdf", "hinge", "mass"),
    "no actuator": ("solve no_actuator.xml", "no_actuator", "no actuator", "at least one"),
    "a walk on a fixed base": ("solve fixed.xml", "'walk'", "floating base"),
    "unknown base": ("solve mammal --base flying", "base", "flying", "auto, floating, fixed"),
    "unknown contacts": ("solve mammal --contacts all", "contacts", "all", "few, vertices"),
    "a base the character has not": (
        "solve mammal --base fixed",
        "base is 'fixed'",
        "auto or floating",
    ),
    "unknown goal": ("solve mammal --goal wlak", "goal 'wlak'", "walk"),
    "unknown costs": ("solve mammal --costs papr", "costs 'papr'", "paper"),
    "costs cut short": ("solve mammal --costs natur", "costs 'natur'", "natural"),
    "natural terms in Hermite": (
        f"{WALK} --costs natural --basis hermite",
        "--basis is 'hermite'",
        "'nodes'",
        "--costs paper",
    ),
    "a start for several problems": (f"{WALK} --start other.npz", "--start", "--costs paper"),
    "passes of several problems": (
        f"{WALK} --goal turn --passes 2",
        "--passes",
        "a turn of natural terms",
        "--costs paper",
    ),
    "a period without a stride": (
        f"{WALK} --costs paper --period 0.8",
        "--period",
        "--costs natural",
        "walk, stride, turn",
    ),
    "a period of a stand": (f"{WALK} --goal stand --period 0.8", "--period", "walk, stride, turn"),
    "no period": (f"{WALK} --period 0", "--period", "positive"),
    "unknown basis": (f"{WALK} --basis spline", "basis 'spline'", "hermite, nodes"),
    "unknown device": (f"{WALK} --device gpu", "device 'gpu'", "cpu"),
    "no GPU": (f"{WALK} --device cuda", "device 'cuda'", "cannot be used", "cpu"),
    "speed that is no number": ("solve mammal --speed fast", "--speed", "'fast'", "finite number"),
    "speed not finite": ("solve mammal --speed nan", "--speed", "'nan'", "finite number"),
    "height not finite": ("solve mammal --goal jump --height inf", "--height", "finite number"),
    "no time": ("solve mammal --seconds 0", "--seconds", "positive"),
    "negative time": ("solve mammal --seconds -2", "--seconds", "positive"),
    "no time step": ("solve mammal --dt 0", "--dt", "positive"),
    "seconds no multiple of dt": (
        "solve mammal --seconds 1.01",
        "seconds/dt is 40.4",
        "whole to 1e-06",
        "--seconds 1",
    ),
    "shorter than one step": (
        "solve mammal --seconds 0.01",
        "seconds/dt is 0.4",
        "at least 1",
        "--seconds 0.025",
    ),
    "no multiple of a Hermite segment": (
        "solve mammal --basis hermite --seconds 0.875",
        "steps is 35",
        "multiple",
        "10 steps",
    ),
    "no start": ("solve mammal --seeds 0", "--seeds", "at least 1"),
    "half a start": ("solve mammal --seeds 1.5", "--seeds", "whole number"),
    "no thread": ("solve mammal --threads 0", "--threads", "at least 1"),
    "no iteration": ("solve mammal --max-iterations 0", "--max-iterations", "at least 1"),
    "no pass": ("solve mammal --passes 0", "--passes", "at least 1"),
    "negative seed": ("solve mammal --seed -1", "--seed", "at least 0"),
    "negative tolerance": ("solve mammal --tolerance -1", "--tolerance", "positive"),
    "no time for it": ("solve mammal --time-limit 0", "--time-limit", "positive"),
    "unknown friction": (
        f"{WALK} --friction ice",
        "friction is 'ice'",
        "coulomb[:MU]",
        "viscous[:RATIO]",
    ),
    "negative friction": (f"{WALK} --friction -0.5", "friction is '-0.5'", "positive"),
    "friction without its number": (
        f"{WALK} --friction coulomb:",
        "friction is 'coulomb:'",
        "positive",
    ),
    "unknown terrain": (f"{WALK} --terrain moon", "terrain 'moon'", "plane", "slope:DEGREES"),
    "a wall for a slope": (f"{WALK} --terrain slope:95", "slope:95", "between -90 and 90"),
    "a slope without degrees": (
        f"{WALK} --terrain slope:steep",
        "slope:steep",
        "number of degrees",
    ),
    "no terrain file": (f"{WALK} --terrain nowhere.py:hills", "nowhere.py", "does not exist"),
    "no such terrain": (f"{WALK} --terrain terrains.py:hils", "'hils'", "hills"),
    "a terrain file that fails": (
        f"{WALK} --terrain raises.py:hills",
        "raises.py",
        "ModuleNotFoundError",
    ),
    "a terrain of three numbers": (
        f"{WALK} --terrain terrains.py:vector",
        "terrains.py:vector",
        "one CasADi expression",
    ),
    "a terrain without the point": (
        f"{WALK} --terrain terrains.py:constant",
        "terrains.py:constant",
        "of the point",
    ),
    "a terrain that fails": (
        f"{WALK} --terrain terrains.py:broken",
        "terrains.py:broken",
        "cannot be evaluated",
    ),
    "unknown pose": (
        f"{WALK} --pose home",
        "pose 'home'",
        "'mammal' has no names",
        ".json, .npy, .txt",
    ),
    "missing pose file": (f"{WALK} --pose nowhere.npy", "nowhere.npy", "does not exist"),
    "a pose of three numbers": (f"{WALK} --pose short.json", "short.json", "(3,)", "(18,)"),
    "a pose of words": (f"{WALK} --pose words.json", "words.json", "list of numbers"),
    "a torn pose file": (f"{WALK} --pose torn.json", "torn.json", "list of numbers"),
    "a pose that is not finite": (f"{WALK} --pose nan.txt", "nan.txt", "not finite at index 0"),
    "a robot that touches nothing": (
        "solve ghost.xml --seconds 1",
        "does not stand",
        "--pose NAME|FILE",
    ),
    "a file for a folder": (f"{WALK} --out terrains.py", "terrains.py", "cannot be written"),
    "an impossible folder": (f"{WALK} --out /dev/null/walk", "/dev/null/walk", "cannot be written"),
    "a folder for a file": (f"{WALK} --out occupied", "occupied", "report.json is a folder"),
    "no solution to start from": (
        f"{WALK} --costs paper --start nowhere.npz",
        "nowhere.npz",
        "does not exist",
    ),
    "another archive to start from": (
        f"{WALK} --costs paper --start other.npz",
        "other.npz",
        "not a solution",
    ),
    "info of nothing": ("info", "FILE or --devices"),
    "info of a missing file": ("info nowhere.urdf --json", "nowhere.urdf", "no such file"),
    "a picture of a text": ("view text.npz", "text.npz", "not a solution"),
    "a picture of another kind": ("view other.npz --out walk.bmp", "walk.bmp", ".html", ".png"),
    "a film of another command": ("view other.npz --out walk.gif", "walk.gif", "octo export"),
    "a simulation of no time": ("simulate mammal --seconds 0", "--seconds", "positive"),
}


@pytest.mark.parametrize("name", CASES)
def test_refused(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words, *expected = CASES[name]
    before = sorted(folder.rglob("*"))
    code = main(words.split())
    printed = capsys.readouterr()
    lines = [
        line for line in printed.err.splitlines() if not line.startswith("octo: using the CPU")
    ]
    assert code == 2, printed
    assert len(lines) == 1 and lines[0].startswith("octo: error: "), printed.err
    assert printed.out == ""
    for fragment in expected:
        assert fragment in lines[0], f"{fragment!r} is not in {lines[0]!r}"
    assert sorted(folder.rglob("*")) == before


def test_there_are_fifty() -> None:
    assert len(CASES) >= 50
