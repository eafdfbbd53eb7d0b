"""A soft ball hops its own diameter to the left: from a mesh to a motion, a page and a still.
``--short`` takes coarse elements."""

import sys

import octo

DIVISIONS = 3 if "--short" in sys.argv else 6

ball = octo.soft.ball(radius=0.2, young=1e4, density=250.0, divisions=DIVISIONS)
lowest, highest = ball.frequencies[[0, -1]]
print(
    f"{ball.mass:.2f} kg, {len(ball.points)} points on its surface, {ball.modes.shape[1]} modes "
    f"of {lowest:.2f} to {highest:.2f} Hz"
)
hop = octo.soft_motion(ball, "jump", distance=-0.4, height=0.25, progress=True)
print(hop)
assert hop.soft is not None
lowest_point = hop.soft.surface(hop.x[1:])[..., 2].min(axis=1)  # (N + 1,) m
print(f"its lowest point rises to {100.0 * lowest_point.max():.0f} cm")
octo.filmstrip(hop, "hop.png", moments=8)
octo.view(hop, "hop.html")
assert hop.converged and all(one.met for one in hop.asked)
assert lowest_point.max() > 0.15
