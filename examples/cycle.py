"""One stride of a four-legged character that repeats itself: its gait, five of it in a row, and a
page that loops.

Run ``python examples/cycle.py``; ``--short`` solves one start of one period instead of three starts
of five.
"""

import sys

import octo

SHORT = "--short" in sys.argv
PERIOD = 0.6 if SHORT else (0.45, 0.8)  # s

robot = octo.gallery.mammal()
problem = octo.Problem(
    robot, costs=octo.costs.natural(), cycle=octo.Cycle(speed=0.5, period=PERIOD)
)
stride = octo.solve(problem, seeds=1 if SHORT else 3, passes=2 if SHORT else None, progress=True)
print(stride)
print(f"period {stride.cycle.period:.3g} s; {stride.gait}")

walk = stride.tile(5)
walk.save("cycle.npz")
octo.plot(walk, "cycle.png")
octo.view(stride, "cycle.html")

way = walk.com[-1] - walk.com[0]
assert stride.converged
assert stride.gait.rhythm > 0.999
assert abs(way[0] - 0.5 * 5 * stride.cycle.period) < 1e-3 and abs(way[1]) < 1e-3
