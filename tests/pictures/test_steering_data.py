"""The page with which a character is steered: what is in the file."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import json
import re
from pathlib import Path
from typing import Any

import blended
import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.errors import OctoError, OutputError, ProblemError
from octo.model.kinematics import body_poses
from octo.model.quaternions import rotation_of
from octo.motion_graph import MotionGraph
from octo.motion_graph.crossing import Placement
from octo.motion_graph.policy import policy
from octo.viewer.page import GRAIN
from octo.viewer.pieces import frame_seconds
from octo.viewer.steer import CARRIED, keys_of


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> MotionGraph:
    return blended.graph(tmp_path_factory.mktemp("graph") / "graph.db", blended.made_up())


def page_data(text: str) -> dict[str, Any]:
    """What the script of the page reads, its pieces with ``poses`` and ``force``."""
    found = re.search(r'id="octo-data">(.*?)</script>', text)
    assert found
    data = json.loads(found[1])
    numbers = np.frombuffer(gzip.decompress(base64.b64decode(data["numbers"])), "<i2")
    bodies, contacts, grains, at = len(data["bodies"]), len(data["contacts"]), data["grains"], 0

    def rows(count: int, width: int) -> np.ndarray:
        nonlocal at
        at += count * width
        return numbers[at - count * width : at].reshape(count, width)

    for piece in data["pieces"]:
        poses = np.cumsum(rows(piece["frames"], 7 * bodies), axis=0, dtype=np.int16)
        piece["rotation"] = poses[:, : 4 * bodies].reshape(-1, bodies, 4) * grains["rotation"]
        piece["origin"] = poses[:, 4 * bodies :].reshape(-1, bodies, 3) * grains["origin"]
        piece["force"] = rows(piece["frames"] - 1, 3 * contacts).reshape(-1, contacts, 3)
        piece["force"] = piece["force"] * grains["force"]
    assert at == len(numbers)
    return dict(data)


def test_pieces_lie_where_the_edges_of_the_graph_do(graph: MotionGraph) -> None:
    """Through all motions: bodies are where kinematics has them, laid by the file's own numbers."""
    data = page_data(octo.view(graph).text)
    robot = graph.motions["walk"].character
    assert robot is not None
    first, place = robot.base_coordinate, Placement(0.0, np.zeros(2))
    node = data["start"]
    x0 = graph.motions["walk"].x[1, first : first + 4]
    laid = Placement(x0[3], x0[:2])  # of the first piece
    crossed = 0
    for wanted in [0, 0, 1, 1, 1, 2, 2, 0, 2, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]:
        piece = data["pieces"][data["next"][node][wanted]]
        start, stop = (
            (data["names"][data["nodes"][k][0]], data["nodes"][k][1])
            for k in (piece["start"], piece["stop"])
        )
        (edge,) = graph.edges([(start, stop)])
        own = graph.motions[start[0]].x[start[1] + 1 : start[1] + edge.steps + 2]
        x = place.moved(own if edge.x is None else edge.x, first)
        turns, origin = body_poses(robot, x)
        c, s = np.cos(laid.yaw), np.sin(laid.yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        shown = piece["origin"] @ turn.T + (*laid.shift, 0.0)
        assert np.allclose(shown, origin, atol=2.0 * GRAIN)
        middle = turn @ rotation_of(piece["rotation"][20 % edge.steps, 0])
        assert np.allclose(middle, turns[20 % edge.steps, 0], atol=4.0 * GRAIN)
        place, laid = (
            place.then(edge.placement),
            laid.then(Placement(piece["end"][0], piece["end"][1:])),
        )
        crossed, node = crossed + piece["crosses"], piece["stop"]
    assert crossed >= 6


def test_forces_are_those_of_the_file_where_contacts_carry(graph: MotionGraph) -> None:
    data, weight = page_data(octo.view(graph).text), graph.motions["walk"].weight
    assert len(data["contacts"]) == 4
    for piece in data["pieces"]:
        start, stop = (
            (data["names"][data["nodes"][k][0]], data["nodes"][k][1])
            for k in (piece["start"], piece["stop"])
        )
        (edge,) = graph.edges([(start, stop)])
        force = edge.force
        if force is None:
            force = graph.motions[start[0]].contact_force[start[1] : start[1] + edge.steps]
        carried = np.where(force[..., 2:] >= 0.01 * weight, force, 0.0)
        assert not carried[:, 4:].any()  # of knees and hips, which are not in the page
        assert np.allclose(piece["force"] * weight, carried[:, :4], atol=CARRIED * weight)
    assert any(piece["force"].any() and not piece["force"].all() for piece in data["pieces"])


def test_only_what_the_policy_takes_is_in_the_page(graph: MotionGraph) -> None:
    data, moves = page_data(octo.view(graph).text), policy(graph.network, list(graph.motions))
    assert len(data["pieces"]) == len(moves.edges) < graph.network.number_of_edges()
    assert [own["name"] for own in data["motions"]] == ["walk", "left", "jump"]
    assert [own["key"] for own in data["motions"]] == ["ArrowUp", "ArrowLeft", " "]
    for node, following in zip(data["nodes"], data["next"], strict=True):
        assert all(data["pieces"][k]["start"] == data["nodes"].index(node) for k in following)


def test_keys_are_those_that_the_names_suggest_and_then_those_that_are_left() -> None:
    assert keys_of(["walk", "back", "left", "right", "jump"]) == [
        "ArrowUp",
        "ArrowDown",
        "ArrowLeft",
        "ArrowRight",
        " ",
    ]
    assert keys_of(["trot", "jump", "stride_left", "left"]) == [
        "ArrowUp",
        " ",
        "ArrowRight",
        "ArrowLeft",
    ]
    many = keys_of([f"m{k}" for k in range(7)])
    assert len({*many}) == 6 and many[5:] == [None, None]


def test_four_motions_of_ten_seconds_are_small(tmp_path: Path) -> None:
    """Moments 0.25 s apart: 160 of them, from each a transition of 1 s to each other motion."""
    given = blended.made_up(400)
    given["right"] = dataclasses.replace(given["left"], x=given["left"].x * 1.0)
    given["right"].x[:, 3] *= -1.0
    large = blended.graph(tmp_path / "large.db", given, apart=10)
    page = octo.view(large, tmp_path / "large.html")
    data = page_data(page.text)
    crossed = [piece for piece in data["pieces"] if piece["crosses"]]
    assert len(crossed) > 400 and frame_seconds(large) == 0.025
    assert (tmp_path / "large.html").stat().st_size < 15e6
    assert [path.name for path in tmp_path.glob("large.html*")] == ["large.html"]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"labels": ("a",)}, "labels is given, must be left out"),
        ({"follow": False}, "follow is given, must be left out"),
        ({"loop": True}, "loop is given, must be left out"),
        ({"apart": 0.0}, "apart is given, must be left out"),
        ({"forces": "no"}, "forces is 'no'"),
        ({"path": "graph.mp4"}, "must end in .html"),
        ({"path": "graph.db"}, "must end in .html"),
    ],
)
def test_what_a_page_of_a_graph_cannot_have_is_refused(
    graph: MotionGraph, given: dict[str, Any], told: str
) -> None:
    with pytest.raises(OctoError, match=told) as refused:
        octo.view(graph, **given)
    assert "\n" not in str(refused.value)


def test_a_graph_without_transitions_is_refused(graph: MotionGraph) -> None:
    none = MotionGraph(graph.path, frozenset(row["number"] for row in graph.table))
    with pytest.raises(ProblemError, match="needs loops or transitions"):
        octo.view(none)


def test_without_forces_there_is_no_key_for_them(graph: MotionGraph, tmp_path: Path) -> None:
    text = octo.view(graph, forces=False).text
    assert (
        page_data(text)["arrows"] is None and "contact force" not in text.rpartition("<script")[0]
    )
    with pytest.raises(OutputError, match="cannot be written"):
        octo.view(graph, tmp_path / "nowhere" / "graph.html")


def test_the_command_writes_it_and_says_where(
    graph: MotionGraph, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "graph.html"
    assert main(["graph", "page", str(graph.path), "--out", str(out)]) == 0
    assert f"written to {out}" in capsys.readouterr().out
    assert page_data(out.read_text())["motions"]
    assert main(["graph", "page", str(graph.path), "--out", "graph.gif"]) != 0
    assert "must end in .html" in capsys.readouterr().err
    assert main(["graph", "page", str(tmp_path / "none.graph")]) != 0
    assert "none.graph is not there" in capsys.readouterr().err
