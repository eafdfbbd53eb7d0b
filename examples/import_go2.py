"""A robot file to a motion that a robot can follow: go2 walks at 0.4 m/s with the terms of
``octo.costs.robot``.

Run ``python examples/import_go2.py [go2.urdf]``; without a file it takes the one of the package
``example-robot-data``. ``--short`` solves one second instead of four.
"""

import sys
import sysconfig
from pathlib import Path

import octo

PACKAGE = (
    Path(sysconfig.get_path("purelib"))
    / "cmeel.prefix/share/example-robot-data/robots/go2_description/urdf/go2.urdf"
)
SECONDS, DT = (1.0 if "--short" in sys.argv else 4.0), 0.025

files = [word for word in sys.argv[1:] if not word.startswith("--")]
robot = octo.load(files[0] if files else PACKAGE)
print(
    f"{robot.name}: {robot.nx} degrees of freedom, {robot.mass:.1f} kg; not modelled: "
    f"{'; '.join(robot.dropped) or 'nothing'}"
)

problem = octo.Problem(robot, steps=round(SECONDS / DT), dt=DT, costs=octo.costs.robot(speed=0.4))
solution = octo.solve(problem, progress=True)
print(solution)
print(
    f"torques use {100 * solution.torque_excess:.0f} % of the motors' limits; friction "
    f"{solution.friction_use_95:.2f} (95 %)"
)

solution.save("go2.npz")
octo.view(solution, "go2.html")

assert solution.violation <= 1e-3 * solution.weight
