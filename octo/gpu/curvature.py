"""Exact second derivatives of terms over the state on a device: their generated code and the
kernels of curvature.cu."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.dynamics.codegen import integers, macros
from octo.dynamics.evaluate import Dynamics
from octo.emit import function_of_numbers, switch
from octo.gpu.device import Array, Device, Kernels, source
from octo.problem.codegen import CostFunctions
from octo.problem.curvature import StateCurvature

WARP, SMALL = 32, 128  # threads of a block for 32 steps, and for one


class Bends(Kernels):
    """The compiled text of S (octo.problem.curvature) and what adds it to the Hessians of steps.

    size: numbers of a step's S.
    """

    def __init__(self, functions: CostFunctions, dynamics: Dynamics, device: Device):
        made, calls, n = functions.curvature, functions.calls, dynamics.nx
        assert made is not None
        inputs = made.function.sx_in()
        values, order = made.function(*inputs), _groups(made, n)
        self.size, self.width = len(made.rows), 3 * n
        rows, columns = (
            np.concatenate([own[at] for at in order]) for own in (made.rows, made.columns)
        )
        straight = int((columns < self.width).sum())
        torques, counts = np.unique(columns[straight:] - self.width, return_counts=True)
        self.torques, self.pieces = len(torques), len(order)
        pieces = [
            ca.Function(f"octo_bend_piece_{k}", inputs, [values[at.tolist()]], {"cse": True})
            for k, at in enumerate(order)
        ]
        sizes = {"NX": n, "NU": dynamics.nu, "NP": inputs[4].numel(), "NQ": inputs[5].numel()}
        sizes |= {"NS": self.size, "STRAIGHT": straight, "TORQUES": self.torques}
        sizes |= {"WARP": WARP, "SMALL": SMALL}
        tables = {
            "row": rows,
            "column": columns,
            "at": np.cumsum([0, *(len(at) for at in order)])[:-1],
            "torque": torques,
            "first": straight + np.cumsum([0, *counts]),
            "actuated": dynamics.actuated,
        }
        text = [
            calls.stages_text,
            source("common.cuh"),
            calls.numbers_text,
            *map(function_of_numbers, pieces),
            macros(sizes),
            *(integers(f"bend_{name}", values) for name, values in tables.items()),
            switch("octo_bend_piece", pieces),
            source("curvature.cu"),
        ]
        super().__init__(device, "\n".join(text))

    def add(
        self,
        curved: Array | None,
        numbers: tuple[Array, Array, Array, Array],
        jac: Array,
        second: Array,
        hess: Array,
    ) -> None:
        """Adds to ``hess`` (batch, N, 6, n, n) of the members ``curved``; numbers: nodes, p, q, FD.

        ``second`` (batch, N, size) is written on the way.
        """
        batch, steps = hess.shape[:2]
        grid = (-(-steps // self.device.threads(WARP)), self.pieces, batch)
        self.each("octo_second", grid, steps, curved, *numbers, second, threads=WARP)
        own, room = (steps, curved, second, jac, hess), 8 * self.torques * self.width
        self.each("octo_bend", (steps, batch), *own, threads=SMALL, shared=room)


def _groups(made: StateCurvature, n: int) -> list[NDArray[np.intp]]:
    """The numbers of each piece: those of each block of two nodes, then those of torques, sorted by
    torque."""
    blocks: dict[tuple[int, int], list[int]] = {}
    for z, (a, b) in enumerate(zip(made.rows // n, made.columns // n, strict=True)):
        blocks.setdefault((int(a), int(b)) if b < 3 else (3, 3), []).append(z)
    torques = blocks.pop((3, 3), None)
    return [np.array(own) for own in (*blocks.values(), *([torques] if torques else []))]
