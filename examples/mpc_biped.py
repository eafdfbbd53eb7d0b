"""A biped walks in MuJoCo at 0.4 m/s: a stride, solved once, leads its controller, and no motor
ever gives more than its limit.

Run ``python examples/mpc_biped.py``. ``--short`` stops after two seconds.
"""

import sys

import numpy as np

import octo
from octo.mpc import Controller, StrideReference, run, tracking_problem

SECONDS = 2.0 if "--short" in sys.argv else 20.0

# half a stride and its mirror image, in seconds; which foot is on the ground when is found
robot = octo.load("biped")
cycle = octo.Cycle(speed=0.4, period=0.8)
stride = octo.solve(octo.Problem(robot, costs=octo.costs.natural(), cycle=cycle), seeds=3)
print(stride)

# the stride as the reference of each horizon, again and again; what must hold beside it
limits = [octo.TorqueLimits(), octo.JointLimits(margin=0.02)]
problem = tracking_problem(stride, constraints=limits)
controller = Controller(problem, guide=StrideReference(stride))

# in mid-stride, a little off
plant = octo.plant.MujocoPlant(robot, friction=0.8)
start = stride.x[1].copy()
start[robot.actuated] += 0.02 * np.random.default_rng(0).standard_normal(robot.nu)
plant.reset_chart(start, problem.start_velocity)

log = run(controller, plant, SECONDS)
print(log)
print("first torques clipped:", log.report()["clipped"])

log.save("log.npz")
octo.view(log.solution(), "walk.html")

assert not log.falls
assert (np.abs(log.u) <= robot.torque_limit).all()
