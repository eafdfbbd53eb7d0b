"""A robot file with meshes, of an installed package."""

from __future__ import annotations

import sysconfig
from pathlib import Path

import pytest

import octo
from octo.model.character import Character

SHARE = Path(sysconfig.get_path("purelib")) / "cmeel.prefix" / "share" / "example-robot-data"


def go2() -> Character:
    file = SHARE / "robots" / "go2_description" / "urdf" / "go2.urdf"
    return octo.load(file) if file.is_file() else pytest.skip("example-robot-data is not there")
