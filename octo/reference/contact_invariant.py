"""Contact-invariant optimisation (Mordatch et al. 2013), as §8.4 has it, for comparison.

Contact forces are no function of the motion here but unknowns: each configuration has three more
numbers for each contact point that somebody labelled, its force in parts of the robot's weight.
FD has no contact law; it has these forces. E_int, as printed in §8.4, says where they may be:

    E_int = Σ ‖d(P)‖² + c(f_⊥) (‖(I − nnᵀ) Ṗ‖² + ‖dist(P)‖²),   c = ½ tanh(20 ‖f_⊥‖ − 2) + ½

d is how deep P is in the ground, dist how far it is from it. As printed, nothing keeps a force from
pulling or from leaving the cone of friction. Lengths are in parts of ℓ here, velocities of √(gℓ),
forces of mg.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from octo.checks import Array, instance, positive
from octo.dynamics.evaluate import CustomDynamics, RobotDynamics
from octo.dynamics.laws import View
from octo.dynamics.symbolic import body_poses, contact_height, contact_places
from octo.errors import ProblemError, ShapeError
from octo.model.terrain import Plane, plane_of
from octo.problem.costs import Cost, CustomCost
from octo.problem.problem import Problem
from octo.problem.symbols import Setting, StepSymbols


class NoContact:
    """A law without force."""

    @property
    def parameters(self) -> Mapping[str, float]:
        return {}

    def reach(self, p: View) -> ca.SX:
        del p
        return ca.SX(0.0)

    def force(self, depth: ca.SX, normal: ca.SX, velocity: ca.SX, p: View) -> ca.SX:
        del depth, normal, velocity, p
        return ca.SX.zeros(3)


@dataclass(frozen=True, eq=False, kw_only=True)
class OfRobot(Cost):
    """A term of the robot's problem, which sees the robot's part of configurations and torques."""

    cost: Cost
    robot: RobotDynamics
    setting: Setting

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return self.cost.references(self.setting)

    def scale(self, setting: Setting) -> float:
        return self.cost.scale(self.setting)

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        n, nu = self.robot.nx, self.robot.nu
        own = StepSymbols(
            step.x_next[:n],
            step.x[:n],
            step.x_prev[:n],
            u=step.u[:nu],
            dynamics=step.dynamics,
            actuated=self.robot.actuated,
            robot=self.robot,
            calls=step.calls,
        )
        return self.cost.residual(own, p)


@dataclass(frozen=True, eq=False)
class ContactInvariant:
    """The problem, and what its solutions are of the robot.

    Attributes
    ----------
    problem: over (n + 3 labelled contacts) coordinates; C is in parts of mg and of mg·ℓ.
    robot: the problem that it was made from. contacts: names of the labelled ones.
    """

    problem: Problem
    robot: Problem
    contacts: tuple[str, ...]

    def motion(self, x: Array) -> Array:
        """(N+1, n) the robot's part of x_0 … x_N of a solution."""
        return np.ascontiguousarray(self._checked(x)[:, : self.robot.dynamics.nx])

    def forces(self, x: Array) -> Array:
        """(N, contacts, 3) N, world axes: the contact forces of a solution's x."""
        own = self._checked(x)[1:, self.robot.dynamics.nx :]
        return np.asarray(self.robot.weight * own.reshape(len(own), -1, 3))

    def _checked(self, x: Array) -> Array:
        size = self.problem.dynamics.nx
        if np.ndim(x) != 2 or np.shape(x)[1] != size:
            raise ShapeError("x", np.shape(x), f"(N+1, {size})")
        return np.asarray(x, dtype=float)


def contact_invariant(
    problem: Problem, contacts: Sequence[str] | None = None, weight: float = 100.0
) -> ContactInvariant:
    """The same task with contact forces as unknowns.

    Parameters
    ----------
    problem: of a character on a plane, from rest to a free end; its contact law is not used.
    contacts: names of the contact points that may carry; by default those that touch the ground at
        the start.
    weight: of E_int.

    Raises
    ------
    ProblemError, ValueRangeError: what it does not fit, or a contact that there is not.
    """
    dynamics = _robot_of(problem)
    robot = dynamics.character
    if isinstance(contacts, str):
        raise ProblemError(f"contacts is {contacts!r}, must be a list of names of contacts")
    feet = problem.setting.feet
    own = [robot.contact_index(name) for name in contacts] if contacts is not None else feet
    if not own:
        raise ProblemError("contacts is empty: without one nothing carries the robot")
    positive("weight", weight)
    plane = plane_of(problem.values)
    assert plane is not None  # checked
    task = _Task(problem, dynamics, tuple(own), plane[0])
    n, count = dynamics.nx, len(own)
    actuated = [*map(int, dynamics.actuated), *range(n, n + 3 * count)]
    own_values = {name: float(value) for name, value in problem.values.items()}
    made = Problem(
        CustomDynamics(task.forward_dynamics, n + 3 * count, actuated, own_values),
        steps=problem.steps,
        dt=problem.dt,
        costs=[*map(task.of_robot, problem.costs), task.interaction(weight)],
        basis=problem.basis,
        x0=np.concatenate([problem.start, np.tile(task.normal / count, count)]),
        step_limit=None,
    )
    return ContactInvariant(made, problem, tuple(robot.contacts[k].name for k in own))


