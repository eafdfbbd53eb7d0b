"""A chain of five links crawls through an arch and over a step: no gait, no contact schedule.

Any part of the chain may touch anything. Its first guess is its pose, moved along a straight line
through the arch; the step grows out of the ground, so that the motion learns to lift itself over
it. ``--seed N`` bends the joints of that line at random; ``--short`` crawls a little of the way on
soft ground, with the step sunken.
"""

import sys

import numpy as np

import octo

SHORT = "--short" in sys.argv
SEED = int(sys.argv[sys.argv.index("--seed") + 1]) if "--seed" in sys.argv else 0
SECONDS, DT, WAY = (2.0, 0.05, 0.6) if SHORT else (6.0, 0.05, 2.25)  # s, s, m
HEIGHTS = (-0.02,) if SHORT else (-0.02, 0.05, 0.12)  # m, of the step: 0.3 of a link at last

robot = octo.gallery.chain(between=7)  # contacts every 5 cm along each link
arch = octo.worlds.arch(height=0.32, width=1.4, thickness=0.15, start=0.8)
step = octo.shapes.Box((0.2, 2.0, 0.4), position=(1.25, 0.0, HEIGHTS[0] - 0.2), name="step")
world = octo.World([*arch.shapes, step])

names, low = [joint.name for joint in robot.joints], robot.default_pose.copy()
for end, sign in (("front", 1.0), ("back", -1.0)):  # its bridge is higher than the arch: crouch
    low[names.index(f"{end}_inner_pitch")] = 0.45 * sign
    low[names.index(f"{end}_outer_pitch")] = -0.45 * sign
    low[names.index(f"{end}_outer_yaw")] = 1.2
displacement = np.zeros(robot.nx)
displacement[0] = WAY

problem = octo.Problem(
    robot,
    steps=round(SECONDS / DT),
    dt=DT,
    costs=octo.costs.contact_rich(),
    terrain=world,
    pose=low,
    displacement=displacement,  # it ends at rest as it began, so much further
    constraints=[octo.StepLimit()],  # no link rolls over between two steps
)
part = np.linspace(0.0, 1.0, problem.steps + 1)[:, None]
start = problem.start + part**2 * (3.0 - 2.0 * part) * displacement
bends = 0.05 * np.random.default_rng(SEED).standard_normal(robot.nu)
start[:, robot.actuated] += bends * np.sin(np.pi * part)

for height in HEIGHTS:
    place = (1.25, 0.0, height - 0.2)
    problem = problem.replace(terrain=world.moved("step", position=place))
    near = {"max_iterations": 150} if height < HEIGHTS[-1] else {}
    soft = {"passes": 1} if near or SHORT else {}
    said = f"step {height:.2f} m"
    start = motion = octo.solve(problem, start=start, progress=said, **near, **soft)
print(motion)

radius = np.array([contact.radius for contact in robot.contacts])
centers = octo.kinematics.sphere_centers(robot, motion.x[1:])  # (N+1, contacts, 3) m
bar = octo.World([shape for shape in world.shapes if shape.name == "bar"])
gap = bar.distance(centers.reshape(-1, 3)).reshape(-1, len(radius)) - radius
print(f"from the bar: {1e3 * gap.min():.0f} mm at least")
print(f"largest torque: {np.abs(motion.u / robot.torque_limit).max():.2f} of its limit")
print(f"deepest contact: {1e3 * motion.contact_depth.max():.1f} mm")
motion.save("crawl.npz")
octo.filmstrip(motion, "crawl.png", moments=2 if SHORT else 8)

assert motion.converged
assert np.abs(motion.u).max() <= robot.torque_limit.max()
assert motion.contact_depth.max() < (0.06 if SHORT else 0.01)
