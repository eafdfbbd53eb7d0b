"""One short walk in octo, IPOPT and fatrop: time, iterations and E from the same starts."""

from __future__ import annotations

import numpy as np

import octo
from octo.bench.contest import Contest, Entry, both_converged, ratios
from octo.bench.iteration import MILLI, walk
from octo.bench.plan import Plan
from octo.bench.timing import Records, Say
from octo.reference.run import OPTIONS

OTHERS = {"nodes": ("ipopt", "fatrop"), "hermite": ("ipopt",)}


def measure(records: Records, plan: Plan, say: Say) -> None:
    """Medians over the starts that a solver converged on; ratios over those where both did.
    Processor time, one thread."""
    for basis, others in OTHERS.items():
        say(f"{basis}: compiling")
        problem = walk(octo.gallery.mammal(), plan.motion_steps, basis)
        contest = Contest(problem, others, OPTIONS, device="cpu")
        entries: list[Entry] = []
        for entry in contest.run(range(plan.seeds)):
            say(
                f"{basis}: {entry.solver}, start {entry.seed + 1} of {plan.seeds}, "
                f"{entry.solution.status.label}"
            )
            entries.append(entry)
        for solver in ("octo", *others):
            own = [entry for entry in entries if entry.solver == solver]
            _add(records, f"solvers.{basis}.{solver}", own)
        for solver in others:
            both = both_converged(entries, solver)
            for name, value in ratios(both).items() if both else ():
                records.add(f"solvers.{basis}.octo/{solver}.{name.replace(' ', '_')}", value, "")


def _add(records: Records, name: str, entries: list[Entry]) -> None:
    done = [entry.solution for entry in entries if entry.solution.converged]
    records.add(f"{name}.converged", len(done) / len(entries), "")
    if done:
        records.add(f"{name}.time", float(np.median([s.processor_seconds for s in done])), "s")
        records.add(f"{name}.iterations", float(np.median([s.iterations for s in done])), "")
        one = [MILLI * s.processor_seconds / max(s.iterations, 1) for s in done]
        records.add(f"{name}.time_an_iteration", float(np.median(one)), "ms")
        records.add(f"{name}.E", float(np.median([s.energy for s in done])), "")