@dataclass(frozen=True, eq=False)
class _Task:
    """What the parts of the problem are made of. contacts: by index. normal: (3,) of the plane."""

    problem: Problem
    dynamics: RobotDynamics
    contacts: tuple[int, ...]
    normal: Array

    def force(self, nodes: ca.SX, k: int) -> ca.SX:
        """(3,) of mg, of the k-th labelled contact."""
        first = self.dynamics.nx + 3 * k
        return nodes[first : first + 3]

    def forward_dynamics(self, x_next: ca.SX, x: ca.SX, x_prev: ca.SX, view: View) -> ca.SX:
        """FD without a contact law, less what the forces do; behind it the forces."""
        n, robot = self.dynamics.nx, self.dynamics.character
        free = RobotDynamics(robot, NoContact(), self.dynamics.terrain)
        p = ca.vertcat(*(view[name] for name in free.layout.names))
        value = free.symbolic(x_next[:n], x[:n], x_prev[:n], p)
        poses, work, held, material = body_poses(robot, x_next[:n]), ca.SX(0), [], []
        for k, contact in enumerate(self.contacts):
            sphere = robot.contacts[contact]
            rotation, position = poses[sphere.body]
            point = ca.SX.sym("P", 3)  # the virtual work of a force is on a material point
            force = self.problem.weight * self.force(x_next, k)
            work += ca.dot(force, rotation @ point + position)
            held.append(point)
            down = rotation.T @ ca.SX(ca.DM(self.normal))
            material.append(ca.SX(ca.DM(sphere.position)) - sphere.radius * down)
        carried = ca.gradient(work, x_next)[:n]
        carried = ca.substitute(carried, ca.vertcat(*held), ca.vertcat(*material))
        scale = np.ones(n)
        scale[self.dynamics.unactuated] = self.problem.row_scale
        return ca.vertcat(scale * (value - carried), x_next[n:])

    def of_robot(self, cost: Cost) -> Cost:
        """A term of the robot's problem in this one."""
        own = {name: getattr(cost, name) for name in ("weight", "at", "loss")}
        setting = self.problem.setting
        return OfRobot(cost=cost, robot=self.dynamics, setting=setting, name=cost.label, **own)

    def interaction(self, weight: float) -> Cost:
        """E_int."""
        return CustomCost(
            function=lambda step, p: self.residual(step), weight=weight, name="Interaction"
        )

    def residual(self, step: StepSymbols) -> ca.SX:
        """What E_int has the squares of, of each contact: d, √c Ṗ along the plane, √c dist."""
        robot, terrain, n = self.dynamics.character, self.dynamics.terrain, self.dynamics.nx
        length, normal = self.problem.length, ca.SX(ca.DM(self.normal))
        speed = float(np.sqrt(self.problem.gravity * length))
        next_, now = body_poses(robot, step.x_next[:n]), body_poses(robot, step.x[:n])
        rows = []
        for k, contact in enumerate(self.contacts):
            sphere = robot.contacts[contact]
            where = ca.SX(ca.DM(sphere.position)), ca.SX(sphere.radius)
            poses = next_[sphere.body], now[sphere.body]
            center, before = contact_places(*where, *poses, terrain, step.dynamics)
            gap = contact_height(sphere.radius, center, terrain, step.dynamics) / length
            moved = (center - sphere.radius * normal - before) / (step.dt * speed)
            load = ca.fabs(ca.dot(normal, self.force(step.x_next, k)))
            carries = ca.sqrt(0.5 * ca.tanh(20.0 * load - 2.0) + 0.5)
            slip = moved - normal * ca.dot(normal, moved)
            rows += [ca.fmin(gap, 0.0), carries * slip, carries * gap]
        return ca.vertcat(*rows)


def _robot_of(problem: Problem) -> RobotDynamics:
    """The robot's dynamics, of a problem that fits."""
    instance("problem", problem, Problem, "an octo.Problem")
    dynamics = problem.dynamics
    if not isinstance(dynamics, RobotDynamics) or not isinstance(dynamics.terrain, Plane):
        raise ProblemError("contact-invariant optimisation here is of a character on an octo.Plane")
    for name in ("cycle", "duration", "x_end", "displacement", "v0"):
        if getattr(problem, name) is not None:
            raise ProblemError(f"{name} is given: contact-invariant optimisation here has none")
    if problem.constraints:
        label = problem.constraints[0].label
        raise ProblemError(f"{label} is a constraint: contact-invariant optimisation has none")
    return dynamics
