"""``octo simulate``: what a robot does without a plan, limp or with springs that hold its pose."""

from __future__ import annotations

import argparse
import dataclasses
import time
from typing import Any

import numpy as np

from octo.cli.arguments import (
    add_options,
    add_robot_arguments,
    law_of,
    number,
    pose_of,
    positive,
    robot_of,
    steps_of,
)
from octo.cli.output import OutputFolder, Writer, folder_of, say_left_out
from octo.cli.soft import folder_word, is_soft
from octo.cli.soft_solve import dropped
from octo.cli.world import ground_of_words
from octo.cli.written import write_json, write_page
from octo.dynamics.balance import Balance
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.simulate import Motion, simulate
from octo.dynamics.static_pose import inside_limits
from octo.model.character import Character
from octo.model.quantities import GRAVITY, Array
from octo.problem.compiled import CompiledProblem
from octo.problem.joint_costs import Effort
from octo.problem.problem import Problem
from octo.result.measure import measured
from octo.result.solution import Solution, recorded
from octo.solver.status import Status

FILES = ("solution.npz", "report.json", "motion.html")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_robot_arguments(parser)
    add_options(
        parser,
        ("--seconds", positive, 2.0, "s, of motion"),
        ("--height", number, 0.0, "m, the start is raised by"),
        ("--hold", bool, False, "springs in the actuated joints hold the start's pose"),
        ("--out", None, None, "folder of the files (default ./octo-ROBOT-simulate)", "DIR"),
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    steps = steps_of(arguments.seconds, arguments.dt)
    soft = is_soft(arguments.robot)
    word = folder_word(arguments.robot) if soft else arguments.robot
    folder = folder_of(arguments.out, word, "simulate", FILES)
    began = time.perf_counter()
    if soft:
        problem = dropped(arguments, steps)
    else:
        robot = robot_of(arguments)
        problem = placed(robot, pose_of(robot, arguments.pose), steps, arguments)
    setup = time.perf_counter() - began
    motion = simulate(
        problem.dynamics, problem.start, steps=steps, dt=arguments.dt, parameters=problem.values
    )
    solution = measured_motion(problem, motion, setup, time.perf_counter() - began - setup)
    write(folder, solution)
    print(solution)
    print(f"written to {folder.path}")
    return 0 if solution.converged else 1


def placed(
    robot: Character, pose: Array | None, steps: int, arguments: argparse.Namespace
) -> Problem:
    """The robot on the ground (or ``--height`` above it) in its pose, as a problem that nobody
    solves."""
    default = robot.start_pose
    start = inside_limits(robot, default if pose is None else pose)
    if arguments.hold:
        robot = held(robot, start)
    terrain, law = ground_of_words(arguments), law_of(arguments.friction)
    own: dict[str, Any] = {"steps": steps, "dt": arguments.dt, "costs": [Effort()]}
    draft = Problem(robot, terrain=terrain, law=law, **own)
    assert isinstance(draft.dynamics, RobotDynamics)
    balance = Balance(draft.dynamics, draft.p, start)
    start = balance.start.copy()
    if balance.lift is not None:
        start[balance.lift] += arguments.height
    return draft.replace(x0=start)


def held(robot: Character, pose: Array) -> Character:
    """The robot with a damped spring in every actuated joint: 0.1 rad for the weight at a tenth of
    a metre."""
    stiffness = 10.0 * robot.mass * GRAVITY * 0.1  # N m/rad, or N/m of a slide

    bodies = []
    for body, first in zip(robot.bodies, robot.first_joint, strict=True):
        joints = list(body.joints)
        for k, joint in enumerate(joints):
            if joint.actuated:
                rest = float(pose[int(first) + k])
                spring = dataclasses.replace(joint, stiffness=stiffness, rest=rest)
                joints[k] = dataclasses.replace(spring, damping=0.1 * stiffness)
        bodies.append(dataclasses.replace(body, joints=tuple(joints)))
    return dataclasses.replace(robot, bodies=tuple(bodies))


def measured_motion(problem: Problem, motion: Motion, setup: float, seconds: float) -> Solution:
    """The motion with its contact forces, as a Solution that nothing was optimised in."""
    compiled = CompiledProblem([problem])
    at = compiled.evaluate(compiled.unknowns(motion.x[None]))
    solved = bool(motion.converged.all())
    status = Status.SIMULATED if solved else Status.UNSOLVED
    own = {"multipliers": np.zeros((compiled.K, compiled.ma)), "status": status}
    return recorded(**measured(compiled, at, 0), **own, seconds=seconds, setup_seconds=setup)


def write(folder: OutputFolder, solution: Solution) -> None:
    writers: dict[str, Writer] = {
        "solution.npz": solution.save,
        "report.json": lambda path: write_json(path, solution.report()),
        "motion.html": lambda path: write_page(solution, path),
    }
    say_left_out(folder.write(writers))
