"""Robot files, mutated: bytes, encodings, attributes, elements, depth."""

from __future__ import annotations

import functools
import importlib.util
import json
import re
import sysconfig
from pathlib import Path
from random import Random
from xml.etree import ElementTree

import numpy as np

import octo
from octo.cli.written import finite
from octo.model.describe import describe
from octo.model.gallery import CHARACTERS
from tests.fuzz.judge import Fault, call

LARGEST = 60_000  # bytes of a file that is mutated
SHARE = (
    Path(sysconfig.get_path("purelib")) / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
)
CASES = Path(__file__).parents[1] / "inputs" / "cases"
ENCODINGS = ("utf-16", "utf-16-le", "utf-32", "latin-1", "cp037", "utf-7", "utf-8-sig")
DECLARED = (
    "utf-16",
    "latin-1",
    "ebcdic-cp-us",
    "shift_jis",
    "bogus",
    "utf-7",
    "UTF-8",
    "rot13",
    "x" * 200,
    "idna",
    "punycode",
    "zlib",
)
VALUES = (
    "nan",
    "inf",
    "-inf",
    "1e200",
    "-1e200",
    "1e308",
    "1e-308",
    "1e400",
    "-1",
    "0",
    "0 0 0",
    "1, 2, 3",
    "1 2",
    "1 2 3 4",
    "",
    " ",
    "abc",
    "${x}",
    "0x1",
    "1e",
    "1,5",
    "\u0661",
    "a" * 5000,
    "world",
    "../../x",
    "<",
    "'",
    "\n",
    "-0",
    "1_0",
    "9" * 400,
    "true",
)
ATTRIBUTE = re.compile(r'([\w:]+)="([^"]*)"')
ELEMENT = re.compile(r"<(\w+)[^<>]*?/>")


@functools.cache
def corpus() -> tuple[Path | str, ...]:
    """Robot files, and texts of characters of the gallery."""
    found: list[Path | str] = sorted(
        path for path in CASES.rglob("*.*") if path.suffix in (".xml", ".urdf")
    )
    found += sorted(SHARE.rglob("*.urdf"))
    for name in ("gymnasium", "dm_control"):
        package = importlib.util.find_spec(name)
        if package is not None and package.origin is not None:
            found += [
                path
                for path in sorted(Path(package.origin).parent.rglob("*.xml"))
                if b"<mujoco" in path.read_bytes()
            ]
    found = [path for path in found if isinstance(path, Path) and path.stat().st_size < LARGEST]
    return (*found, *map(exported, CHARACTERS))


@functools.cache
def exported(name: str) -> str:
    """A character of the gallery as MJCF."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.xml"
        octo.export_mjcf(CHARACTERS[name](), path)
        return path.read_text(encoding="utf-8")


def chain_of(links: int, kind: str) -> str:
    """A URDF of links that hang on one another."""
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    text = [f'<link name="l{k}">{inertial}</link>' for k in range(links)]
    text += [
        f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(links - 1)
    ]
    return f'<robot name="r">{"".join(text)}</robot>'


def _attribute(text: str, random: Random) -> str:
    """One attribute's value changed."""
    found = list(ATTRIBUTE.finditer(text))
    if not found:
        return text
    one = random.choice(found)
    value = random.choice((*VALUES, random.choice(found).group(2)))
    return f"{text[: one.start(2)]}{value}{text[one.end(2) :]}"


def _renamed(text: str, random: Random) -> str:
    found = list(ATTRIBUTE.finditer(text))
    if not found:
        return text
    one = random.choice(found)
    name = random.choice(("", "name", "Name", "x:y", "xmlns", random.choice(found).group(1)))
    return (
        f"{text[: one.start(1)]}{name}{text[one.end(1) :]}"
        if name
        else text[: one.start()] + text[one.end() :]
    )


def _element(text: str, random: Random) -> str:
    """One element removed, doubled or moved."""
    found = list(ELEMENT.finditer(text))
    if not found:
        return text
    one, other = random.choice(found), random.choice(found)
    kind = random.randrange(3)
    if kind == 0:
        return text[: one.start()] + text[one.end() :]
    at = one if kind == 1 else other
    return text[: at.start()] + one.group() + text[at.start() :]


def _number(text: str, random: Random) -> str:
    found = list(re.finditer(r"(?<=[\" ])-?\d+\.?\d*(?=[\" ])", text))
    if not found:
        return text
    one = random.choice(found)
    return f"{text[: one.start()]}{random.choice(VALUES)}{text[one.end() :]}"


