"""The moving page: what is in the file."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import json
import re
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import motions
import msgspec
import numpy as np
import pytest
import zstandard

from octo.errors import MissingExtraError, ModelError, OutputError, ShapeError
from octo.model.gallery import CHARACTERS
from octo.model.kinematics import body_poses
from octo.result.solution import Solution
from octo.soft.skin import SHADES
from octo.viewer import view
from octo.viewer.page import GRAIN, in_words


def recorded(path: Path) -> dict[str, Any]:
    """The scene in the file: viser's messages with their times."""
    found = re.search(r'__VISER_EMBED_DATA__="([^"]*)"', path.read_text())
    assert found
    data = base64.b64decode(found[1])
    size = int.from_bytes(data[:8], "little")
    plain = zstandard.ZstdDecompressor().decompress(data[8:], max_output_size=size)
    size = int.from_bytes(plain[:8], "little")
    return dict(msgspec.msgpack.decode(plain[8 : 8 + size]))


def page_data(path: Path) -> dict[str, Any]:
    """What the script of the page reads, with its numbers as arrays."""
    found = re.search(r'id="octo-data">(.*?)</script>', path.read_text())
    assert found
    data = json.loads(found[1])
    numbers = np.frombuffer(gzip.decompress(base64.b64decode(data["numbers"])), "<f4")

    def unpacked(value: Any) -> Any:
        place = isinstance(value, list) and len(value) == 2 and all(type(v) is int for v in value)
        return numbers[value[0] : value[0] + value[1]] if place else value

    characters = [{k: unpacked(v) for k, v in c.items()} for c in data["characters"]]
    return {k: unpacked(v) for k, v in data.items()} | {"characters": characters}


def turning(rate: float) -> Solution:
    """A cycle: it ends in the pose in which it began, further along a circle; rad/s."""
    steps = 60
    solution = motions.wandering(CHARACTERS["mammal"](), steps, dt=2.0 * np.pi / 4.0 / steps)
    x, angle = solution.x.copy(), rate * solution.dt * np.arange(-1, steps + 1)
    x[:, 0] = 0.5 / rate * np.sin(angle)
    x[:, 1] = 0.5 / rate * (1.0 - np.cos(angle))
    x[:, 3] = angle
    return dataclasses.replace(solution, x=x)


@pytest.mark.parametrize("name", CHARACTERS)
def test_bodies_are_where_kinematics_has_them(name: str, tmp_path: Path) -> None:
    character = CHARACTERS[name]()
    solution = motions.wandering(character, steps=20, dt=0.05)
    view(solution, tmp_path / "motion.html")
    data = page_data(tmp_path / "motion.html")
    shown = data["characters"][0]
    assert np.allclose(data["times"], solution.times)
    _, origin = body_poses(character, solution.x[1:])
    drawn = [int(path.rpartition("/")[2].partition("_")[0]) for path in shown["bodies"]]
    assert np.allclose(shown["origin"].reshape(21, -1, 3), origin[:, drawn], atol=GRAIN)
    assert {f"/world/0_{name}/{b}_{character.bodies[b].name}" for b in drawn} == set(
        shown["bodies"]
    )


def test_viser_has_the_still_scene_alone(tmp_path: Path) -> None:
    view(motions.wandering(CHARACTERS["mammal"](), steps=20), tmp_path / "motion.html")
    scene, data = recorded(tmp_path / "motion.html"), page_data(tmp_path / "motion.html")
    assert scene["durationSeconds"] == 0.0  # viser hides its own player then
    (shown,) = data["characters"]
    nodes = {
        *shown["bodies"],
        *shown["feet"],
        shown["arrows"],
        data["grounds"][0]["name"],
        "/world",
    }
    assert nodes <= {message.get("name") for _, message in scene["messages"]}


