"""``octo mpc``: a robot under receding-horizon control in a plant, and what came of it."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from octo.checks import one_of
from octo.cli.arguments import (
    add_base_arguments,
    add_device_argument,
    add_options,
    number,
    pose_of,
    positive,
    robot_of,
    whole,
)
from octo.cli.output import OutputFolder, Writer, folder_of, say_left_out
from octo.cli.world import check_covered, ground_of_words
from octo.cli.written import write_json, write_page
from octo.errors import ProblemError, UnknownNameError, UsageError, ValueRangeError
from octo.goals import Goal
from octo.model.character import Character
from octo.model.robot_file import import_mujoco
from octo.model.terrain import Ground, Plane
from octo.replay.plan import ground_of
from octo.result.solution import Solution
from octo.world.world import World

FILES = ("log.npz", "plot.png", "motion.html", "report.json")
GOALS = ("walk", "stride", "turn", "stand")
PLANTS = ("mujoco", "octo")
RAISED = 0.02  # m, the plant's start is over the plan's
NOISE = 0.02  # rad and m, of its joints


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_base_arguments(parser)
    add_options(
        parser,
        ("--goal", None, "walk", "walk, stride (sideways), turn or stand"),
        ("--speed", number, 0.5, "m/s; rad/s for turn, its sign the side"),
        ("--stride", None, None, "of octo cycle: its motion in place of goal and speed", "DIR"),
        ("--blind", bool, False, "the plan knows of a level plane alone, the plant has the world"),
        ("--plant", None, "mujoco", "mujoco, or octo: its own implicit simulation"),
        # what the controller computes, how often and where
        ("--horizon", whole(3), 25, "steps of the plan"),
        ("--dt", positive, 0.04, "s, of one step of the plan"),
        ("--basis", None, "nodes", "of the plan: nodes, control has no other"),
        ("--iterations", whole(1), 1, "of Gauss-Newton in one call"),
        ("--rate", positive, 100.0, "Hz, of the controller's calls"),
        ("--budget", positive, None, "s, of one call (default: no limit)"),
    )
    where = "cpu; auto is cpu too, control has no loop on a GPU (default cpu)"
    add_device_argument(parser, "cpu", where)
    force = "newtons on the base for seconds from t = 5 s on, degrees from ahead"
    clock = "the plant keeps the clock's pace, the controller has a thread"
    add_options(
        parser,
        # the plant, and what the plan does not know of it
        ("--friction", number, 0.8, "between the plant's feet and ground"),
        ("--plan-friction", positive, 0.8, "in the plan"),
        ("--delay", whole(0), 0, "ticks from a measurement to its command"),
        ("--payload", number, 0.0, "parts of the trunk's mass, unknown to the plan"),
        ("--noise", number, 0.0, "of the sensors, 1 is a robot's"),
        ("--bumps", number, 0.0, "m, height of boxes the plan does not know"),
        ("--push", None, None, force, "N,S,DEG"),
        ("--realtime", bool, False, clock),
        ("--seconds", positive, 10.0, "s, of motion"),
        ("--seed", whole(0), 0, "of the start, the noise and the bumps"),
        ("--out", None, None, "folder of the four files (default ./octo-ROBOT-mpc)", "DIR"),
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Everything that can be refused is refused before anything is compiled."""
    one_of("goal", arguments.goal, GOALS)
    goal = Goal(arguments.goal, arguments.speed)
    push = _push(arguments.push)
    _check_words(arguments)
    folder = folder_of(arguments.out, arguments.robot, "mpc", FILES)
    robot = robot_of(arguments)
    goal.check(robot)
    stride = _stride(arguments.stride, robot)
    known, terrain = _grounds(arguments, stride)
    check_covered(terrain, [arguments.seconds * speed for speed in goal.velocity[:2]])
    _check_plant(arguments, robot, terrain, push)
    from octo.mpc import Controller
    from octo.mpc import run as close_the_loop
    from octo.mpc.measurement import check_device

    check_device(arguments.device)
    if stride is None:
        problem, guide = _problem(robot, goal, known, arguments)
    else:
        problem, guide = _tracking(stride, arguments)
    controller = Controller(
        problem, arguments.iterations, arguments.budget, arguments.device, guide=guide
    )
    plant = make_plant(robot, problem, terrain, arguments)
    rng = np.random.default_rng(arguments.seed)
    x = problem.start.copy()
    x[robot.actuated] += NOISE * rng.standard_normal(robot.nu)
    x[robot.base_coordinate + 2] += RAISED if stride is None else 0.0
    plant.reset_chart(x, problem.start_velocity)
    own = {
        name: getattr(arguments, name) for name in ("rate", "realtime", "noise", "delay", "seed")
    }
    log = close_the_loop(controller, plant, arguments.seconds, push=push, **own)
    what = {"robot": robot.name, "goal": goal.kind}
    _write(folder, log, {**what, "plant": arguments.plant, "seed": arguments.seed})
    print(log)
    print(f"written to {folder.path}")
    if log.interrupted:
        when = f"{log.t[-1]:.2f} s of {arguments.seconds:g}"
        print(f"octo: interrupted at t = {when}: what there was is written", file=sys.stderr)
        return 130
    return 0


