"""Seconds of code generation and compilation of the humanoid, 35 degrees of freedom, by part, as JSON.

Run in a process of its own with OCTO_CACHE set: cold where that folder is empty, cached otherwise. Processor time,
the compiler's included.
"""

from __future__ import annotations

import json
import resource

import octo
from octo.dynamics.evaluate import RobotDynamics
from octo.problem.compiled import CompiledProblem
from octo.solver import elimination


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
    library = compiled._library
    marks.append(clock())
    library = elimination.library(compiled.nc, compiled.ma)
    marks.append(clock())
    assert library is not None
    parts = [after - before for before, after in zip(marks, marks[1:], strict=False)]
    print(json.dumps({"dynamics": parts[0], "problem": parts[1], "elimination": parts[2]}))


if __name__ == "__main__":
    main()
