"""A motion found by its name begins as the first one stands, if it can begin in any pose."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from standing import DT, standing

import octo
from octo import motion_graph
from octo.errors import ProblemError
from octo.motion_graph import gather

LOW = 1.0  # rad, by which knees are bent more


def built(path, monkeypatch, first: float, of_itself: float, fails: bool = False) -> list:
    """The poses that a jump was asked for in, and the motions of a graph whose first motion has
    knees bent by ``first`` rad, and whose jump of its own by ``of_itself``."""
    asked: list[np.ndarray | None] = []

    def walk(robot: octo.Character, seconds: float, **how: object) -> octo.Solution:
        return standing(first, (0.0, 0.0, 0.0), steps=60)

    def jump(robot: octo.Character, seconds: float, pose=None, **how: object) -> octo.Solution:
        asked.append(pose)
        if pose is not None and fails:
            raise ProblemError("it cannot")
        return standing(of_itself if pose is None else first, (0.0, 0.0, 0.0), steps=60)

    monkeypatch.setattr(gather, "NAMED", {"walk": walk, "jump": jump})
    graph = motion_graph.build(
        octo.load("mammal"),
        ["walk", "jump"],
        path=path / "stances.graph",
        dt=DT,
        transitions=0.5,
        every=6,
        loops=0,
        executor=ThreadPoolExecutor(1),
        device="cpu",
    )
    return [asked, *graph.motions.values()]


def test_a_jump_of_another_height_is_found_again(tmp_path, monkeypatch) -> None:
    (own, again), walk, jump = built(tmp_path, monkeypatch, 0.0, LOW)
    assert own is None and np.array_equal(again, walk.x[1])
    assert jump.length == pytest.approx(walk.length, rel=1e-3)


def test_one_of_about_that_height_stays(tmp_path, monkeypatch) -> None:
    asked, walk, jump = built(tmp_path, monkeypatch, 0.0, 0.2)
    assert asked == [None] and jump.length < 0.999 * walk.length


def test_one_that_cannot_is_said(tmp_path, monkeypatch) -> None:
    with pytest.raises(ProblemError, match="motion 'jump' of mammal: it cannot"):
        built(tmp_path, monkeypatch, 0.0, LOW, fails=True)
