"""Arrays of an iterate one after another in one, so that some or all of them are copied at once."""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property
from math import prod

from octo.arrays import host
from octo.gpu.device import Array, Device
from octo.problem.compiled import Evaluation

Place = tuple[slice, tuple[int, ...]]
FIELDS = tuple(field.name for field in fields(Evaluation))


class Slab:
    """Memory and where each array is in it."""

    def __init__(self, places: dict[str, Place], flat: Array):
        self.places, self.flat = places, flat

    @classmethod
    def fresh(cls, device: Device, shapes: dict[str, tuple[int, ...]]) -> Slab:
        """Arrays in the order of ``shapes``."""
        return cls(_places(shapes), device.empty((sum(map(prod, shapes.values())),)))

    def __getitem__(self, name: str) -> Array:
        place, shape = self.places[name]
        return self.flat[place].reshape(shape)

    def part(self, first: str, last: str | None = None) -> Slab:
        """From one array to another or to the end, in the same memory."""
        names = list(self.places)
        own = names[names.index(first) : None if last is None else names.index(last) + 1]
        place = slice(self.places[own[0]][0].start, self.places[own[-1]][0].stop)
        return Slab(_places({name: self.places[name][1] for name in own}), self.flat[place])

    def copy(self) -> Slab:
        """In memory of its own."""
        return Slab(self.places, self.flat.copy())

    def host(self, device: Device) -> Slab:
        """On the host, in one copy that waits for the device."""
        return Slab(self.places, device.host(self.flat))


def _places(shapes: dict[str, tuple[int, ...]]) -> dict[str, Place]:
    places, size = dict[str, Place](), 0
    for name, shape in shapes.items():
        places[name] = slice(size, size + prod(shape)), shape
        size += prod(shape)
    return places


class SlabEvaluation(Evaluation):
    """An iterate in a slab, its arrays cut out when they are asked for: most are not, and each
    takes a GPU's host some µs."""

    def __init__(self, slab: Slab):
        self.slab = slab

    def __getattr__(self, name: str) -> Array:
        if name not in FIELDS:
            raise AttributeError(name)
        self.__dict__[name] = found = self.slab[name]
        return found

    @cached_property
    def _hosted(self) -> Slab:
        """Summary and sizes, which lie beside each other, in one copy."""
        part = self.slab.part("summary", "sizes")
        return Slab(part.places, host(part.flat))

    @cached_property
    def numbers(self) -> Array:
        return self._hosted["summary"]

    @cached_property
    def unit_sizes(self) -> Array:
        return self._hosted["sizes"]
