"""The front door of robot files, and the summary of a character."""

from __future__ import annotations

import json
import sys

import pytest

from octo.errors import (
    MissingExtraError,
    RobotFileError,
    UnknownNameError,
    UnsupportedFeatureError,
    ValueRangeError,
)
from octo.model.describe import describe
from octo.model.gallery import CHARACTERS
from octo.model.load import load

URDF = """<robot name="pole"><link name="a"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><sphere radius=".1"/></geometry></collision></link></robot>"""


def test_gallery_names():
    for name in CHARACTERS:
        assert load(name).name == name
    with pytest.raises(ValueRangeError, match="base is 'fixed', must be auto or floating"):
        load("mammal", base="fixed")


def test_unknown_name_lists_the_nearest():
    with pytest.raises(UnknownNameError, match="'mamal' is not known; did you mean mammal"):
        load("mamal")


def test_missing_file_and_wrong_contents(tmp_path):
    with pytest.raises(RobotFileError, match="nowhere.urdf: no such file"):
        load(tmp_path / "nowhere.urdf")
    for name, text, error, message in (
        (
            "page.xml",
            "<html></html>",
            RobotFileError,
            "page.xml: top element is <html>, must be <robot>",
        ),
        ("torn.urdf", "<robot><link", RobotFileError, "torn.urdf: not well-formed XML"),
        ("empty.xml", "", RobotFileError, "empty.xml: not well-formed XML"),
        (
            "arm.xacro",
            "<robot/>",
            UnsupportedFeatureError,
            "arm.xacro: xacro macros are not expanded",
        ),
    ):
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(error, match=message):
            load(path)


def test_contents_decide_not_the_suffix(tmp_path):
    path = tmp_path / "pole.xml"
    path.write_text(URDF)
    assert load(path).name == "pole"
    assert load(str(path)).nx == 6


def test_base_must_be_known(tmp_path):
    with pytest.raises(
        ValueRangeError, match="base is 'swimming', must be one of auto, floating, fixed"
    ):
        load(tmp_path / "pole.urdf", base="swimming")


def test_mujoco_is_needed_for_files_only(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    path = tmp_path / "pole.urdf"
    path.write_text(URDF)
    with pytest.raises(MissingExtraError, match="'robots'"):
        load(path)
    assert load("chain").name == "chain"


def test_summary_is_plain_data():
    character = load("mammal")
    summary = json.loads(json.dumps(describe(character)))
    assert list(summary)[:8] == [
        "name",
        "nx",
        "nu",
        "mass",
        "bodies",
        "contacts",
        "pairs",
        "dropped",
    ]
    assert (summary["nx"], summary["nu"], summary["mass"]) == (18, 12, pytest.approx(5.0))
    assert summary["pairs"][0] == ["front_left", "front_right"]
    assert summary["bodies"][0] == "trunk"
