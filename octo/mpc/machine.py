"""What a closed loop asks of a machine."""

from __future__ import annotations

from typing import Protocol

from octo.model.character import Character
from octo.model.quantities import Array


class Plant(Protocol):
    """What the loop asks of a machine; q and v are in the form of MuJoCo."""

    character: Character
    timestep: float
    push: Array

    @property
    def q(self) -> Array: ...
    @property
    def v(self) -> Array: ...
    @property
    def height(self) -> float: ...
    @property
    def base_rotation(self) -> Array: ...
    def step(self, u: Array, seconds: float | None = None) -> None: ...
    def reset(self, q: Array, v: Array | None = None) -> None: ...
    def contacts(self) -> tuple[Array, Array]: ...
