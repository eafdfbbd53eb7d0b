"""The moving picture: what is in the file."""

from __future__ import annotations

import base64
import re
import sys
import time
from pathlib import Path
from typing import Any

import motions
import msgspec
import numpy as np
import pytest
import zstandard

from octo.errors import MissingExtraError, ModelError, OutputError, ShapeError
from octo.model.gallery import CHARACTERS
from octo.model.kinematics import body_poses
from octo.viewer import RATE, view


def recorded(path: Path) -> dict[str, Any]:
    """The scene in the file: viser's messages with their times."""
    found = re.search(r'__VISER_EMBED_DATA__="([^"]*)"', path.read_text())
    assert found
    data = base64.b64decode(found[1])
    plain = zstandard.ZstdDecompressor().decompress(data[8:], max_output_size=int.from_bytes(data[:8], "little"))
    size = int.from_bytes(plain[:8], "little")
    return dict(msgspec.msgpack.decode(plain[8 : 8 + size]))


@pytest.mark.parametrize("name", CHARACTERS)
def test_bodies_are_where_kinematics_has_them(name: str, tmp_path: Path) -> None:
    character = CHARACTERS[name]()
    solution = motions.wandering(character, steps=20, dt=0.05)
    view(solution, tmp_path / "motion.html", follow=False)
    scene = recorded(tmp_path / "motion.html")
    assert scene["durationSeconds"] == pytest.approx(1.0 + 0.6)
    places: dict[str, list[float]] = {}
    halfway = 0.5 + 0.25 / RATE
    for seconds, message in scene["messages"]:
        if message["type"] == "SetPositionMessage" and seconds <= halfway:
            places[message["name"]] = message["position"]
    _, origin = body_poses(character, solution.x[11])
    for b, body in enumerate(character.bodies):
        assert np.allclose(places[f"/world/0_{name}/{b}_{body.name}"], origin[b], atol=0.5 * 0.25 / RATE + 2e-4), body.name


def test_ten_seconds_are_quick_and_small(tmp_path: Path) -> None:
    solution = motions.wandering(CHARACTERS["mammal"](), steps=400)
    began = time.perf_counter()
    view(solution, tmp_path / "motion.html")
    assert time.perf_counter() - began < 20.0  # 1–2 s on an idle machine
    assert (tmp_path / "motion.html").stat().st_size < 2e6
    assert [path.name for path in tmp_path.iterdir()] == ["motion.html"]


def test_the_camera_follows_and_feet_change_colour(tmp_path: Path) -> None:
    solution = motions.wandering(CHARACTERS["mammal"](), steps=120)
    view(solution, tmp_path / "motion.html")
    messages = [message for _, message in recorded(tmp_path / "motion.html")["messages"]]
    world = [m["position"][0] for m in messages if m["type"] == "SetPositionMessage" and m["name"] == "/world"]
    assert world[-1] - world[0] == pytest.approx(-1.5, abs=0.15)
    colored = [m for m in messages if m["type"] == "SceneNodeUpdateMessage" and "color" in m["updates"]]
    assert {m["name"].rpartition("/")[2] for m in colored} >= {"front_left", "hind_right"}


def test_two_side_by_side_on_hills(tmp_path: Path) -> None:
    mammal, spider = (motions.wandering(CHARACTERS[name](), steps=n, hills=0.05) for name, n in (("mammal", 20), ("spider", 30)))
    view([mammal, spider], tmp_path / "both.html")
    names = {message.get("name") for _, message in recorded(tmp_path / "both.html")["messages"]}
    assert {"/world/0_mammal/0_trunk", "/world/1_spider/0_trunk", "/world/ground_0", "/world/ground_1"} <= names
    assert "<title>mammal, spider" in (tmp_path / "both.html").read_text()


def test_one_step(tmp_path: Path) -> None:
    view(motions.wandering(CHARACTERS["bird"](), steps=1), tmp_path / "motion.html")


def test_what_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chain = motions.wandering(CHARACTERS["chain"](), steps=3)
    with pytest.raises(ModelError, match="user-written"):
        view(motions.custom(), tmp_path / "motion.html")
    with pytest.raises(ShapeError, match="one Solution or more"):
        view([], tmp_path / "motion.html")
    with pytest.raises(OutputError, match="cannot be written"):
        view(chain, tmp_path / "nowhere" / "motion.html")
    assert not list(tmp_path.iterdir())

    def server(**options: object) -> None:
        raise ModuleNotFoundError("No module named 'websockets'")

    with monkeypatch.context() as patch, pytest.raises(MissingExtraError, match=r"websockets.*'view'"):
        patch.setattr("viser.ViserServer", server)
        view(chain, tmp_path / "motion.html")
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtraError, match="'view'"):
        view(chain, tmp_path / "motion.html")
