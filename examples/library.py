"""A library of motions: a crane's trolley that brings its load to rest at many places.

All are solved as batches in two or more processes; a network that is told the place is trained on
them, and is the start of a motion to a place between. ``--short`` solves a dozen and trains less.
"""

import sys

import casadi as ca
import numpy as np

import octo

SHORT = "--short" in sys.argv
ROPE, TROLLEY, LOAD, GRAVITY = 1.0, 2.0, 1.0, 9.81  # m, kg, kg, m/s²


def crane(x_next, x, x_prev, p):
    """x = (place of the trolley in m, angle of the rope in rad); the trolley alone is driven."""
    acceleration = (x_next - 2.0 * x + x_prev) / p["dt"] ** 2
    angle, turn = x_next[1], (x_next[1] - x[1]) / p["dt"]
    trolley = (TROLLEY + LOAD) * acceleration[0] + LOAD * ROPE * (
        ca.cos(angle) * acceleration[1] - ca.sin(angle) * turn**2
    )
    load = ca.cos(angle) * acceleration[0] + ROPE * acceleration[1] + GRAVITY * ca.sin(angle)
    return ca.vertcat(trolley, LOAD * ROPE * load)


def off(step, p):
    """How far the trolley is from its place, and the rope from hanging straight."""
    return ca.vertcat(step.x_next[0] - p["place"], step.x_next[1])


def to(model, place):
    """From rest to a place (m)."""
    costs = [
        octo.CustomCost(off, {"place": np.array([place])}, name="Goal"),
        octo.Effort(weight=0.01, reference=10.0),
    ]
    return octo.Problem(model, steps=80, dt=0.05, basis="hermite", costs=costs, x0=np.zeros(2))


if __name__ == "__main__":  # the processes that solve read this file too
    model = octo.CustomDynamics(crane, nx=2, actuated=[0], parameters={"dt": 0.05})
    places = np.linspace(0.5, 3.0, 12 if SHORT else 60)
    library = octo.library([to(model, place) for place in places], batch=6, gains=True)
    print(library)
    library.save("crane.npz")

    network = octo.learn.Transition(hidden=(32, 32), command=("Goal.place",))
    iterations = 300 if SHORT else 2000
    trained = octo.learn.train(network, library, loss="recurrent", iterations=iterations)
    problem = to(model, 1.37)
    starts = {
        "at rest": None,
        "the nearest motion": library.nearest(problem),
        "the network": trained.transition,
    }
    for name, start in starts.items():
        found = octo.solve(problem, start=start)
        print(f"from {name}: {found.iterations} iterations, E = {found.energy:.6g}")
    print(f"gains {library.gains.shape}, network {trained.error**0.5:.2g} off when unrolled")
    assert library.share == 1.0 and found.converged
