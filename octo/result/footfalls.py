"""Where and when the feet of a motion touch down, and how even that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.model.feet import CARRYING, feet_of, runs, stances
from octo.result.even import even
from octo.result.gathered import gathered
from octo.result.trajectory import Trajectory

LEAST = 2  # steps, of which a spread can be told


@dataclass(frozen=True)
class Footfalls:
    """The stances of one foot that begin and end inside the motion, k of them.

    A foot is a body: heel and toe are one foot, which stands while one of them does.

    Attributes
    ----------
    foot: the body. begins, ends: (k,) s. places: (k, 3) m, of its contacts in the mean of a stance.
    """

    foot: str
    begins: Array
    ends: Array
    places: Array

    @property
    def lengths(self) -> Array:
        """(k − 1,) m, of its steps: from one place to the next, on the ground."""
        return np.asarray(np.linalg.norm(np.diff(self.places[:, :2], axis=0), axis=1))

    @property
    def periods(self) -> Array:
        """(k − 1,) s, of its steps: from one touchdown to the next."""
        return np.diff(self.begins)

    @property
    def unevenness(self) -> tuple[float, float] | None:
        """Coefficient of variation (standard deviation over mean) of the steps' lengths and of
        their periods; None of fewer than two steps."""
        if len(self.periods) < LEAST:
            return None
        length, period = (float(one.std() / one.mean()) for one in (self.lengths, self.periods))
        return length, period


def footfalls(motion: Trajectory) -> list[Footfalls]:
    """Of each foot that carries load, of which a contact counts from 2 % of mg in the mean on, as
    in :class:`octo.result.gait.Gait`; none of user-written dynamics."""
    motion = gathered(even(motion))
    robot = motion.character
    if robot is None:
        return []
    force = motion.normal_force
    loaded = (force.mean(axis=0) >= CARRYING * motion.weight) & motion.own_contacts
    contacts = [k for k, one in zip(robot.terrain_contacts, loaded, strict=True) if one]
    rows = np.flatnonzero(loaded)
    bodies = np.array([robot.contacts[k].body for k in contacts])
    made = []
    for body in feet_of(robot, contacts):
        own = rows[bodies == body]
        on = stances(force[:, own].sum(axis=1, keepdims=True), motion.weight)[:, 0]
        inside = runs(on, 0, len(on))
        place = motion.contact_point[:, own].mean(axis=1)
        made.append(
            Footfalls(
                robot.bodies[body].name,
                motion.dt * np.array([a for a, _ in inside]),
                motion.dt * np.array([b for _, b in inside]),
                np.array([place[a:b].mean(axis=0) for a, b in inside]).reshape(-1, 3),
            )
        )
    return made
