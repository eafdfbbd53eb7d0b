"""Terms over neighbouring Hermite controls on a device: the kernels of between.cu."""

from __future__ import annotations

from octo.gpu.device import Array, Device, Kernels, source
from octo.problem.between import BetweenCode

SMALL = 32  # threads of a block for a segment's terms


class Between(Kernels):
    """Kernels of a list of terms over (c_k, c_{k+1})."""

    def __init__(self, code: BetweenCode, device: Device):
        self.size, self.rows, self.entries = code.size, code.rows, code.slopes.size
        self.bends = code.bends.size
        text = [source("common.cuh"), code.text, source("between.cu")]
        if self.bends:
            text.append(source("between_curvature.cu"))
        super().__init__(device, "\n".join(text))

    def values(self, anchor: Array, unknowns: Array, q: Array, terms: Array) -> None:
        """Writes their share of E into ``terms`` (batch, N, terms), at the last step of each
        segment."""
        grid, length, controls = self._segments(anchor, unknowns, terms)
        own, room = (length, controls, q, terms), 8 * self.rows
        self.each("octo_between_values", grid, *own, threads=SMALL, shared=room)

    def add(
        self, anchor: Array, unknowns: Array, q: Array, dummy: Array, H: Array, b: Array
    ) -> None:
        """Adds 2 JᵀJ and 2 Jᵀr to H (batch, K, 3, nc, nc) and b (batch, K, nc)."""
        grid, length, controls = self._segments(anchor, unknowns, q)
        segments, batch = grid
        rows = self.device.empty((batch, segments, self.rows, 2 * self.size + 1))
        room = 8 * (2 * self.rows + self.entries)
        self.each("octo_between_rows", grid, length, controls, q, rows, shared=room)
        self.each("octo_between_add", (segments, 2, batch), dummy, rows, H, b)

    def bend(
        self, anchor: Array, unknowns: Array, q: Array, dummy: Array, curved: Array | None, H: Array
    ) -> None:
        """Adds the curvature of exact terms to H of the members ``curved``."""
        if self.bends:
            grid, length, controls = self._segments(anchor, unknowns, q)
            own, room = (length, curved, dummy, controls, q, H), 8 * self.bends
            self.each("octo_between_bend", grid, *own, threads=SMALL, shared=room)

    def _segments(
        self, anchor: Array, unknowns: Array, steps: Array
    ) -> tuple[tuple[int, int], int, Array]:
        """A block for each segment of each member; its steps, of ``steps`` (batch, N, …); the
        controls."""
        (batch, units), controls = unknowns.shape[:2], self.device.empty(unknowns.shape)
        count = int(unknowns.size)
        self.flat("octo_between_controls", count, units, anchor, unknowns, controls)
        return (units - 1, batch), steps.shape[1] // (units - 1), controls
