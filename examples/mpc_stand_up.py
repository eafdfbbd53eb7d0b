"""A mammal that lies on its side or on its back gets up in MuJoCo: no motion is given, only a pose
to end in.

The first plan is solved from the pose it lies in (several starts, the best is kept); after that a
plan of three seconds is improved by six iterations from every measurement. Run ``python
examples/mpc_stand_up.py [--short]``.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

import octo
from octo.mpc import Controller, walking_problem
from octo.plant import MujocoPlant

STEPS, DT = 75, 0.04
SECONDS = 4.0
STANDING, UPRIGHT = 0.8, 0.94  # of the height, cosine of the tilt


def stand_up_problem(robot: octo.Character) -> octo.Problem:
    """Height, roll, pitch and joints of the standing pose at every step; no joint or body moves
    faster than it must."""
    standing = walking_problem(robot, STEPS, DT)
    length, base = standing.length, int(robot.first_joint[robot.base_body])
    weights = np.zeros(robot.nx)
    weights[base + 2] = 5.0 / length**2
    weights[base + 4 : base + 6] = 1.0
    weights[robot.actuated] = 0.05
    costs = [
        octo.PoseTarget(target=standing.start, coordinates=weights, at="all", weight=0.01),
        octo.BaseAngularVelocity(weight=0.02 * length),
        octo.CenterOfMassVelocity(weight=0.003 / length),
        octo.JointVelocity(weight=0.02 * length),
        octo.Effort(weight=0.005),
        octo.TorqueLimit(weight=2.0),
    ]
    return standing.replace(costs=costs)


def lying(
    robot: octo.Character, standing: np.ndarray, roll: float, rng: np.random.Generator
) -> np.ndarray:
    """On the ground at a roll angle (rad), with random joints."""
    base, x = int(robot.first_joint[robot.base_body]), standing.copy()
    x[base + 4 : base + 6] = rng.uniform(-0.2, 0.2), roll + rng.uniform(-0.2, 0.2)
    moved = x[robot.actuated] + 0.3 * rng.standard_normal(robot.nu)
    x[robot.actuated] = np.clip(
        moved, robot.lower[robot.actuated] + 0.05, robot.upper[robot.actuated] - 0.05
    )
    lowest = octo.kinematics.sphere_centers(robot, x)[:, 2] - [
        contact.radius for contact in robot.contacts
    ]
    x[base + 2] -= lowest[list(robot.terrain_contacts)].min()
    return x


def first_plan(problem: octo.Problem, x: np.ndarray, starts: int) -> octo.Solution:
    """The better of two motions of three seconds from x, rolling to the left or to the right.

    The solver begins from a straight line to the standing pose, or from lying still with noise; E
    decides.
    """
    roll = int(problem.character.first_joint[problem.character.base_body]) + 5
    found = []
    for side in (0.0, -2.0 * np.pi * np.sign(x[roll])):
        begin = x.copy()
        begin[roll] += side
        scale = max(float(np.sum((problem.start - begin) ** 2)), 0.01)  # what PoseTarget divides by
        aim = octo.PoseTarget(
            target=problem.start, coordinates=problem.costs[0].coordinates, at="all", weight=scale
        )
        lying_down = problem.replace(x0=begin, costs=[aim, *problem.costs[1:]])
        share = np.clip(np.linspace(0.0, 2.0, STEPS + 1), 0.0, 1.0)[:, None]
        line = begin + share * (problem.start - begin)
        common = {"passes": 1, "device": "cpu", "max_iterations": 300}
        found.append(octo.solve(lying_down, start=line, **common))
        if starts > 1:
            found.append(octo.solve(lying_down, seeds=starts, **common))
        if abs(x[roll]) < 0.75 * np.pi:
            break  # on a side: there is one short way
    return min(found, key=lambda plan: plan.energy + 1e3 * (plan.violation > 1e-2 * plan.weight))


def rise(problem: octo.Problem, seed: int, starts: int = 4) -> dict[str, Any]:
    """One trial: odd seeds lie on their back, even ones on a side. ``stood``: s, from when on it
    stands, None for never."""
    robot, rng = problem.character, np.random.default_rng(seed)
    roll = np.pi if seed % 2 else (0.5 * np.pi if seed % 4 else -0.5 * np.pi)
    x = lying(robot, problem.start, roll, rng)
    plan = first_plan(problem, x, starts)
    plant = MujocoPlant(robot)
    plant.reset_chart(x)
    controller = Controller(problem, iterations=6)
    controller.warm_start(plan)
    stood: float | None = None
    for k in range(round(100 * SECONDS)):
        t = 0.01 * k
        controller.step(t, plant.q, plant.v)
        for j in range(5):
            plant.step(controller.command(t + 0.002 * j, plant.q, plant.v))
        up = plant.height > STANDING * problem.start[2] and plant.base_rotation[2, 2] > UPRIGHT
        stood = (t if stood is None else stood) if up else None
    return {
        "from": "back" if seed % 2 else "side",
        "stood": stood,
        "height": plant.height,
        "energy": plan.energy,
    }


if __name__ == "__main__":
    trials = 1 if "--short" in sys.argv else 10
    mammal = octo.gallery.mammal()
    described = stand_up_problem(mammal)
    results = [rise(described, seed, starts=1 if trials == 1 else 4) for seed in range(trials)]
    for result in results:
        stood = result["stood"]
        print(
            f"from its {result['from']}: "
            f"{'does not stand' if stood is None else f'stands after {stood:.2f} s'}"
        )
    share = float(np.mean([result["stood"] is not None for result in results]))
    print(f"{100 * share:.0f} % stand within {SECONDS:g} s")
    assert trials == 1 or share >= 0.4
