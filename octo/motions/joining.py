"""Pieces in a row, polished as one problem that begins and ends at rest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from octo.motions.budget import Budget
from octo.motions.transitions import Pieces, stumbles
from octo.result.solution import Solution
from octo.solve import evaluated, solve
from octo.solver.status import Status

# ℓ and rad: where polishing moves the base by more, strides have given way to standing and a dash
KEEPS = 0.2
JOINT = 2e-7  # mg, what pieces may miss of Newton's law: the solver's own tolerance


def joined(pieces: Pieces, budget: Budget) -> Solution:
    """The motion, with the iterations and the time of its pieces."""
    path, into, out = pieces.path, pieces.into, pieces.out
    middle = path.between(into.at, out.at)
    nodes = np.concatenate([into.motion.x[1:], middle, out.motion.x[2:]])
    whole = path.rest.replace(x_end=nodes[-1], v_end=np.zeros(path.journey.robot.nx))
    raw = evaluated(whole, nodes, Status.JOINED)
    polished = solve(whole, start=nodes, **budget.near("the whole motion"))
    keeps = raw.violation <= JOINT * raw.weight and polished.status is not Status.INTERRUPTED
    best = raw if keeps and _worse(polished, raw, path.journey.robot.base_coordinate) else polished
    return _counted(best, pieces)


def _worse(polished: Solution, raw: Solution, base: int) -> bool:
    """Whether polishing failed, added stumbles or moved the base (from ``base`` on) too far."""
    away = np.abs(polished.x - raw.x)[:, [base, base + 1, base + 3]].max(axis=0)
    more = stumbles(polished.normal_force, polished) > stumbles(raw.normal_force, raw)
    far = (away > KEEPS * np.array([raw.length, raw.length, 1.0])).any()
    return bool(more or not polished.converged or far)


def _counted(motion: Solution, pieces: Pieces) -> Solution:
    """With the iterations and the time of the pieces."""
    stride = pieces.path.stride
    parts = (stride, pieces.into.motion, pieces.out.motion, motion)
    sums = ("iterations", "factorizations", "setup_seconds", "seconds", "processor_seconds")
    spent: dict[str, Any] = {name: sum(getattr(part, name) for part in parts) for name in sums}
    return replace(motion, seed=stride.seed, passes=(*stride.passes, *motion.passes), **spent)
