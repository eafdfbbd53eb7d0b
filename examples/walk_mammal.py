"""A four-legged character walks for ten seconds at 0.5 m/s, from rest to rest: no gait, no
footholds, only a speed.

Run ``python examples/walk_mammal.py``; ``--short`` looks at one stride of one period and walks for
2.5 seconds.
"""

import sys

import numpy as np

import octo

SHORT = "--short" in sys.argv
SECONDS, SPEED = (2.5 if SHORT else 10.0), 0.5
LESS = {"starts": 1, "period": 0.6} if SHORT else {}

walk = octo.walk(octo.gallery.mammal(), SPEED, SECONDS, progress=True, **LESS)
print(walk)

walk.save("walk.npz")
octo.plot(walk, "walk.png")
octo.view(walk, "walk.html")

assert walk.converged
assert np.allclose(walk.x[1], walk.x[0]) and np.allclose(walk.x[-1], walk.x[-2])  # at rest
assert abs(walk.com[-1, 0] - walk.com[0, 0] - SPEED * SECONDS) < 1e-3
