"""A four-legged character walks at 0.5 m/s: no gait, no footholds, only a velocity and effort.

Run ``python examples/walk_mammal.py``; ``--short`` solves one second instead of ten.
"""

import sys

import octo

SECONDS, DT = (1.0 if "--short" in sys.argv else 10.0), 0.025

robot = octo.gallery.mammal()
problem = octo.Problem(
    robot, steps=round(SECONDS / DT), dt=DT,
    costs=[octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()],
)  # fmt: skip
solution = octo.solve(problem, progress=True)
print(solution)

solution.save("walk.npz")
octo.plot(solution, "walk.png")
octo.view(solution, "walk.html")

assert solution.converged
assert abs(solution.com[-1, 0] - solution.com[0, 0] - 0.5 * SECONDS) < 0.1 * 0.5 * SECONDS
