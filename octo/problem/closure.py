"""How a cycle closes: the last state is the first one carried on, x_N = G (x_0 − x_s) + x_s + shift
and v_N = G v_0.

x_0 and v_0 are unknown. G turns the motion by the heading's change of a stride, or mirrors it (half
a stride, left and right exchanged); x_s is the pose that the problem starts its search from: the
mirror's plane goes through it, and the turn is about it, before the shift, which itself lies along
the arc. Every residual FD_0 … FD_{N−1} is there once, and what follows from the last state is what
followed from the first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from octo.checks import Array
from octo.errors import MirrorError, ProblemError
from octo.model.character import Character
from octo.model.element import tied_to_the_world
from octo.model.mirror import Mirror, mirror_of
from octo.model.terrain import Ground, Plane
from octo.problem.cycle import Cycle

LEVEL = 1e-9  # of the normal's length: what counts as a plane without slope


@dataclass(frozen=True, eq=False)
class Closure:
    """How a cycle closes: x_N = forward x_0 + forward_constant, and back x_0 = matrix x_N +
    constant; (n, n) and (n,)."""

    forward: Array
    forward_constant: Array
    held: Array  # (n,) 1 for the coordinates of x_N that say where the motion takes place
    mirror: Mirror | None  # of the robot, where it has one
    mirrored: bool

    @cached_property
    def matrix(self) -> Array:
        return np.asarray(np.linalg.inv(self.forward), dtype=float)

    @cached_property
    def constant(self) -> Array:
        return -self.matrix @ self.forward_constant

    def along(self, start: Array, steps: int) -> Array:
        """x_{-1} … x_N (N+2, n) on the straight way from ``start`` to where the cycle carries
        it."""
        part = np.arange(-1, steps + 1)[:, None] / steps
        return np.asarray(start + part * (self.forward @ start + self.forward_constant - start))


def closure_of(
    cycle: Cycle,
    robot: Character | None,
    terrain: Ground | None,
    values: Mapping[str, float],
    start: Callable[[], Array],
) -> Closure:
    """The closure of a cycle. What can be refused is refused before a start is looked for.

    Parameters
    ----------
    robot: None for user-written dynamics.
    values: the run-time parameters of FD by name.
    start: gives x_s (n,), rad and m.

    Raises
    ------
    ProblemError: no floating base, no actuator, a ground or a gravity that is not the same after
        the stride.
    MirrorError: no mirror.
    """
    walker = _walker(robot)
    normal = plane_normal(terrain, values)
    _check_slope(cycle, normal, values)
    mirror = _mirror(walker, cycle)
    x_s, first = start(), walker.base_coordinate
    forward, constant = _carried(cycle, mirror, x_s, first)
    heading = 0.0 if cycle.mirrored else float(x_s[first + 3])
    velocity = np.array([cycle.velocity, cycle.sideways])
    step = along_arc(velocity, cycle.turn, cycle.duration, heading)
    constant[first : first + 2] += step
    constant[first + 2] -= (normal[0] * step[0] + normal[1] * step[1]) / normal[2]
    held = np.zeros(walker.nx)
    held[first] = 1.0  # on an arc x and y together say how far its middle is
    # the mirror's plane holds y and yaw; without it a sideways walk would turn and walk forward
    if not cycle.mirrored:
        held[first + 1] = held[first + 3] = 1.0
    return Closure(forward, constant, held, mirror, cycle.mirrored)


def _walker(robot: Character | None) -> Character:
    if robot is None:
        raise ProblemError(
            "cycle needs a robot: user-written dynamics have no base that a stride could carry on"
        )
    if robot.base != "floating":
        raise ProblemError(
            f"cycle needs a floating base, robot {robot.name!r} is fixed: try base='floating'"
        )
    if robot.nu == 0:
        raise ProblemError(f"cycle needs an actuator, robot {robot.name!r} has none")
    if robot.objects:
        raise ProblemError(
            f"a cycle is of a robot alone: object {robot.objects[0]!r} would not come back, leave "
            "it out"
        )
    moving = {body.name for body, path in zip(robot.bodies, robot.path, strict=True) if path}
    tied = tied_to_the_world(robot.elements, moving)
    if tied:
        raise ProblemError(
            f"a cycle goes on and on: element {tied[0]} must not hold robot {robot.name!r} to the "
            "world"
        )
    return robot


def _check_slope(cycle: Cycle, normal: Array, values: Mapping[str, float]) -> None:
    across = abs(normal[1]) > LEVEL or abs(values.get("gravity_y", 0.0)) > LEVEL
    sloped = across or abs(normal[0]) > LEVEL or abs(values.get("gravity_x", 0.0)) > LEVEL
    if cycle.mirrored and across:
        raise ProblemError(
            "a mirrored cycle needs a ground that rises along the stride only: give mirror=False"
        )
    if cycle.turn != 0.0 and sloped:
        raise ProblemError(
            "a turning cycle needs level ground: on a slope the stride after it is another one"
        )


def _carried(cycle: Cycle, mirror: Mirror | None, x_s: Array, first: int) -> tuple[Array, Array]:
    """G (n, n), and what is added to G x_0 without the shift; ``first``: of the base's
    coordinates."""
    forward, constant = np.eye(len(x_s)), np.zeros(len(x_s))
    if mirror is not None and cycle.mirrored:
        forward, constant = mirror.matrix.copy(), mirror.offset.copy()
        place = np.zeros(len(x_s))
        # the mirror's plane goes through x_s
        place[first + 1], place[first + 3] = x_s[first + 1], x_s[first + 3]
        if abs(place[first + 3]) > LEVEL:
            raise ProblemError(
                f"the start has a heading of {place[first + 3]:g} rad: a mirrored cycle goes along "
                "x, must be 0"
            )
        constant = constant + place - forward @ place
    elif cycle.turn != 0.0:
        c, s = np.cos(cycle.turn), np.sin(cycle.turn)
        plan = slice(first, first + 2)
        forward[plan, plan] = [[c, -s], [s, c]]
        constant[plan] = x_s[plan] - forward[plan, plan] @ x_s[plan]
        constant[first + 3] = cycle.turn
    return forward, constant


def _mirror(robot: Character, cycle: Cycle) -> Mirror | None:
    """The mirror of a robot; one that has none may do without where the cycle is not mirrored.

    Raises
    ------
    MirrorError: a mirrored cycle of a robot that has no mirror. ProblemError: the mirror of another
        robot.
    """
    if isinstance(cycle.mirror, Mirror):
        if cycle.mirror.matrix.shape != (robot.nx, robot.nx):
            count = len(cycle.mirror.offset)
            raise ProblemError(
                f"cycle.mirror is of a robot with {count} coordinates, {robot.name!r} has "
                f"{robot.nx}"
            )
        return cycle.mirror
    if isinstance(cycle.mirror, Mapping):
        return mirror_of(robot, cycle.mirror)
    try:
        return _own_mirror(robot)
    except MirrorError:
        if cycle.mirrored:
            raise
        return None


@lru_cache(maxsize=64)
def _own_mirror(robot: Character) -> Mirror:
    return mirror_of(robot)


def along_arc(velocity: Array, turn: float, duration: float, heading: float = 0.0) -> Array:
    """(2,) m, where a steady velocity (2,) m/s in the body's axes leads while the heading changes
    by ``turn`` rad.

    heading: rad, where it begins.
    """
    along = np.asarray(velocity, dtype=float) * duration
    c, s = np.cos(heading), np.sin(heading)
    return np.asarray(np.array([[c, -s], [s, c]]) @ _arc(turn) @ along)


def arc_to(place: Array, turn: float) -> Array:
    """(2,) m, the way in the body's axes that leads to a place (2,) m, seen from where it begins,
    while the heading changes by ``turn`` rad, less than 2π in size: :func:`along_arc` backwards."""
    return np.asarray(np.linalg.solve(_arc(turn), np.asarray(place, dtype=float)))


def _arc(turn: float) -> Array:
    """(2, 2) from a way in the body's axes to where it leads."""
    a, b = 1.0, 0.0
    if abs(turn) >= 1e-9:
        a, b = np.sin(turn) / turn, (1.0 - np.cos(turn)) / turn
    return np.array([[a, -b], [b, a]])


def plane_normal(terrain: Ground | None, values: Mapping[str, float]) -> Array:
    """(3,) of the plane that a cycle walks on.

    Raises
    ------
    ProblemError: the ground is no plane.
    """
    if not isinstance(terrain or Plane(), Plane):
        raise ProblemError(
            "a cycle needs ground that is the same everywhere: terrain must be an octo.Plane"
        )
    found = np.array([values.get(f"terrain.normal_{axis}", 0.0) for axis in "xyz"])
    return found if found.any() else np.array([0.0, 0.0, 1.0])
