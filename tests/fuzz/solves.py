"""Problems with numbers of all sizes: what says that it is converged obeys Newton's law, computed
anew."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np

import octo
from octo.result.solution import Solution
from tests.fuzz import calls
from tests.fuzz.judge import Fault, call

MISSED = 1e-2  # of the weight, or of the weight times the length: ten times octo's tolerance


def case(random: Random, folder: Path) -> None:
    del folder
    described = call(lambda: problem(random))
    if described is None:
        return
    options = {
        "passes": random.choice((None, 1)),
        "seed": random.randrange(100),
        "max_iterations": 60,
    }
    found = call(lambda: octo.solve(described, device="cpu", **options), may_run=True)
    if isinstance(found, Solution) and found.converged:
        look(described, found)


def size(random: Random, low: float, high: float) -> float:
    return float(10.0 ** random.uniform(low, high))


def problem(random: Random) -> octo.Problem:
    """One structure, so that it is compiled once."""
    speed = random.choice((-1.0, 1.0)) * size(random, -3.0, 3.0)
    terms = [
        octo.CenterOfMassVelocity((speed, 0.0, 0.0), weight=size(random, -6.0, 6.0)),
        octo.Effort(weight=size(random, -8.0, 4.0)),
    ]
    x0 = calls._start() + random.choice((0.0, 0.0, 0.01, 1.0)) * np.array(
        [random.gauss(0.0, 1.0) for _ in range(calls.chain().nx)]
    )
    v0 = np.array([random.gauss(0.0, random.choice((0.0, 1.0, 100.0))) for _ in x0])
    return octo.Problem(
        calls.chain(), steps=3, dt=size(random, -4.0, 0.0), costs=terms, x0=x0, v0=v0
    )


def look(described: octo.Problem, found: Solution) -> None:
    """Evaluate FD at the solution's own numbers and parameters."""
    dynamics = described.dynamics
    p = dynamics.layout.pack(**found.parameters)
    rows = dynamics.evaluate(found.x[None], p[None])[0][0][:, dynamics.unactuated]
    missed = float(np.abs(rows * described.row_scale).max())
    if not missed <= MISSED:
        raise Fault(f"wrong: {found.status.label}, but Newton's law is missed by {missed:.2g} mg")
