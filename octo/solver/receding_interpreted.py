"""A receding horizon where there is no compiler: the general evaluation and the general KKT factor,
slowly."""

from __future__ import annotations

import numpy as np

from octo.problem.compiled import CompiledProblem
from octo.problem.every_node import every_node_a_unit
from octo.problem.problem import Array
from octo.solver import kkt
from octo.solver.kkt import KKTFactor
from octo.solver.receding import PAST, RETRIES
from octo.solver.regularisation import FLOOR, GROW


class InterpretedHorizon:
    """What :class:`octo.solver.receding.RecedingHorizon` offers. Nothing is done ahead:
    ``feedback`` does it all."""

    def __init__(self, compiled: CompiledProblem, sigma: float = 1e-6):
        N, n, m = compiled.steps, compiled.n, compiled.m
        self.steps, self.sigma = N, np.array([sigma])
        self._whole = every_node_a_unit(compiled)
        self.nodes, self.fd = np.zeros((N + PAST, n)), np.zeros((N, n))
        self.terms = np.zeros((N, len(compiled.functions.references.terms)))
        self.C, self.step, self.lam = np.zeros((N, m)), np.zeros((N, n)), np.zeros((N, m))
        self.guess, self.rows = np.zeros((N + PAST, m)), np.zeros(compiled.lower.shape[1:])
        self._factor: KKTFactor | None = None
        self._past: tuple[Array, Array] | None = None

    @property
    def energy(self) -> float:
        return float(self.terms.sum())

    def prepare(self, exact: bool = False) -> bool:
        return True

    def feedback(self, exact: bool = False, usable: bool = True) -> bool:
        whole = self._whole
        model = whole.linearize(
            whole.evaluate(self.nodes[None].copy()), self.guess[None] if exact else None
        )
        H, A = (np.array(blocks[:, PAST:]) for blocks in (model.H, model.A))
        self._past = _columns(H), _columns(A)
        for blocks in (H, A):
            blocks[:, 0, 1:], blocks[:, 1, 2] = 0.0, 0.0  # of the measured units
        for _ in range(RETRIES if exact else 1):
            self._factor = kkt.factorize(H, A, np.full((1, self.steps), self.sigma[0] + FLOOR))
            if self._factor.inertia_ok[0]:
                step, lam = self._factor.solve(-model.b[:, PAST:], -model.C[:, PAST:])
                self.step[:], self.lam[:] = step[0], lam[0]
                return True
            if exact:
                self.sigma *= GROW
        return False

    def evaluate(self) -> None:
        at = self._whole.evaluate(self.nodes[None].copy())
        self.fd[:], self.terms[:], self.C[:] = at.fd[0], at.terms[0], at.C[0, PAST:]
        self.rows[:] = at.rows[0]

    def evaluate_first(self) -> None:
        self.evaluate()

    def gain(self) -> Array:
        assert self._factor is not None and self._past is not None
        return np.asarray(self._factor.solve(*(-columns for columns in self._past))[0][0, 0])


def _columns(blocks: Array) -> Array:
    """(1, N, rows, 2n) of the solved units against x_0 and x_{-1}, from lag blocks (1, N, 3, rows,
    n)."""
    n = blocks.shape[-1]
    out = np.zeros((*blocks.shape[:2], blocks.shape[3], 2 * n))
    out[:, 0, :, :n] = blocks[:, 0, 1]
    out[:, 0, :, n:] = blocks[:, 0, 2]
    out[:, 1, :, :n] = blocks[:, 1, 2]
    return out
