"""Arrays of an iterate one after another in one, so that some or all of them are copied at once."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from math import prod

from octo.gpu.device import Array, Device
from octo.problem.compiled import Evaluation

Place = tuple[slice, tuple[int, ...]]
FIELDS = tuple(field.name for field in fields(Evaluation))


class Layout:
    """Where each array of a slab is, in the order of ``shapes``; made once for all slabs alike."""

    def __init__(self, shapes: dict[str, tuple[int, ...]]):
        self.shapes, self.places, self.size = shapes, dict[str, Place](), 0
        for name, shape in shapes.items():
            self.places[name] = slice(self.size, self.size + prod(shape)), shape
            self.size += prod(shape)
        self.rest, self.span = cache(self._rest), cache(self._span)

    def _rest(self, first: str) -> Layout:
        """From one array to the end."""
        names = list(self.shapes)
        return Layout({name: self.shapes[name] for name in names[names.index(first) :]})

    def _span(self, first: str, last: str) -> tuple[slice, Layout]:
        """From one array to another: where they are together, and each within that."""
        rest = self.rest(first)
        names = list(rest.shapes)
        part = Layout({name: rest.shapes[name] for name in names[: names.index(last) + 1]})
        begin = self.places[first][0].start
        return slice(begin, begin + part.size), part


class Slab:
    """Memory laid out by ``layout``."""

    def __init__(self, layout: Layout, flat: Array):
        self.layout, self.flat = layout, flat

    @classmethod
    def fresh(cls, device: Device, shapes: dict[str, tuple[int, ...]]) -> Slab:
        layout = Layout(shapes)
        return cls(layout, device.empty((layout.size,)))

    def __getitem__(self, name: str) -> Array:
        place, shape = self.layout.places[name]
        return self.flat[place].reshape(shape)

    def copied(self, first: str) -> Slab:
        """A copy, from one array to the end."""
        return Slab(self.layout.rest(first), self.flat[self.layout.places[first][0].start :].copy())

    def host(self, device: Device, first: str, last: str) -> Slab:
        """Some arrays on the host, in one copy that waits for the device."""
        place, part = self.layout.span(first, last)
        return Slab(part, device.host(self.flat[place]))


class SlabEvaluation(Evaluation):
    """An iterate in a slab, its arrays cut out when they are asked for: most are not, and each takes a GPU's host some µs."""

    def __init__(self, slab: Slab):
        self.slab = slab

    def __getattr__(self, name: str) -> Array:
        if name not in FIELDS:
            raise AttributeError(name)
        self.__dict__[name] = found = self.slab[name]
        return found
