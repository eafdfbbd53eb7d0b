"""The contacts of a crowd as one: what a foot that is a mesh carries, and where."""

from __future__ import annotations

import dataclasses

import numpy as np

from octo.dynamics.crowd import crowd_columns
from octo.result.trajectory import Trajectory

TINY = 1e-300  # N, beside a sum of loads that may be zero


def gathered(motion: Trajectory) -> Trajectory:
    """The motion with the forces of each crowd (octo/dynamics/crowd.py) in the column of its first
    contact: their sum, at the mean of their points by load, as deep as the deepest; the others
    carry nothing. The same motion where there is no crowd."""
    crowds = crowd_columns(motion.character)
    if not crowds:
        return motion
    names = ("contact_force", "contact_point", "contact_normal", "contact_velocity")
    force, *means = (getattr(motion, name).copy() for name in names)
    depth, load = motion.contact_depth.copy(), np.maximum(motion.normal_force, 0.0)
    for columns in crowds:
        first, rest = columns[0], columns[1:]
        part = load[:, columns] + TINY
        part /= part.sum(axis=1, keepdims=True)
        for values in means:
            values[:, first] = np.einsum("nc,ncr->nr", part, values[:, columns])
        normal = means[1][:, first]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), TINY)
        force[:, first] = force[:, columns].sum(axis=1)
        depth[:, first] = depth[:, columns].max(axis=1)
        force[:, rest] = 0.0
    found = dict(zip(names, (force, *means), strict=True))
    return dataclasses.replace(motion, **found, contact_depth=depth)
