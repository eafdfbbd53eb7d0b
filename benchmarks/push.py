"""A robot pushes a box of a third of its own mass by 1 m, and how each of five starts ends.

    python -m benchmarks.push [--ball]

``--ball``: it kicks a ball of a ninth of its mass instead.
"""

import sys

import numpy as np

import octo
from octo.model.kinematics import body_poses

BALL = "--ball" in sys.argv
robot = octo.gallery.mammal()
box = octo.objects.box((0.3, 0.4, 0.3), robot.mass / 3.0, (0.42, 0.0, 0.15))
ball = octo.objects.ball(0.12, robot.mass / 9.0, (0.42, 0.0, 0.12))
way, seeds = 1.0, 5

thing = ball if BALL else box
place = (0.42 + way, 0.0)
motion = octo.push(octo.Scene(robot, [thing]), thing.name, place, seeds=seeds)
octo.filmstrip(motion, f"push_{thing.name}.png", moments=8)
for start in motion.starts:
    print(
        f"{thing.name}: {start['status']} after {start['iterations']} iterations, "
        f"E = {start['energy']:.3f}, ‖C‖∞ = {start['violation']:.1e} N"
    )
converged = sum(start["converged"] for start in motion.starts)
at = [motion.joint_names.index(f"{thing.name}_{axis}") for axis in "xy"]
off = np.linalg.norm(motion.x[-1, at] - place)
print(f"{thing.name}: {converged} of {seeds} starts converged, the best is {off:.3f} m off")
print(f"Newton's law holds to {motion.violation:.1e} N")
touched = np.flatnonzero(motion.touched.any(axis=1))
force = np.linalg.norm(motion.touch_force, axis=-1).max()
print(f"it is touched in {len(touched)} steps, with {force:.1f} N at most")
if not BALL:
    up = body_poses(motion.character, motion.x)[0][:, motion.character.body_index("box"), 2]
    print(f"the box is tilted by {np.arccos(np.clip(up @ up[0], -1.0, 1.0)).max():.3f} rad")
print(f"{motion.processor_seconds:.0f} s of processor time, {motion.steps * motion.dt:.1f} s long")
assert off <= 0.05 and motion.violation <= 1e-3, (off, motion.violation)