def _check_words(arguments: argparse.Namespace) -> None:
    """Refuse what needs no robot to be refused."""
    one_of("plant", arguments.plant, PLANTS)
    if arguments.basis != "nodes":
        if arguments.basis != "hermite":
            raise UnknownNameError("basis", arguments.basis, ("nodes",))
        raise UsageError("basis is 'hermite', must be 'nodes': control plans in nodes only")
    for name in ("friction", "noise", "bumps"):
        if getattr(arguments, name) < 0.0:
            raise ValueRangeError(f"{name} is {getattr(arguments, name)}, must not be negative")


def _grounds(arguments: argparse.Namespace, stride: Solution | None) -> tuple[Ground, Ground]:
    """What the controller knows of the ground, and what the plant has.

    Raises
    ------
    UsageError: --blind without a world.
    """
    if arguments.blind and arguments.world is None:
        raise UsageError("--blind is of a controller on a world: it goes with --world")
    if stride is not None:
        plane = ground_of(stride)
        return plane, plane if arguments.world is None else ground_of_words(arguments)
    terrain = ground_of_words(arguments)
    return (Plane() if arguments.blind else terrain), terrain


def _problem(
    robot: Character, goal: Goal, terrain: Ground, arguments: argparse.Namespace
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
        gait=True if arguments.blind else None,
    )
    turning = goal.speed if goal.kind == "turn" else 0.0  # rad/s
    return problem, VelocityCommand(goal.velocity[:2], turning, feel=arguments.blind)


def _stride(path: str | None, robot: Character) -> Solution | None:
    """The cycle that is followed, if any."""
    if path is None:
        return None
    stride = Solution.load(path)
    if stride.cycle is None:
        raise ProblemError(f"stride {path} is no cycle: give what octo cycle wrote")
    own = stride.character
    if own is None or own.name != robot.name or own.nx != robot.nx:
        raise ProblemError(f"stride {path} is of {stride.name!r}, must be of {robot.name!r}")
    return stride


def _tracking(stride: Solution, arguments: argparse.Namespace) -> tuple[Any, Any]:
    """The problem that the controller plans by, and the guide that gives it its reference."""
    from octo.mpc import StrideReference, tracking_problem

    friction = arguments.plan_friction
    problem = tracking_problem(stride, arguments.horizon, arguments.dt, friction=friction)
    return problem, StrideReference(stride)


def make_plant(
    robot: Character, problem: Any, terrain: Ground, arguments: argparse.Namespace
) -> Any:
    """The machine of ``--plant``, in the time steps that the low level is damped for."""
    from octo.mpc.low_level import PERIOD

    if arguments.plant == "octo":
        from octo.plant import SimulatorPlant

        parameters = {"contact.mu": arguments.friction}
        own = {"law": problem.law, "parameters": parameters, "payload": arguments.payload}
        return SimulatorPlant(robot, terrain=terrain, timestep=PERIOD, **own)
    from octo.plant import MujocoPlant

    assert isinstance(terrain, (Plane, World))  # what _check_plant lets through
    own = {name: getattr(arguments, name) for name in ("friction", "payload", "bumps", "seed")}
    return MujocoPlant(robot, terrain=terrain, timestep=PERIOD, **own)


def _check_plant(
    arguments: argparse.Namespace, robot: Character, terrain: Ground, push: Any
) -> None:
    from octo.mpc.loop import timing
    from octo.mpc.low_level import PERIOD
    from octo.plant.mujoco_plant import loaded

    if arguments.plant == "octo" and arguments.bumps > 0.0:
        raise UsageError("bumps need --plant mujoco: octo's own simulation has one smooth ground")
    if arguments.plant == "mujoco" and not isinstance(terrain, (Plane, World)):
        raise UsageError(
            "--plant mujoco has a plane, a slope or a world for its ground: use --plant octo for "
            "another terrain"
        )
    if arguments.bumps > 0.0 and isinstance(terrain, World):
        raise UsageError("--bumps lie on a plane: they do not go with --world")
    if arguments.plant == "mujoco":
        import_mujoco("a plant in MuJoCo")
    loaded(robot, arguments.payload)
    timing(arguments.seconds, arguments.rate, PERIOD, push, arguments.delay)


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
