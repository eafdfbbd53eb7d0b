"""What is written down of every iteration of a batch, and whether E has settled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers
from octo.solver.options import SqpOptions
from octo.solver.status import HISTORY

# iterations over which E settles before terms over contacts have all of their curvature
SETTLING = 10


def _level(energies: list[float], count: int, part: float) -> bool:
    """Whether E has changed by ``part`` of itself at most over the last ``count`` iterations."""
    window = energies[-count - 1 :]
    return len(window) > count and max(window) - min(window) <= part * abs(window[-1])


class Records:
    """Histories of all starts."""

    def __init__(self, batch: int, options: SqpOptions):
        self._options = options
        # the members at work, their columns of HISTORY
        self._iterations: list[tuple[NDArray[np.intp], tuple[Any, ...]]] = []
        self._energies: list[list[float]] = [[] for _ in range(batch)]

    def add(self, members: NDArray[np.intp], energy: Numbers, *columns: Any) -> NDArray[np.bool_]:
        """Columns of HISTORY from E on, numbers or (members,): where E changed by less than a small
        part of itself lately."""
        self._iterations.append((members, (energy.copy(), *columns)))
        for k, value in zip(members.tolist(), energy.tolist(), strict=True):
            self._energies[k].append(value)
        o = self._options
        return np.array([_level(self._energies[k], o.plateau, o.plateau_change) for k in members])

    def settled(self, members: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Where E has changed by less than a part of itself over the last SETTLING iterations."""
        part = self._options.settled
        return np.array([_level(self._energies[k], SETTLING, part) for k in members], dtype=bool)

    def histories(self) -> list[dict[str, Array]]:
        rows: list[list[Any]] = [[] for _ in self._energies]
        for iteration, (members, columns) in enumerate(self._iterations):
            table = np.empty((len(members), len(HISTORY)))
            for k, values in enumerate((0.0, iteration, *columns)):
                table[:, k] = values
            for member, row in zip(members, table, strict=True):
                rows[member].append(row)
        tables = [np.array(own).reshape(-1, len(HISTORY)) for own in rows]
        return [{name: table[:, k].copy() for k, name in enumerate(HISTORY)} for table in tables]