@pytest.mark.timed
def test_ten_seconds_are_quick_and_small(tmp_path: Path) -> None:
    solution = motions.wandering(CHARACTERS["mammal"](), steps=400)
    began = time.perf_counter()
    view(solution, tmp_path / "motion.html")
    assert time.perf_counter() - began < 20.0  # 1–2 s on an idle machine
    assert (tmp_path / "motion.html").stat().st_size < 1.5e6
    assert [path.name for path in tmp_path.iterdir()] == ["motion.html"]


def test_steps_of_milliseconds_make_thirty_frames_a_second(tmp_path: Path) -> None:
    solution = motions.wandering(CHARACTERS["bird"](), steps=4000, dt=0.001)
    view(solution, tmp_path / "motion.html")
    data = page_data(tmp_path / "motion.html")
    assert data["times"][1] == pytest.approx(0.033) and data["times"][-1] == pytest.approx(4.0)
    shown = data["characters"][0]
    assert shown["chartStep"] == pytest.approx(0.003)
    torque = shown["torque"].reshape(-1, solution.u.shape[1])
    assert torque.max(axis=0) == pytest.approx(solution.u.max(axis=0), abs=1e-3)  # no peak is lost


def test_the_camera_follows_and_feet_change_colour(tmp_path: Path) -> None:
    view(motions.wandering(CHARACTERS["mammal"](), steps=120), tmp_path / "motion.html")
    data = page_data(tmp_path / "motion.html")
    shift = data["shift"].reshape(-1, 3)
    assert shift[-1, 0] - shift[0, 0] == pytest.approx(1.5, abs=0.15)
    carries = data["characters"][0]["carries"].reshape(len(shift), -1)
    assert (carries.min(axis=0) == 0.0).all() and (carries.max(axis=0) == 1.0).all()
    view(
        motions.wandering(CHARACTERS["mammal"](), steps=120), tmp_path / "still.html", follow=False
    )
    assert np.ptp(page_data(tmp_path / "still.html")["shift"].reshape(-1, 3), axis=0).max() == 0.0


def test_title_legend_and_charts(tmp_path: Path) -> None:
    solution = motions.wandering(CHARACTERS["mammal"](), steps=80)
    view(solution, tmp_path / "motion.html")
    text = (tmp_path / "motion.html").read_text()
    assert (
        "<h1>mammal: 2 s, 1.00 m at 0.50 m/s</h1>" in text and "<title>mammal: 2 s</title>" in text
    )
    assert solution.status.value in text
    for entry in ("foot", "loaded foot", "contact force (0.1 m is "):
        assert f"</i>{entry}" in text
    shown = page_data(tmp_path / "motion.html")["characters"][0]
    assert shown["contacts"] == list(solution.contact_names)
    assert np.array_equal(shown["contactLoaded"].reshape(80, -1), solution.loaded)
    assert shown["joints"] == list(solution.actuated_names) and set(shown["units"]) == {"N m"}
    view(solution, tmp_path / "motion.html", forces=False)
    assert "contact force" not in (tmp_path / "motion.html").read_text().rpartition("<script")[0]


def test_two_side_by_side_on_hills(tmp_path: Path) -> None:
    mammal = motions.wandering(CHARACTERS["mammal"](), steps=20, hills=0.05)
    spider = motions.wandering(CHARACTERS["spider"](), steps=30, hills=0.05)
    view([mammal, spider], tmp_path / "both.html", labels=("plan", "<plant>"))
    names = {message.get("name") for _, message in recorded(tmp_path / "both.html")["messages"]}
    trunks = {"/world/0_mammal/0_trunk", "/world/1_spider/0_trunk"}
    assert {*trunks, "/world/ground_0", "/world/ground_1"} <= names
    text = (tmp_path / "both.html").read_text()
    assert (
        "<title>mammal, spider" in text
        and "</i>plan</li>" in text
        and "</i>&lt;plant&gt;</li>" in text
    )
    view([mammal, mammal], tmp_path / "both.html")
    labels = [c["label"] for c in page_data(tmp_path / "both.html")["characters"]]
    assert labels == ["mammal 1", "mammal 2"]


