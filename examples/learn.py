"""A walk that a network can say: motion and network are improved in turn (Algorithm 2).

Each round solves for the motion with the network's opinion as a term, then trains the network on
the motion. ``--short`` takes two seconds of a walk and two small rounds.
"""

import sys

import numpy as np

import octo

SHORT = "--short" in sys.argv

problem = octo.Problem(
    octo.gallery.biped(),
    steps=80 if SHORT else 400,
    dt=0.025,
    basis="hermite",
    costs=octo.costs.paper((0.5, 0.0, 0.0)),
)
found = octo.learn.solve(
    problem,
    octo.learn.Transition(hidden=(16, 16)),
    rounds=2 if SHORT else 10,
    iterations=40 if SHORT else 200,
    training=200 if SHORT else 1000,
    loss="recurrent",
    callback=lambda learned: print(learned.rounds[-1]),
)
print(found)

# the network alone: from the first control on, as long as one likes
controls = octo.learn.controls(found.motion)
longer = found.transition.unroll(controls[0], 3 * (len(controls) - 1))
print(f"three times as long, the base ends at x = {longer[-1, 0]:.2f} m")
last = found.rounds[-1]
assert last.loss <= last.first_loss and np.isfinite(found.error)
