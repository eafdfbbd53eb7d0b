"""A stride laid along the path of a journey, with the problems that enter and leave it."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from octo.checks import Array
from octo.motions.journey import BEGUN, Journey
from octo.problem.closure import along_arc, plane_normal
from octo.problem.hard import standing
from octo.problem.problem import Problem
from octo.result.solution import Solution


class Path:
    """Where the steady motion of a journey is, for one stride of it.

    Place s of the path is where the steady motion is after s steps. The stride, tiled, is entered
    at its node laps·count + phase, which stands at place BEGUN·ends, and left ``length`` steps
    before the end.
    """

    def __init__(self, journey: Journey, stride: Solution, pose: Array | None = None):
        assert stride.cycle is not None
        self.journey, self.stride, self.pose = journey, stride, pose
        self.count = round(stride.cycle.period / journey.dt)  # steps of the stride
        given = {"costs": journey.terms, "parameters": ground_law(stride)}
        self.rest = journey.whole.replace(**given, **({} if pose is None else {"pose": pose}))
        self.normal = plane_normal(self.rest.terrain, self.rest.values)
        self.ends = journey.ends(self.count)  # steps in which it is entered
        self.laps = 1 + -(-self.ends // self.count)
        self.tiled = stride.tile(2 * self.laps + 2 + journey.steps // self.count)

    @cached_property
    def scout(self) -> Path:
        """The same with limits that are priced, where some must hold: ways into the stride and out
        of it are looked for there, in a fifth of the time."""
        if self.journey.priced is self.journey:
            return self
        return Path(self.journey.priced, self.stride, self.pose)

    @property
    def phases(self) -> int:
        """How many phases of the stride differ: half a stride later a mirrored one is entered as
        in a mirror."""
        assert self.stride.cycle is not None
        return self.count // 2 if self.stride.cycle.mirrored else self.count

    def entry(self, phase: int) -> int:
        """The node of the tiled stride at which it is entered."""
        return self.laps * self.count + phase

    def exit(self, phase: int, length: int) -> int:
        """The node of the tiled stride at which it is left, ``length`` steps before the end."""
        return self.entry(phase) + self.journey.steps - self.ends - length

    def between(self, phase: int, length: int) -> Array:
        """(…, n) nodes of the stride between the pieces that enter and leave it."""
        nodes = slice(self.entry(phase) + 2, self.exit(phase, length) + 2)
        return self._placed(self.tiled.x[nodes], phase)

    def enter(self, phase: int) -> tuple[Problem, Array]:
        """From rest into the stride, and a first guess: standing blended into the stride."""
        node = self.entry(phase)
        stride = self._placed(self.tiled.x[node - self.ends + 1 : node + 2], phase)
        velocity = (stride[-1] - stride[-2]) / self.journey.dt
        problem = self.rest.replace(steps=self.ends, x_end=stride[-1], v_end=velocity)
        return problem, blend(np.broadcast_to(problem.start, stride.shape), stride)

    def leave(self, phase: int, length: int) -> tuple[Problem, Array]:
        """From the stride to rest in ``length`` steps, and a first guess."""
        node = self.exit(phase, length)
        stride = self._placed(self.tiled.x[node : node + length + 2], phase)
        velocity = (stride[1] - stride[0]) / self.journey.dt
        end = self._moved(self.rest.start, self.journey.steps / self.journey.faster(self.count))
        problem = self.rest.replace(
            steps=length,
            x0=stride[1],
            pose=None,
            v0=velocity,
            x_end=end,
            v_end=0.0 * end,
            constraints=[
                standing(one.placed(self.rest.setting), self.rest.start)
                for one in self.journey.constraints
            ],
        )
        return problem, blend(stride[1:], np.broadcast_to(end, stride[1:].shape))

    def _placed(self, x: Array, phase: int) -> Array:
        """Nodes (…, n) of the tiled stride where they stand on the path."""
        return self._moved(x, BEGUN * self.ends - self.entry(phase))

    def _moved(self, x: Array, places: float) -> Array:
        """Configurations (…, n) carried along the path by so many places."""
        journey, x = self.journey, x.copy()
        first = journey.robot.base_coordinate
        duration, factor = places * journey.dt, journey.faster(self.count)
        angle = factor * journey.rate * duration
        shift = along_arc(factor * np.array(journey.velocity), angle, duration)
        c, s = np.cos(angle), np.sin(angle)
        middle = self.rest.start[first : first + 2]
        before = x[..., first : first + 2].copy()
        x[..., first : first + 2] = middle + (before - middle) @ np.array([[c, s], [-s, c]]) + shift
        x[..., first + 2] -= (x[..., first : first + 2] - before) @ self.normal[:2] / self.normal[2]
        x[..., first + 3] += angle
        return x


def blend(one: Array, other: Array) -> Array:
    """(N+1, n) from one motion into the other, with weights 3w² − 2w³ (docs/notes/cycles.md)."""
    w = np.linspace(0.0, 1.0, len(one))[:, None]
    part = 3.0 * w**2 - 2.0 * w**3
    return (1.0 - part) * one + part * other


def ground_law(stride: Solution) -> dict[str, float]:
    """The parameters of the contact law that a stride was solved with, in its last pass."""
    return {name: value for name, value in stride.parameters.items() if name.startswith("contact.")}
