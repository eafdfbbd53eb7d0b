"""The gallery's chain with other numbers of links: it stands, whatever their number."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.errors import ValueRangeError

G = 9.81


@pytest.mark.parametrize("links", [3, 4, 5, 6, 9, 12])
def test_it_stands(links: int) -> None:
    robot = octo.gallery.chain(links)
    assert (robot.nx, robot.nu) == (4 + 2 * links, 2 * links - 2)
    assert robot.mass == pytest.approx(links) and len(robot.contacts) == links + 1
    problem = octo.Problem(robot, steps=4, dt=0.025, costs=[octo.Effort()])
    nodes = np.repeat(problem.start[None, None], 6, axis=1)
    fd, _ = problem.dynamics.evaluate(nodes, problem.p[None])[:2]
    assert np.abs(fd[0, :, problem.dynamics.unactuated]).max() < 1e-6 * links * G


def test_names_are_those_of_five_links() -> None:
    five, seven = octo.gallery.chain(), octo.gallery.chain(7)
    assert five.name == "chain" and [c.name for c in five.contacts][:2] == [
        "front_outer",
        "front_inner",
    ]
    assert [c.name for c in seven.contacts][:3] == ["front_outer", "front_2", "front_inner"]


def test_its_links_touch_along_their_length() -> None:
    robot, plain = octo.gallery.chain(between=3), octo.gallery.chain()
    assert [c.name for c in robot.contacts][: len(plain.contacts)] == [
        c.name for c in plain.contacts
    ]
    assert robot.pairs == plain.pairs
    for b in range(len(robot.bodies)):
        own = sorted(c.position[0] for c in robot.contacts if c.body == b)
        # the joint of an outer body with its parent has the parent's sphere
        ends = {round(x, 9) for x in own} | ({0.0} if robot.bodies[b].parent >= 0 else set())
        assert np.diff(sorted(ends)) == pytest.approx(0.1)
        assert len(ends) == 5
    with pytest.raises(ValueRangeError, match="between is -1"):
        octo.gallery.chain(between=-1)


@pytest.mark.parametrize(
    ("links", "said"), [(2, "at least 3"), (4.5, "whole number"), (-1, "at least")]
)
def test_refused(links: float, said: str) -> None:
    with pytest.raises(ValueRangeError, match=f"links is .*{said}"):
        octo.gallery.chain(links)  # type: ignore[arg-type]
