"""What is generated once for problems whose robots say the same, whoever made them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pytest

import octo
from octo.dynamics import content
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import Coulomb, Smooth
from octo.problem.compiled import CompiledProblem
from octo.problem.structure import program_of


def problem(robot: octo.Character | None = None, effort: float = 1.0, **more) -> octo.Problem:
    robot = octo.gallery.biped() if robot is None else robot
    return octo.Problem(robot, steps=4, dt=0.05, costs=[octo.Effort(weight=effort)], **more)


@dataclass(frozen=True)
class Sticky(Smooth):
    """Says what Smooth says, and is twice as stiff."""

    def force(self, depth: ca.SX, normal: ca.SX, velocity: ca.SX, p: object) -> ca.SX:
        return 2.0 * super().force(depth, normal, velocity, p)


def heavier(robot: octo.Character) -> octo.Character:
    bodies = list(robot.bodies)
    bodies[-1] = replace(bodies[-1], mass=bodies[-1].mass * (1.0 + 1e-15) + 1e-12)
    return replace(robot, bodies=tuple(bodies))


def test_a_robot_that_is_made_again_is_the_same() -> None:
    one, other = problem(), problem(effort=2.0)
    assert one.dynamics is not other.dynamics and one.dynamics.key == other.dynamics.key
    assert program_of(one) is program_of(other)
    assert one.dynamics.lanes_text() is other.dynamics.lanes_text()
    rng = np.random.default_rng(0)
    unknowns = rng.normal(size=(1, 5, CompiledProblem([one]).nc))
    first, second = (CompiledProblem([own]).evaluate(unknowns) for own in (one, other))
    assert np.array_equal(first.fd, second.fd) and np.array_equal(2.0 * first.terms, second.terms)


@pytest.mark.parametrize(
    "changed",
    [
        lambda: problem(heavier(octo.gallery.biped())),
        lambda: problem(octo.gallery.mammal()),
        lambda: problem(law=Smooth(friction=Coulomb())),
        lambda: problem(terrain=octo.Plane(slope=0.1)),
        lambda: octo.Problem(octo.gallery.biped(), steps=4, dt=0.05, costs=[octo.Upright()]),
    ],
    ids=["a mass", "a robot", "a friction", "a slope", "a term"],
)
def test_what_differs_is_another(changed) -> None:
    own, other = problem(), changed()
    assert program_of(own) is not program_of(other)


@pytest.mark.parametrize(
    "made",
    [
        lambda: problem(law=Sticky()),
        lambda: problem(terrain=octo.Terrain(lambda point, p: point[2])),
        lambda: problem(terrain=octo.worlds.stairs()),
    ],
    ids=["a law", "a terrain", "a world"],
)
def test_of_somebodys_own_each_is_itself(made) -> None:
    one, other = made(), made()
    assert one.dynamics.key is one.dynamics and other.dynamics.key is other.dynamics
    assert program_of(one) is not program_of(other)


def test_only_the_last_few_are_kept() -> None:
    first = program_of(problem())
    for height in range(content.KEPT):
        RobotDynamics(octo.gallery.chain(), terrain=octo.Plane(height=float(height))).lanes_text()
        program_of(problem(terrain=octo.Plane(height=float(height + 1))))
    assert len(content._texts) <= content.KEPT
    assert program_of(problem()) is not first
