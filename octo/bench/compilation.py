"""Code generation and compilation of the humanoid, 35 degrees of freedom: processor time, the
compiler's included.

Every measurement is a separate process (``python -m octo.bench.compilation`` prints one as JSON),
with an empty cache and again with what the first one left there.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import octo
from octo.bench.plan import Plan
from octo.bench.timing import Records, Say
from octo.dynamics.evaluate import RobotDynamics
from octo.problem.compiled import CompiledProblem
from octo.solver import elimination


def measure(records: Records, plan: Plan, say: Say) -> None:
    with tempfile.TemporaryDirectory() as folder:
        # without plan.cold the first one fills the user's cache where that has gaps
        for label in ("cold", "cached"):
            say(label if plan.cold or label == "cached" else "filling the cache")
            own = {"OCTO_CACHE": folder} if plan.cold else {}
            folders = (str(Path(octo.__file__).parents[1]), os.environ.get("PYTHONPATH", ""))
            path = os.pathsep.join(folders)
            done = subprocess.run(
                [sys.executable, "-m", "octo.bench.compilation"],
                env={**os.environ, **own, "PYTHONPATH": path},
                capture_output=True,
                encoding="utf-8",
                check=True,
            )
            if label == "cold" and not plan.cold:
                continue
            parts = json.loads(done.stdout)
            for part, seconds in parts.items():
                records.add(f"compile.{label}.{part}", seconds, "s")
            records.add(f"compile.{label}", sum(parts.values()), "s")


def clock() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(part.ru_utime + part.ru_stime for part in used)


def main() -> None:
    robot = octo.gallery.humanoid()
    marks = [clock()]
    dynamics = RobotDynamics(robot)
    library = dynamics._library
    marks.append(clock())
    costs = [octo.CenterOfMassVelocity((0.3, 0.0, 0.0)), octo.Effort()]
    problem = octo.Problem(dynamics, steps=100, dt=0.025, costs=costs, x0=robot.default_pose)
    compiled = CompiledProblem([problem])
    library = compiled.library
    marks.append(clock())
    library = elimination.library(compiled.nc, compiled.ma)
    marks.append(clock())
    assert library is not None
    parts = [after - before for before, after in zip(marks, marks[1:], strict=False)]
    print(json.dumps({"dynamics": parts[0], "problem": parts[1], "elimination": parts[2]}))


if __name__ == "__main__":
    main()
