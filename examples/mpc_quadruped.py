"""go2 walks in MuJoCo at 0.3 m/s and is pushed from the side; one plan of a second from every
measurement, no gait anywhere.

Run ``python examples/mpc_quadruped.py [ROBOT]``: a robot file or a name of the gallery; without one
the go2 of the package ``example-robot-data``. ``--short`` stops after two seconds, before the push.
"""

import sys
import sysconfig
from pathlib import Path

import octo
from octo.mpc import Controller, Push, VelocityCommand, run, walking_problem

PACKAGE = (
    Path(sysconfig.get_path("purelib"))
    / "cmeel.prefix/share/example-robot-data/robots/go2_description/urdf/go2.urdf"
)
SECONDS = 2.0 if "--short" in sys.argv else 20.0
PUSH = Push(50.0, 0.2, 90.0, start=5.0) if SECONDS > 5.0 else None

files = [word for word in sys.argv[1:] if not word.startswith("--")]
robot = octo.load(files[0] if files else PACKAGE)

# 25 steps of 0.04 s, soft feet, the terms of octo.costs.locomotion
problem = walking_problem(robot)
guide = VelocityCommand(velocity=(0.3, 0.0))
controller = Controller(problem, guide=guide)

plant = octo.plant.MujocoPlant(robot, friction=0.8)
plant.reset_chart(problem.start)


def turn_at_ten_seconds(t, controller):
    guide.yaw_rate = 0.3 if t > 10.0 else 0.0


log = run(controller, plant, SECONDS, push=PUSH, each=turn_at_ten_seconds)
print(log)

log.save("log.npz")
octo.view(log.solution(), "walk.html")

assert not log.falls
