"""Terms over neighbouring Hermite controls on a device: the kernels of between.cu."""

from __future__ import annotations

from octo.gpu.device import Array, Device, source
from octo.problem.between import BetweenCode

SMALL, WIDE = 32, 256  # threads of a block for a segment's terms, and for a block of H


class Between:
    """Kernels of a list of terms over (c_k, c_{k+1})."""

    def __init__(self, code: BetweenCode, device: Device):
        self.device, self.size, self.rows, self.entries = device, code.size, code.rows, code.entries
        self.bends = code.bends.size
        text = [source("common.cuh"), code.text, source("between.cu")]
        if self.bends:
            text.append(source("between_curvature.cu"))
        self.kernel = device.module("\n".join(text)).kernel

    def values(self, anchor: Array, unknowns: Array, q: Array, terms: Array) -> None:
        """Writes their share of E into ``terms`` (batch, N, terms), at the last step of each
        segment."""
        batch, units = unknowns.shape[:2]
        controls, length = self._controls(anchor, unknowns), terms.shape[1] // (units - 1)
        threads = self.device.threads(SMALL)
        self.kernel("octo_between_values")(
            (units - 1, batch), threads, length, controls, q, terms, shared=8 * self.rows
        )

    def add(
        self, anchor: Array, unknowns: Array, q: Array, dummy: Array, H: Array, b: Array
    ) -> None:
        """Adds 2 JᵀJ and 2 Jᵀr to H (batch, K, 3, nc, nc) and b (batch, K, nc)."""
        batch, units = unknowns.shape[:2]
        controls, length = self._controls(anchor, unknowns), q.shape[1] // (units - 1)
        rows = self.device.empty((batch, units - 1, self.rows, 2 * self.size + 1))
        shared = 8 * (2 * self.rows + self.entries)
        self.kernel("octo_between_rows")(
            (units - 1, batch), self.device.threads(WIDE), length, controls, q, rows, shared=shared
        )
        self.kernel("octo_between_add")(
            (units - 1, 2, batch), self.device.threads(WIDE), dummy, rows, H, b
        )

    def bend(
        self, anchor: Array, unknowns: Array, q: Array, dummy: Array, curved: Array | None, H: Array
    ) -> None:
        """Adds the curvature of exact terms to H of the members ``curved``."""
        if not self.bends:
            return
        batch, units = unknowns.shape[:2]
        controls, length = self._controls(anchor, unknowns), q.shape[1] // (units - 1)
        threads = self.device.threads(SMALL)
        self.kernel("octo_between_bend")(
            (units - 1, batch),
            threads,
            length,
            curved,
            dummy,
            controls,
            q,
            H,
            shared=8 * self.bends,
        )

    def _controls(self, anchor: Array, unknowns: Array) -> Array:
        controls, threads = self.device.empty(unknowns.shape), self.device.threads(WIDE)
        count = int(unknowns.size)
        grid = (min(-(-count // threads), 65535),)
        self.kernel("octo_between_controls")(
            grid, threads, count, unknowns.shape[1], anchor, unknowns, controls
        )
        return controls
