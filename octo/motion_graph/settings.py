"""What a motion graph is asked for, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

from octo import executors
from octo.checks import instance, number, positive, whole
from octo.digest import digest
from octo.errors import ProblemError, ValueRangeError, said
from octo.model import store
from octo.model.character import Character
from octo.motion_graph.crossing import Cloud
from octo.motion_graph.gather import Motions
from octo.motion_graph.named import check_name
from octo.problem.costs import Cost
from octo.problem.hard import Held, at_every_step, held
from octo.problem.joint_costs import Effort
from octo.progress import check_progress
from octo.result.solution import solution_of
from octo.solve import How

MOTIONS = ("walk", "left", "right", "jump")
BATCH = 64  # transitions
EFFORT = (Effort(),)
ITERATIONS = 300  # of a transition; most take a twentieth of it
LONGEST_NAME = 40


class Building(How, total=False):
    """What a graph is described by beside its robot and motions, and how it is solved."""

    seconds: float
    dt: float
    transitions: float
    moments: float
    every: int
    share: float
    window: float | None
    cloud: Cloud | None
    loops: int
    costs: Sequence[Cost]
    constraints: Held
    batch: int


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a build is asked for."""

    seconds: float = 10.0
    dt: float = 0.025
    transitions: float = 1.0
    moments: float = 0.25
    every: int = 1
    share: float = 1.0
    window: float | None = None
    cloud: Cloud | None = None
    loops: int = 3
    costs: Sequence[Cost] = EFFORT
    constraints: Held = "hard"
    batch: int = BATCH
    how: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Settings:
        """Of the options of a call, among which are those of octo.solve."""
        own = {name: value for name, value in given.items() if name in Building.__annotations__}
        solver = {name: own.pop(name) for name in How.__annotations__ if name in own}
        return cls(**own, how=solver)

    def check(self, robot: Character, motions: Motions, executor: Executor | None) -> None:
        """Refuse what can be refused before anything is computed."""
        instance("robot", robot, Character, "a Character: what octo.load gives")
        for name in ("seconds", "dt", "transitions", "moments"):
            positive(name, getattr(self, name), "s")
        for name, least in (("every", 1), ("loops", 0), ("batch", 1)):
            whole(name, getattr(self, name), least)
        if not 0.0 < number("share", self.share) <= 1.0:
            raise ValueRangeError(f"share is {self.share:g}, must be above 0, and at most 1")
        if self.window is not None:
            positive("window", self.window, "s")
        if self.cloud is not None and not callable(self.cloud):
            raise ProblemError(f"cloud is {said(self.cloud)}, must be a function of (robot, x)")
        check_progress(self.how.get("progress", False), None)
        executors.check_executor(executor)
        for name in ("passes", "callback"):
            if self.how.get(name) is not None:
                raise ProblemError(f"{name} is given, must be left out of a graph")
        if isinstance(motions, str) or not isinstance(motions, (Sequence, Mapping)) or not motions:
            raise ProblemError(
                f"motions is {said(motions)}, must be names such as {', '.join(MOTIONS)}, or "
                "motions by name"
            )
        if not isinstance(motions, Mapping):
            for name in motions:
                check_name(name)
        for name in motions:
            if not isinstance(name, str) or not 0 < len(name) <= LONGEST_NAME or "," in name:
                raise ProblemError(f"a motion's name is {said(name)}, must be a short word")
        if len({*motions}) < len(motions):
            raise ProblemError(f"motions {', '.join(motions)} has a name twice")
        at_every_step(held(robot, self.constraints), "a graph")
        if isinstance(self.costs, Cost) or not all(isinstance(one, Cost) for one in self.costs):
            raise ProblemError(f"costs is {said(self.costs)}, must be a list of terms")

    @property
    def progress(self) -> bool:
        return bool(self.how.get("progress", False))

    @property
    def options(self) -> dict[str, Any]:
        """Of octo.solve, for a batch of transitions."""
        given = {name: value for name, value in self.how.items() if value is not None}
        most = {} if self.how.get("options") is not None else {"max_iterations": ITERATIONS}
        return {"goal": "feasible", **most, **given, "passes": 1, "progress": False}

    @property
    def of_motions(self) -> dict[str, Any]:
        """Of octo.walk and the others."""
        own = {name: self.how.get(name) for name in ("device", "threads")}
        return {name: value for name, value in own.items() if value is not None}

    def record(self, robot: Character, motions: Motions) -> dict[str, Any]:
        """What the graph is of, as it is kept in its file."""
        named = not isinstance(motions, Mapping)
        each = dict.fromkeys(motions, "named")
        if isinstance(motions, Mapping):
            each = {name: digest(solution_of(given).x) for name, given in motions.items()}
        own = ("transitions", "moments", "every", "share", "window", "loops", "batch")
        return {
            "robot": robot.name,
            "robot's numbers": digest([store.to_plain(robot)]),
            "motions": each,
            **({"seconds": float(self.seconds), "dt": float(self.dt)} if named else {}),
            **{name: getattr(self, name) for name in own},
            "cloud": None if self.cloud is None else getattr(self.cloud, "__qualname__", "own"),
            "costs": [repr(one) for one in self.costs],
            "constraints": [repr(one) for one in held(robot, self.constraints)],
            "options": {k: repr(v) for k, v in self.options.items() if k not in ("threads",)},
        }
