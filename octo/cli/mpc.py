"""``octo mpc``: a robot under receding-horizon control in a plant, and what came of it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from octo.cli.arguments import (
    add_base_arguments,
    add_device_argument,
    number,
    pose_of,
    positive,
    robot_of,
    terrain_of,
    whole,
)
from octo.cli.output import OutputFolder, Writer, default_folder, say_left_out
from octo.cli.solve import write_json, write_page
from octo.errors import UnknownNameError, UsageError, ValueRangeError
from octo.goals import Goal
from octo.model.character import Character
from octo.model.robot_file import import_mujoco
from octo.model.terrain import Plane, Terrain

FILES = ("log.npz", "plot.png", "motion.html", "report.json")
GOALS = ("walk", "stride", "turn", "stand")
PLANTS = ("mujoco", "octo")
RAISED = 0.02  # m, the plant's start is over the plan's
NOISE = 0.02  # rad and m, of its joints


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_base_arguments(parser)
    parser.add_argument(
        "--goal", default="walk", help="walk, stride (sideways), turn or stand (default walk)"
    )
    parser.add_argument(
        "--speed",
        type=number,
        default=0.5,
        help="m/s; rad/s for turn, its sign the side (default 0.5)",
    )
    parser.add_argument(
        "--plant",
        default="mujoco",
        help="mujoco, or octo: its own implicit simulation (default mujoco)",
    )
    _add_plan_arguments(parser)
    _add_plant_arguments(parser)
    parser.add_argument("--seconds", type=positive, default=10.0, help="s, of motion (default 10)")
    parser.add_argument(
        "--seed", type=whole(0), default=0, help="of the start, the noise and the bumps (default 0)"
    )
    parser.add_argument(
        "--out", metavar="DIR", help="folder of the four files (default ./octo-ROBOT-mpc)"
    )
    parser.set_defaults(run=run)


def _add_plan_arguments(parser: argparse.ArgumentParser) -> None:
    """What the controller computes, how often and where."""
    parser.add_argument(
        "--horizon", type=whole(3), default=25, help="steps of the plan (default 25)"
    )
    parser.add_argument(
        "--dt", type=positive, default=0.04, help="s, of one step of the plan (default 0.04)"
    )
    parser.add_argument(
        "--basis", default="nodes", help="of the plan: nodes, control has no other (default nodes)"
    )
    parser.add_argument(
        "--iterations", type=whole(1), default=1, help="of Gauss-Newton in one call (default 1)"
    )
    parser.add_argument(
        "--rate", type=positive, default=100.0, help="Hz, of the controller's calls (default 100)"
    )
    parser.add_argument("--budget", type=positive, help="s, of one call (default: no limit)")
    add_device_argument(
        parser, "cpu", "cpu; auto is cpu too, control has no loop on a GPU (default cpu)"
    )


def _add_plant_arguments(parser: argparse.ArgumentParser) -> None:
    """The plant, and what the plan does not know of it."""
    parser.add_argument(
        "--friction",
        type=number,
        default=0.8,
        help="between the plant's feet and ground (default 0.8)",
    )
    parser.add_argument(
        "--plan-friction", type=positive, default=0.8, help="in the plan (default 0.8)"
    )
    parser.add_argument(
        "--delay",
        type=whole(0),
        default=0,
        help="ticks from a measurement to its command (default 0)",
    )
    parser.add_argument(
        "--payload",
        type=number,
        default=0.0,
        help="parts of the trunk's mass, unknown to the plan (default 0)",
    )
    parser.add_argument(
        "--noise", type=number, default=0.0, help="of the sensors, 1 is a robot's (default 0)"
    )
    parser.add_argument(
        "--bumps",
        type=number,
        default=0.0,
        help="m, height of boxes the plan does not know (default 0)",
    )
    parser.add_argument(
        "--push",
        metavar="N,S,DEG",
        help="newtons on the base for seconds from t = 5 s on, degrees from ahead",
    )
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="the plant keeps the clock's pace, the controller has a thread",
    )


def run(arguments: argparse.Namespace) -> int:
    """Everything that can be refused is refused before anything is compiled."""
    goal = _goal(arguments)
    push = _push(arguments.push)
    _check_words(arguments)
    folder = OutputFolder(arguments.out or default_folder(Path(arguments.robot).stem, "mpc"))
    folder.check(FILES)
    robot = robot_of(arguments)
    goal.check(robot)
    terrain = terrain_of(arguments.terrain)
    _check_plant(arguments, robot, terrain, push)
    from octo.mpc import Controller
    from octo.mpc import run as close_the_loop
    from octo.mpc.measurement import check_device

    check_device(arguments.device)
    problem, guide = _problem(robot, goal, terrain, arguments)
    controller = Controller(
        problem, arguments.iterations, arguments.budget, arguments.device, guide=guide
    )
    plant = make_plant(robot, problem, terrain, arguments)
    rng = np.random.default_rng(arguments.seed)
    x = problem.start.copy()
    x[robot.actuated] += NOISE * rng.standard_normal(robot.nu)
    x[robot.base_coordinate + 2] += RAISED
    plant.reset_chart(x)
    log = close_the_loop(
        controller,
        plant,
        arguments.seconds,
        rate=arguments.rate,
        realtime=arguments.realtime,
        noise=arguments.noise,
        delay=arguments.delay,
        push=push,
        seed=arguments.seed,
    )
    known = {"robot": robot.name, "goal": goal.kind}
    _write(folder, log, {**known, "plant": arguments.plant, "seed": arguments.seed})
    print(log)
    print(f"written to {folder.path}")
    if log.interrupted:
        print(
            f"octo: interrupted at t = {log.t[-1]:.2f} s of {arguments.seconds:g}: what there was "
            "is written",
            file=sys.stderr,
        )
        return 130
    return 0


def _check_words(arguments: argparse.Namespace) -> None:
    """Refuse what needs no robot to be refused."""
    if arguments.plant not in PLANTS:
        raise UnknownNameError("plant", arguments.plant, PLANTS)
    if arguments.basis != "nodes":
        if arguments.basis != "hermite":
            raise UnknownNameError("basis", arguments.basis, ("nodes",))
        raise UsageError("basis is 'hermite', must be 'nodes': control plans in nodes only")
    for name in ("friction", "noise", "bumps"):
        if getattr(arguments, name) < 0.0:
            raise ValueRangeError(f"{name} is {getattr(arguments, name)}, must not be negative")


def _problem(
    robot: Character, goal: Goal, terrain: Plane | Terrain, arguments: argparse.Namespace
) -> tuple[Any, Any]:
    """The problem that the controller plans by, and the guide that gives it its velocity."""
    from octo.mpc import VelocityCommand, walking_problem

    problem = walking_problem(
        robot,
        arguments.horizon,
        arguments.dt,
        friction=arguments.plan_friction,
        pose=pose_of(robot, arguments.pose),
        terrain=terrain,
    )
    turning = goal.speed if goal.kind == "turn" else 0.0  # rad/s
    return problem, VelocityCommand(goal.velocity[:2], turning)


def make_plant(
    robot: Character, problem: Any, terrain: Plane | Terrain, arguments: argparse.Namespace
) -> Any:
    """The machine of ``--plant``, in the time steps that the low level is damped for."""
    from octo.mpc.low_level import PERIOD

    if arguments.plant == "octo":
        from octo.plant import SimulatorPlant

        parameters = {"contact.mu": arguments.friction}
        return SimulatorPlant(
            robot,
            law=problem.law,
            terrain=terrain,
            parameters=parameters,
            timestep=PERIOD,
            payload=arguments.payload,
        )
    from octo.plant import MujocoPlant

    assert isinstance(terrain, Plane)  # what _check_plant lets through
    return MujocoPlant(
        robot,
        terrain=terrain,
        friction=arguments.friction,
        payload=arguments.payload,
        bumps=arguments.bumps,
        seed=arguments.seed,
        timestep=PERIOD,
    )


def _check_plant(
    arguments: argparse.Namespace, robot: Character, terrain: Plane | Terrain, push: Any
) -> None:
    from octo.mpc.loop import timing
    from octo.mpc.low_level import PERIOD
    from octo.plant.mujoco_plant import loaded

    if arguments.plant == "octo" and arguments.bumps > 0.0:
        raise UsageError("bumps need --plant mujoco: octo's own simulation has one smooth ground")
    if arguments.plant == "mujoco" and not isinstance(terrain, Plane):
        raise UsageError(
            "--plant mujoco has a plane or a slope for its ground: use --plant octo for another "
            "terrain"
        )
    if arguments.plant == "mujoco":
        import_mujoco("a plant in MuJoCo")
    loaded(robot, arguments.payload)
    timing(arguments.seconds, arguments.rate, PERIOD, push, arguments.delay)


def _goal(arguments: argparse.Namespace) -> Goal:
    if arguments.goal not in GOALS:
        raise UnknownNameError("goal", arguments.goal, GOALS)
    return Goal(arguments.goal, arguments.speed)


def _push(word: str | None) -> Any:
    from octo.mpc.loop import Push

    if word is None:
        return None
    try:
        force, seconds, degrees = (float(part) for part in word.split(","))
        finite = bool(np.isfinite([force, seconds, degrees]).all()) and seconds > 0.0
    except ValueError:
        finite = False
    if not finite:
        raise ValueRangeError(
            f"push is {word!r}, must be newtons, positive seconds and degrees: N,S,DEG"
        )
    return Push(force, seconds, degrees)


def _write(folder: OutputFolder, log: Any, known: dict[str, Any]) -> None:
    def write_plot(path: Path) -> None:
        # here: what draws is loaded when the numbers are written
        from octo.cli.mpc_plot import plot_log

        plot_log(log, path)

    writers: dict[str, Writer] = {
        "log.npz": log.save,
        "report.json": lambda path: write_json(path, {**log.report(), **known}),
        "plot.png": write_plot,
        "motion.html": lambda path: write_page(log.solution(), path),
    }
    say_left_out(folder.write(writers))
