"""Forty seconds of the chain, planned one second at a time: a plan's first tenth is kept, the rest
starts the next.

Run ``python examples/mpc_chain.py``; ``--short`` stops after three seconds, ``--compare`` also
solves the forty seconds as one problem (Hermite controls) and compares how far the two went.
"""

import sys

import octo

SECONDS, DT = (3.0 if "--short" in sys.argv else 40.0), 0.025

robot = octo.gallery.chain()
costs = [octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()]
horizon = octo.Problem(robot, steps=40, dt=DT, costs=costs)
motion = octo.mpc.animate(horizon, SECONDS)
distance = motion.com[-1, 0] - motion.com[0, 0]
print(motion)
plans = len(motion.history["energy"])
print(f"{distance:.2f} m in {SECONDS:g} s of animation; {plans} plans took {motion.seconds:.1f} s")

motion.save("chain.npz")
octo.view(motion, "chain.html")

assert motion.converged
assert 0.8 < distance / (0.5 * SECONDS) < 1.2

if "--compare" in sys.argv:
    whole = octo.Problem(robot, steps=round(SECONDS / DT), dt=DT, costs=costs, basis="hermite")
    solution = octo.solve(whole, passes=1, progress=True)
    print(solution)
    print(
        f"the full horizon went {solution.com[-1, 0] - solution.com[0, 0]:.2f} m in "
        f"{solution.seconds:.1f} s of solving"
    )
