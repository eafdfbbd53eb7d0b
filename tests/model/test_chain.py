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


@pytest.mark.parametrize(
    ("links", "said"), [(2, "at least 3"), (4.5, "whole number"), (-1, "at least")]
)
def test_refused(links: float, said: str) -> None:
    with pytest.raises(ValueRangeError, match=f"links is .*{said}"):
        octo.gallery.chain(links)  # type: ignore[arg-type]