def test_two_soft_bodies_side_by_side_keep_their_shades(tmp_path: Path) -> None:
    ball = motions.swinging()
    view([ball, ball], tmp_path / "both.html")
    colors = [
        message["props"]["color"]
        for _, message in recorded(tmp_path / "both.html")["messages"]
        if re.fullmatch(r"/world/[01]_ball/0_ball(/part_1)?", message.get("name", ""))
        and "color" in message.get("props", {})
    ]
    assert len({tuple(color) for color in colors}) == len(colors) == 4
    for dark, light in (colors[:2], colors[2:]):
        np.testing.assert_allclose(dark, np.array(light) * SHADES[0] / SHADES[1], atol=1.0)


@pytest.mark.parametrize("rate", [1e-9, 0.6])
def test_a_lap_goes_on_where_the_last_one_ended(rate: float, tmp_path: Path) -> None:
    view(turning(rate), tmp_path / "motion.html", loop=True)
    data = page_data(tmp_path / "motion.html")
    assert data["loop"] is True
    yaw, way = data["cycle"]["yaw"], np.array(data["cycle"]["way"])
    assert yaw == pytest.approx(0.5 * np.pi * rate, abs=1e-6)
    turn = np.array(
        [[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
    )
    shift, origin = data["shift"].reshape(61, 3), data["characters"][0]["origin"].reshape(61, -1, 3)
    for place in (shift, origin):
        assert np.allclose(place[0] @ turn.T + way, place[-1], atol=2e-3)


def test_what_loops(tmp_path: Path) -> None:
    file = tmp_path / "motion.html"
    straight = turning(1e-9)
    view(straight, file)
    assert page_data(file)["loop"] is False and page_data(file)["cycle"] is None
    # whatever says that it is one
    object.__setattr__(straight, "cycle", SimpleNamespace(mirrored=False))
    view(straight, file)
    assert page_data(file)["loop"] is True
    assert "one cycle of 1.5708 s, repeated" in file.read_text()
    view(motions.wandering(CHARACTERS["mammal"](), hills=0.05), file, loop=True)
    assert page_data(file)["cycle"] is None  # the next lap would be on other hills


def test_a_motion_in_words() -> None:
    assert in_words(turning(0.6), loop=False) == "1.5708 s, 0.76 m at 0.48 m/s, turns 54° left"
    still = motions.wandering(CHARACTERS["mammal"]())
    still.x[:, 0] = 0.0
    assert in_words(still, loop=False) == "1 s, on the spot"


def test_one_step(tmp_path: Path) -> None:
    view(motions.wandering(CHARACTERS["bird"](), steps=1), tmp_path / "motion.html")
    view(motions.wandering(CHARACTERS["bird"](), steps=1), tmp_path / "motion.html", loop=True)


def test_what_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chain = motions.wandering(CHARACTERS["chain"](), steps=3)
    with pytest.raises(ModelError, match="user-written"):
        view(motions.custom(), tmp_path / "motion.html")
    with pytest.raises(ShapeError, match="one Solution or more"):
        view([], tmp_path / "motion.html")
    with pytest.raises(
        ShapeError, match=r"labels has shape \(2,\), expected one for each solution"
    ):
        view(chain, tmp_path / "motion.html", labels=("plan", "plant"))
    with pytest.raises(OutputError, match="cannot be written"):
        view(chain, tmp_path / "nowhere" / "motion.html")
    assert not list(tmp_path.iterdir())

    def server(**options: object) -> None:
        raise ModuleNotFoundError("No module named 'websockets'")

    with (
        monkeypatch.context() as patch,
        pytest.raises(MissingExtraError, match=r"websockets.*'view'"),
    ):
        patch.setattr("viser.ViserServer", server)
        view(chain, tmp_path / "motion.html")
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtraError, match="'view'"):
        view(chain, tmp_path / "motion.html")