def _nested(text: str, random: Random) -> str:
    """Deep nesting of what is known, or of what is not."""
    depth = random.choice((10, 300, 20_000))
    tag = random.choice(("body", "link", "a", "frame", "default", "geom"))
    place = text.rfind("</")
    return f"{text[:place]}{f'<{tag}>' * depth}{f'</{tag}>' * depth}{text[place:]}"


def _named(text: str, random: Random) -> str:
    """A long or odd name."""
    found = list(re.finditer(r'name="([^"]*)"', text))
    if not found:
        return text
    one = random.choice(found)
    name = random.choice(
        (
            "a" * 300,
            "a" * 100_000,
            "é" * 40,
            "a/b",
            "a b",
            "%s%n",
            "..",
            "\u202e",
            "&#10;",
            "world",
            "&amp;",
            "&#x1F600;",
        )
    )
    return (
        text.replace(f'"{one.group(1)}"', f'"{name}"')
        if random.random() < 0.7
        else f"{text[: one.start(1)]}{name}{text[one.end(1) :]}"
    )


def _long(text: str, random: Random) -> str:
    return chain_of(
        random.choice((2, 50, 400)),
        random.choice(("fixed", "fixed", "continuous", "floating", "planar")),
    )


def _entities(text: str, random: Random) -> str:
    """A document type with entities: none may be fetched, and few may grow."""
    laughs = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10))
    kinds = ('<!ENTITY l0 "ha">' + laughs, '<!ENTITY l9 SYSTEM "file:///etc/hostname">', "")
    body = text[text.find("<", text.find("?>") + 1) :]
    used = body.replace("name=", 'name2="&l9;" name=', 1)
    return f"<!DOCTYPE robot [{random.choice(kinds)}]>{used}"


MUTATIONS = (
    _attribute,
    _attribute,
    _attribute,
    _renamed,
    _element,
    _element,
    _number,
    _number,
    _number,
    _nested,
    _named,
    _named,
    _long,
    _entities,
)


def _bytes(text: str, random: Random) -> bytes:
    """As a file: mostly UTF-8, sometimes in another encoding than it says, cut, or with bytes that
    were turned over."""
    kind = random.random()
    if kind < 0.75:
        return text.encode("utf-8", "surrogatepass")
    if kind < 0.85:
        body = re.sub(r"^<\?xml[^>]*\?>", "", text)
        encoding = random.choice(ENCODINGS)
        return (
            f'<?xml version="1.0" encoding="{random.choice((*DECLARED, encoding))}"?>{body}'.encode(
                encoding, "replace"
            )
        )
    data = bytearray(text.encode("utf-8", "surrogatepass"))
    for _ in range(random.choice((1, 1, 3, 30))):
        place = random.randrange(max(1, len(data)))
        what = random.randrange(4)
        if what == 0:
            data[place : place + 1] = bytes([random.randrange(256)])
        elif what == 1:
            del data[place : place + random.choice((1, 5, 100))]
        elif what == 2:
            data[place:place] = data[place : place + random.choice((1, 5, 100))]
        else:
            del data[place:]
    return bytes(data)


def case(random: Random, folder: Path) -> None:
    chosen = random.choice(corpus())
    text = (
        chosen if isinstance(chosen, str) else chosen.read_text(encoding="utf-8", errors="replace")
    )
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        text = random.choice(MUTATIONS)(text, random)
    name = random.choice(
        ("robot.urdf", "robot.xml", "r.xml", "robot", "ro bot.urdf", "é.xml", "robot.URDF")
    )
    path = folder / name
    path.write_bytes(_bytes(text, random))
    base = random.choice(("auto", "auto", "floating", "fixed"))
    robot = call(lambda: octo.load(path, base))
    if robot is None:
        return
    x = np.zeros(robot.nx) if robot.default_pose is None else robot.default_pose
    com = call(lambda: octo.kinematics.center_of_mass(robot, x))
    if not (np.isfinite(com).all() and np.isfinite(robot.mass) and robot.mass > 0.0):
        raise Fault(f"wrong: mass {robot.mass}, centre of mass {com}")
    call(robot.summary)
    call(lambda: (repr(robot), json.dumps(finite(describe(robot)), allow_nan=False)))
    if random.random() < 0.3:
        made = folder / "again.xml"
        call(lambda: octo.export_mjcf(robot, made))
        if made.exists():
            ElementTree.parse(made)
    if random.random() < 0.3 and robot.nx < 40:
        call(
            lambda: octo.Problem(robot, steps=3, dt=0.02, costs=[octo.Effort()]).start, may_run=True
        )
