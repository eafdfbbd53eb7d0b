"""A jump in three phases that are solved as one: crouch and push, flight, landing.

Each phase is a problem of its own, with steps, terms and limits of its own; a phase begins in the
state in which the one before ends. Nobody says how deep the crouch is, how fast the robot leaves
the ground or how it lands. ``--short`` solves one start with soft contacts in place of three with
stiff ones, and writes no picture.
"""

import sys

import numpy as np

import octo

SHORT = "--short" in sys.argv
HEIGHT, FAR = 0.15, 0.4  # m, of the top over the start and from standing to standing

robot = octo.gallery.mammal()
keep = octo.costs.natural()  # what a body minds in every phase
flying = 24  # steps of 15 ms: about the time that it takes to fall from HEIGHT, twice
moved = np.zeros(robot.nx)
moved[0] = FAR

push = octo.Problem(robot, steps=30, dt=0.02, costs=keep)
flight = octo.Problem(
    robot,
    steps=flying,
    dt=0.015,
    costs=[
        octo.LoadSharing(weight=30.0, name="Flight"),  # no foot carries anything
        *(term for term in keep if term.label != "LoadSharing"),
    ],
    constraints=[
        octo.CenterOfMassDisplacement((FAR / 2, 0.0, HEIGHT), at=[flying // 2 - 1], name="Top")
    ],
)
landing = octo.Problem(robot, steps=40, dt=0.025, costs=keep, displacement=moved)
jump = octo.phases([push, flight, landing])
print(jump)

# A first guess that leaves the ground: a parabola between two crouches, with still legs.
begun, landed = push.steps * push.dt, push.steps * push.dt + flight.steps * flight.dt
flown = np.clip((jump.times - begun) / (landed - begun), 0.0, 1.0)
guess = np.repeat(jump.start[None], jump.steps + 1, axis=0)
guess[:, 0] += FAR * flown
guess[:, 2] += 4.0 * HEIGHT * flown * (1.0 - flown)
guess[:, 2] -= 0.08 * np.sin(np.pi * np.clip(jump.times / begun, 0.0, 1.0)) ** 2
guess[:, 2] -= 0.08 * np.sin(np.pi * np.clip((jump.times - landed) / 0.6, 0.0, 1.0)) ** 2

found = octo.solve(jump, start=guess, passes=1 if SHORT else None)
print(found)
for k, phase in enumerate(found.phases):
    rise = phase.com[:, 2].max() - found.com[0, 2]
    print(
        f"phase {k}: {phase.loaded.any(axis=1).mean():4.0%} of the steps on the ground, at most "
        f"{rise:.2f} m above the start, {phase.torque_excess:.0%} of the torque"
    )
assert found.converged
assert not found.phases[1].loaded[2:-2].any()  # soft contacts let go a little later
assert abs(found.phases[1].com[flying // 2, 2] - found.com[0, 2] - HEIGHT) < 1e-4
if not SHORT:
    octo.view(found, "jump.html")
