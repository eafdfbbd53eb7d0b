"""The robot files of the installed packages example-robot-data, gymnasium and dm_control."""

from __future__ import annotations

import importlib.util
import sysconfig
import warnings
from functools import cache
from pathlib import Path

import mujoco
import pytest

from octo.model.character import Character
from octo.model.load import load

SHARE = (
    Path(sysconfig.get_path("purelib")) / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
)
URDFS = sorted(SHARE.rglob("*.urdf"))


def urdf_named(end: str) -> Path:
    """The URDF whose path ends like this."""
    found = [path for path in URDFS if str(path).endswith(f"/{end}")]
    return found[0] if found else pytest.skip("example-robot-data is not installed")


def package(name: str) -> Path | None:
    found = importlib.util.find_spec(name)
    return None if found is None or found.origin is None else Path(found.origin).parent


@cache
def mjcfs() -> tuple[Path, ...]:
    """The files of the two packages that MuJoCo compiles and in which something moves."""
    folders = [
        folder for folder in (package("gymnasium"), package("dm_control")) if folder is not None
    ]
    return tuple(
        path for folder in folders for path in sorted(folder.rglob("*.xml")) if _moves(path)
    )


def _moves(path: Path) -> bool:
    if b"<mujoco" not in path.read_bytes() or b"joint" not in path.read_bytes():
        return False
    try:
        return compiled(path).njnt > 0
    except ValueError:
        return False


@cache
def compiled(path: Path) -> mujoco.MjModel:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return mujoco.MjModel.from_xml_path(str(path))


@cache
def loaded(path: Path) -> Character:
    return load(path)
