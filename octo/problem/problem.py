"""Describe: what moves, for how long, towards what. A Problem holds no arrays of a solve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, Literal

import numpy as np

from octo.checks import (
    MOST_STEPS,
    Array,
    asked,
    instance,
    number,
    numbers,
    owned,
    positive,
    time_step,
    whole,
)
from octo.dynamics.evaluate import Dynamics, RobotDynamics, check_surroundings, modelled
from octo.dynamics.laws import ContactLaw
from octo.errors import ProblemError, UnknownNameError, said
from octo.model.character import Character
from octo.model.scene import Scene
from octo.model.terrain import Ground
from octo.problem import scales
from octo.problem.basis import Basis, Hermite, basis_named
from octo.problem.closure import Closure, closure_of
from octo.problem.constraints import Constraint
from octo.problem.costs import Cost, SizedCost
from octo.problem.cycle import Cycle
from octo.problem.duration import range_of, within
from octo.problem.ends import STATES, check_ends, check_free
from octo.problem.joint_costs import PoseTarget
from octo.problem.lists import constraints_of, costs_of, sized
from octo.problem.starts import check_above, static_start
from octo.problem.step_limit import checked_step_limit
from octo.problem.step_pairs import basis_of
from octo.problem.symbols import Setting
from octo.problem.terms import Term
from octo.shown import Shown, listed

ANCHOR = "Anchor"  # the term that holds a cycle in place …
HOLD = 1e4  # … with this weight: on an arc it says how far the middle is, to micrometres


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Problem(Shown):
    """Minimise E subject to C = 0 (Eqs. 7 and 8) over a trajectory of ``steps`` steps of ``dt``
    seconds.

    Parameters
    ----------
    model: a Character, a Scene, or any Dynamics (user-written: CustomDynamics).
    steps: N.
    dt: s; where the duration is free it is where the search begins.
    costs: the terms of E.
    constraints: what must hold; a term of E among them means its hard form.
    basis: "nodes", "hermite", or a basis object.
    terrain, law: the ground and the contact law, for a Character.
    x0: (nx,) the start; by default a static pose near the character's default pose.
    pose: (nx,) the pose a static start is searched from, instead of the character's default one; or
        "balanced": the default one with the joints moved so that all feet carry, where that stands
        (what cycles begin with).
    v0: (nx,) its velocity; zero by default.
    x_end, v_end: (nx,) a fixed last state; free by default.
    displacement: (nx,) in place of x_end: the last configuration is the start moved by this,
        whatever the start of a pass is.
    cycle: the motion repeats itself (nodes only): x_0 and v_0 are unknown. Of steps and dt one or
        none need be given, the other follows from the period; the term "Anchor" is added, which
        holds the cycle in place and costs (almost) nothing.
    duration: s, (shortest, longest): dt is an unknown too, the same for all steps, and the motion
        takes as long as is best (of a cycle its period, of a whole stride). The term
        "DurationRange" is added to the constraints; ``octo.Duration`` prices time. By default
        steps·dt.
    parameters: run-time parameters of the dynamics by name ("contact.w_perp", "gravity_z", …).
    step_limit: of dynamics that you wrote, the largest change a step, a number or (nx,): a motion
        that :func:`octo.solve` finds and that leaps further is solved on with an octo.StepLimit of
        it. "auto" is 1, None allows all; an octo.StepLimit among the constraints takes its place.

    Arrays, lists and dicts are copied: a problem, and the terms it holds, do not change with what
        they were made from.

    Raises
    ------
    ProblemError, ShapeError, ValueRangeError, UnknownNameError: naming the field and what is
        allowed.
    """

    model: Character | Scene | Dynamics = field(kw_only=False)
    steps: int = 0
    dt: float = 0.0
    costs: Sequence[Cost]
    basis: str | Basis = "nodes"
    terrain: Ground | None = None
    law: ContactLaw | None = None
    x0: Array | None = None
    pose: Array | Literal["balanced"] | None = None
    v0: Array | None = None
    x_end: Array | None = None
    v_end: Array | None = None
    displacement: Array | None = None
    cycle: Cycle | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    constraints: Sequence[Constraint | Cost] = ()
    duration: tuple[float, float] | None = None
    step_limit: float | Array | Literal["auto"] | None = "auto"

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", modelled(self.model))
        if self.cycle is not None:
            self._check_cycle(self.cycle)
        whole("steps", self.steps, most=MOST_STEPS)
        rounds = 1 if self.cycle is None else self.cycle.rounds
        users = isinstance(self.model, Dynamics) and not isinstance(self.model, RobotDynamics)
        if self.duration is not None:
            low, high = range_of(self.duration, self.steps * rounds, not users)
            object.__setattr__(self, "duration", (low, high))
            if self.dt == 0:
                object.__setattr__(self, "dt", float(np.sqrt(low * high)) / self.steps)
        if users:
            positive("dt", self.dt, "s")  # in units of the user's own
        else:
            time_step(self.dt)
        check_surroundings(self.terrain, self.law, self.model)
        limit = checked_step_limit(self.step_limit, self.dynamics.nx, users)
        object.__setattr__(self, "step_limit", limit)
        object.__setattr__(self, "costs", costs_of(self.costs))
        hard = within(constraints_of(self.constraints), self.costs, self.duration, rounds)
        object.__setattr__(self, "constraints", hard)
        object.__setattr__(
            self,
            "parameters",
            owned(instance("parameters", self.parameters, Mapping, "numbers by name")),
        )
        self.basis_object.check(self.steps)
        if isinstance(self.pose, str) and self.pose != "balanced":
            raise UnknownNameError("pose", self.pose, ("balanced",))
        for name in STATES if isinstance(self.pose, str) else (*STATES, "pose"):
            self._check_state(name)
        check_ends(vars(self))
        ends = self.displacement if self.x_end is None else self.x_end
        if ends is not None:
            # refuses too few steps
            self.basis_object.fixed_end(int(self.steps), ends, ends, float(self.dt))
        self.p  # noqa: B018  (names and values of the parameters are checked here)
        for name in ("x0", "x_end"):
            check_above(name, getattr(self, name), self.character, self.terrain, self.values)
        self._size_costs()
        if self.anchor is not None and ANCHOR not in [term.label for term in self.costs]:
            object.__setattr__(self, "costs", (*self.costs, self.anchor))

    def __repr__(self) -> str:
        robot, seconds = self.character, self.steps * self.dt
        what = self.dynamics.name if robot is None else robot.name
        if robot is None and self.dynamics.names is None:
            what = f"{self.dynamics.nx} coordinates of the user's dynamics"
        begin = "a given state" if self.x0 is not None else "a static pose"
        end = "a free end" if self.x_end is None and self.displacement is None else "a fixed end"
        return "\n".join(
            [
                f"Problem of {what}: {self.steps} steps of {self.dt:.6g} s ({seconds:.6g} s), "
                f"{self.basis_object.name}",
                listed("terms", [term.label for term in self.costs]),
                *self._constraints_in_words(),
                "  a stride that repeats itself"
                if self.cycle is not None
                else f"  from {begin} to {end}",
            ]
        )

    @property
    def _hard(self) -> list[Constraint]:
        """The constraints, which are no costs any more."""
        return [term for term in self.constraints if isinstance(term, Constraint)]

    def _constraints_in_words(self) -> list[str]:
        names = [term.label for term in self.constraints]
        return [listed("constraints", names)] if names else []

    def _check_cycle(self, cycle: Cycle) -> None:
        """Refuse what no cycle has, and fill in steps and dt."""
        if not isinstance(cycle, Cycle):
            raise ProblemError(f"cycle is {said(cycle)}, must be an octo.Cycle")
        if self.steps != 0:
            whole("steps", self.steps)
        if self.dt != 0:
            positive("dt", self.dt, "s")
        if isinstance(basis_named(self.basis), Hermite):
            raise ProblemError(
                "a cycle is solved in the nodes basis: basis is 'hermite', must be 'nodes'"
            )
        check_free(vars(self))
        steps, dt = cycle.sampling(int(self.steps), float(self.dt))
        object.__setattr__(self, "steps", steps)
        object.__setattr__(self, "dt", dt)

    def _size_costs(self) -> None:
        """Put the terms of this robot in the place of those that waited for its length."""
        if not any(isinstance(term, SizedCost) for term in self.costs):
            return
        self.__dict__["unsized"] = self.costs  # for a phase, which need not begin at rest
        rest = self.cycle is None and not self.start_velocity.any()
        times: Array = self.dt * np.arange(1.0, self.steps + 1.0) if rest else np.full(1, np.inf)
        object.__setattr__(self, "costs", sized(self.costs, self.length, times))

    def _check_state(self, name: str) -> None:
        value = getattr(self, name)
        if value is not None:
            object.__setattr__(self, name, owned(numbers(name, value, (self.dynamics.nx,))))

    @cached_property
    def dynamics(self) -> Dynamics:
        if isinstance(self.model, Dynamics):
            return self.model
        return RobotDynamics(self.model, self.law, self.terrain)

    @property
    def character(self) -> Character | None:
        return self.dynamics.character if isinstance(self.dynamics, RobotDynamics) else None

    @cached_property
    def basis_object(self) -> Basis:
        return basis_of(self.basis, self.costs, self.cycle is not None)

    @cached_property
    def closure(self) -> Closure | None:
        """How the cycle closes; None for a problem without one."""
        if self.cycle is None:
            return None
        own = self.cycle, self.character, self.terrain, self.values
        return closure_of(*own, lambda: self.start)

    @cached_property
    def anchor(self) -> PoseTarget | None:
        """What holds a cycle in place: its last state where the start is carried to; None for a
        problem without one."""
        if self.closure is None:
            return None
        end = self.closure.forward @ self.start + self.closure.forward_constant
        return PoseTarget(
            weight=HOLD, target=end, coordinates=self.closure.held, at="last", name=ANCHOR
        )

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """All that generated code is made of: the costs, then the constraints."""
        return *self.costs, *(term.placed(self.setting) for term in self._hard)

    @cached_property
    def p(self) -> Array:
        """(NP,) the run-time parameters of FD."""
        layout = self.dynamics.layout
        values = {"dt": self.dt, **scales.parameters(self.dynamics, self.law)}
        for name, value in self.parameters.items():
            if name not in layout.given:
                raise UnknownNameError("parameter", name, layout.given)
            values[name] = number(f"parameter {name}", value)
        return layout.pack(**values)

    @property
    def values(self) -> dict[str, float]:
        """The run-time parameters of FD by name."""
        return self.dynamics.layout.named(self.p)

    @cached_property
    def start(self) -> Array:
        """(nx,) x_0: as given, or a static pose."""
        if self.x0 is not None:
            return self.x0
        if not isinstance(self.dynamics, RobotDynamics):
            rest = self.dynamics.rest(self.p)
            if rest is None:
                raise ProblemError(
                    "x0 is missing: user-written dynamics have no static pose to start from"
                )
            return rest
        found = static_start(self.dynamics, self.p, self.pose, self.cycle is not None)
        if self.dynamics.character.objects:  # which stay where they were put
            check_above("start", found, self.character, self.terrain, self.values)
        return found

    @cached_property
    def start_velocity(self) -> Array:
        return np.zeros(self.dynamics.nx) if self.v0 is None else self.v0

    @property
    def end(self) -> Array | None:
        """(nx,) x_N where it is fixed: as given, or the start and the displacement."""
        return self.x_end if self.displacement is None else self.start + self.displacement

    @property
    def size(self) -> float:
        """m, a length of the robot before its start is known."""
        return scales.size(self.character)

    @cached_property
    def gravity(self) -> float:
        """m/s², that of the parameters; 9.81 for user-written dynamics."""
        return scales.gravity(self.values)

    @cached_property
    def weight(self) -> float:
        """N, mg with g = 9.81, that forces are measured in; 1 for user-written dynamics, whose rows
        are not scaled."""
        own = self.character
        return self.dynamics.weight if own is None else scales.weight(own)

    @cached_property
    def length(self) -> float:
        """m, ℓ of the moment rows: the base's height over the lowest contact at the start."""
        own = self.character
        return self.dynamics.length(self.start) if own is None else scales.length(own, self.start)

    @cached_property
    def torque_reference(self) -> float:
        """N m, the effort's u_ref."""
        own = self.character
        return self.dynamics.effort(self.length) if own is None else scales.torque(own, self.length)

    @cached_property
    def row_scale(self) -> Array:
        """(m,) of C's rows: 1/mg for forces, 1/(mg·ℓ) for moments."""
        if self.character is None:
            return self.dynamics.row_scale(self.length)
        return scales.rows(self.character, self.length)

    @cached_property
    def setting(self) -> Setting:
        robot = self.character
        limit = robot.torque_limit if robot is not None else np.full(self.dynamics.nu, np.inf)
        return Setting(
            nx=self.dynamics.nx,
            actuated=self.dynamics.actuated,
            steps=int(self.steps),
            dt=float(self.dt),
            x0=self.start,
            torque_limit=limit,
            torque_reference=self.torque_reference,
            character=robot,
            terrain=self.dynamics.terrain if isinstance(self.dynamics, RobotDynamics) else None,
            names=self.dynamics.names,
        )

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and copies: the fields, and what makes two problems with the same fields
        differ; no generated code."""
        kept = {field.name for field in fields(self)} | {"start", "anchor", "unsized"}
        return {name: value for name, value in self.__dict__.items() if name in kept}

    def replace(self, **changes: Any) -> Problem:
        """A copy with other values. The compiled code is shared wherever the text did not change.

        Of a cycle, steps stay and dt follows from a new period or number of steps; steps follow
        from a new dt.
        """
        keeps = not ({"model", "terrain", "law"} & set(changes))
        if "parameters" in changes:
            instance("parameters", changes["parameters"], Mapping, "numbers by name")
            changes["parameters"] = {**self.parameters, **changes["parameters"]}
        cycle, costs = changes.get("cycle", self.cycle), changes.get("costs", self.costs)
        ranges = isinstance(cycle, Cycle) and isinstance(cycle.period, tuple)
        if cycle is not None and "dt" in changes:
            changes.setdefault("steps", 0)
        elif cycle is not None and (ranges or {"cycle", "steps"} & set(changes)):
            changes["dt"] = 0.0
        if cycle is None and self.anchor is not None and isinstance(costs, Sequence):
            changes["costs"] = [term for term in costs if term is not self.anchor]
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        for name in changes:
            if name not in values:
                raise UnknownNameError("field of a Problem", name, values)
        changed: Problem = object.__new__(type(self))
        for name, value in {**values, **changes}.items():
            object.__setattr__(changed, name, value)
        if keeps:  # before the checks: those of a cycle look for its start
            changed.__dict__["dynamics"] = self.dynamics
        changed.__post_init__()
        if "costs" not in changes and "unsized" in self.__dict__:
            changed.__dict__["unsized"] = self.__dict__["unsized"]
        # the new start is carried elsewhere
        if self.anchor is not None and changed.anchor is not None:
            anchored = tuple(
                changed.anchor if term is self.anchor else term for term in changed.costs
            )
            object.__setattr__(changed, "costs", anchored)
        return changed


# Not in the class: what dataclass makes of its fields is what editors complete, and stays the
# signature.
setattr(Problem, "__init__", asked(Problem.__init__))  # noqa: B010
