"""Why a solve stopped, and what is written down of every iteration."""

from __future__ import annotations

from enum import Enum


class Status(Enum):
    """Why the solver stopped, in words."""

    CONVERGED = (
        "converged: the full step, the constraints and the gradient of the Lagrangian are "
        "within tolerance"
    )
    ACCEPTABLE = (
        "acceptable: the constraints are within tolerance and E has changed by less than "
        "1e-4 of itself in 20 iterations"
    )
    STALLED = (
        "stalled: no step improves the merit any more, and the tests of convergence do not hold"
    )
    ITERATION_LIMIT = "stopped at the limit of iterations before it converged"
    TIME_LIMIT = "stopped at the time limit before it converged"
    JOINED = (
        "joined: every piece converged with its ends fixed; as one problem it did not "
        "converge, or stumbled"
    )
    INTERRUPTED = "interrupted: this is the best iterate so far"
    NOT_FINITE = "stopped: the dynamics at the start are not finite"
    SIMULATED = "simulated: every implicit step was solved"
    UNROLLED = "unrolled from a learned transition: its forces need not balance"
    UNSOLVED = "simulated, but some implicit steps were not solved"

    @property
    def converged(self) -> bool:
        return self in (Status.CONVERGED, Status.ACCEPTABLE, Status.JOINED, Status.SIMULATED)

    def infeasible(self, violated: str) -> str:
        """The sentence of a solve that did not converge, where constraints are ``violated``."""
        if self is Status.STALLED:
            return f"stalled: {violated}, and no step improves that any more"
        return f"{self.value}; {violated}"

    @property
    def label(self) -> str:
        """The name reports use: "converged", "iteration_limit", …"""
        return self.name.lower()


HISTORY = (
    "pass",  # counted from 1
    "iteration",  # counted from 0, the start of the pass
    "energy",  # E
    "violation",  # N, ‖C‖∞ scaled back by mg
    "dual",  # ‖∇E + Aᵀlam‖∞
    "step",  # ‖Δ‖∞ of the full KKT step, rad and m
    "taken",  # ‖Δ‖∞ of the step taken, 0 where it was rejected
    "ratio",  # actual/predicted reduction of the merit
    "radius",  # trust radius
    "sigma",  # largest regularisation weight
    "factorizations",
    "seconds",  # since the first iterate
)
