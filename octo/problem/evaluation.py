"""E and C of a batch at one iterate, and their model (Eq. 9)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.arrays import every, host, like, some
from octo.checks import Array

# what an Evaluation keeps on the host once it was asked for
HOSTED = frozenset(("numbers", "unit_sizes", "objective"))


@dataclass(eq=False)
class Evaluation:
    """E and C of a batch at one iterate."""

    unknowns: Array  # (batch, K, nc)
    nodes: Array  # (batch, N+2, n)
    fd: Array  # (batch, N, n), N m or N
    terms: Array  # (batch, N, terms), each step's share of each term
    rows: Array  # (batch, N, bounded rows), their values
    C: Array  # (batch, K, ma), scaled
    summary: Array  # (batch, 4): E, ‖C‖₁, ‖C‖∞, ‖C‖₂²

    @classmethod
    def of(
        cls, unknowns: Array, nodes: Array, fd: Array, terms: Array, rows: Array, C: Array
    ) -> Evaluation:
        """With the summary of E and C, in NumPy."""
        size = np.abs(C).reshape(len(C), -1)
        norms = [size.sum(axis=1), size.max(axis=1, initial=0.0), (size**2).sum(axis=1)]
        summary = np.stack([terms.sum(axis=(1, 2)), *norms], axis=1)
        return cls(unknowns, nodes, fd, terms, rows, C, summary)

    @cached_property
    def numbers(self) -> Array:
        """(batch, 4) the summary on the host: one copy of an iterate, whoever asks."""
        return host(self.summary)

    @cached_property
    def unit_sizes(self) -> Array:
        """(batch, K) ‖C‖₁ of each unit, on the host."""
        return host(abs(self.C).sum(axis=2))

    @cached_property
    def objective(self) -> Array:
        """(batch,) E of the terms, whatever the summary says, on the host."""
        return host(self.terms.sum(axis=(1, 2)))

    @property
    def energy(self) -> Array:
        """(batch,) E, on the host."""
        return self.numbers[:, 0]

    @property
    def size(self) -> Array:
        """(batch,) ‖C‖₁, on the host."""
        return self.numbers[:, 1]

    @property
    def largest(self) -> Array:
        """(batch,) ‖C‖∞, on the host."""
        return self.numbers[:, 2]

    @property
    def square(self) -> Array:
        """(batch,) ‖C‖₂², on the host."""
        return self.numbers[:, 3]

    @property
    def finite(self) -> NDArray[np.bool_]:
        """(batch,) where E and C are; on the host."""
        return np.isfinite(self.energy + self.size)

    def take(
        self, members: NDArray[Any] | Sequence[int] | Sequence[np.signedinteger[Any]]
    ) -> Evaluation:
        """Some members, by index or by a mask."""
        chosen = like(np.asarray(members), self.C)
        made = Evaluation(*(getattr(self, field.name)[chosen] for field in fields(self)))
        for name in HOSTED.intersection(self.__dict__):
            made.__dict__[name] = getattr(self, name)[np.asarray(members)]
        return made

    def put(self, members: NDArray, other: Evaluation) -> None:
        """Overwrite some members with those of ``other``."""
        chosen = like(np.asarray(members), self.C)
        for field in fields(self):
            getattr(self, field.name)[chosen] = getattr(other, field.name)
        for name in HOSTED.intersection(self.__dict__):
            mine = self.__dict__.pop(name)
            if name in other.__dict__:
                self.__dict__[name] = mine.copy()
                self.__dict__[name][members] = other.__dict__[name]

    def replaced(self, members: NDArray[np.bool_], other: Evaluation) -> Evaluation:
        """Members of ``other`` where the mask is set, of this one elsewhere; one of the two itself
        where all come from it."""
        if every(members):
            return other
        if not some(members):
            return self
        made, chosen = self.copy(), np.flatnonzero(members)
        made.put(chosen, other.take(chosen))
        return made

    def copy(self) -> Evaluation:
        """One that may be changed."""
        return self.take(np.arange(len(self.numbers)))

    def summarised(self, summary: Array, numbers: Array, objective: Array) -> Evaluation:
        """The same with another summary (batch, 4), which is ``numbers`` on the host; there too
        E of the terms (batch,)."""
        made = copy.copy(self)
        made.summary = summary
        made.__dict__.update(numbers=numbers, objective=objective)
        return made

    def on_host(self) -> Evaluation:
        """The same in NumPy arrays."""
        return Evaluation(*(host(getattr(self, field.name)) for field in fields(self)))


# H (batch, K, 3, nc, nc) or none, A (batch, K, 3, ma, nc), b (batch, K, nc), C (batch, K, ma), R or
# none
Blocks = tuple[Array | None, Array, Array, Array, Array | None]


@dataclass(eq=False)
class Model:
    """Eq. 9 at one iterate: H (batch, K, 3, nc, nc), A (batch, K, 3, ma, nc), b (batch, K, nc), C
    (batch, K, ma).

    R (batch, N, size): slopes of the bounded rows as ``CompiledProblem.row_products`` reads them
    (octo.problem.row_products); None where there are none."""

    H: Array
    A: Array
    b: Array
    C: Array
    R: Array | None = None
