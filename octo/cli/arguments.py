"""What the words of the command line mean: numbers, poses, terrains, friction."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import casadi as ca
import numpy as np

from octo.checks import numbers, one_of, steps_in
from octo.dynamics.laws import ContactLaw, Coulomb, Smooth, Viscous
from octo.errors import (
    ProblemError,
    RobotFileError,
    ShapeError,
    UnknownNameError,
    UsageError,
    ValueRangeError,
)
from octo.model.character import Character
from octo.model.describe import lost_shapes
from octo.model.load import load
from octo.model.quantities import Array
from octo.model.terrain import Plane, Terrain
from octo.model.world_file import ENDINGS
from octo.problem.constraints import Constraint
from octo.problem.hard import MU, Kind, limits

WHOLE = 1e-6  # seconds/dt may be that far from a whole number
POSE_FILES = (".json", ".npy", ".txt")


def whole(least: int) -> Callable[[str], int]:
    """A whole number of at least ``least``, for argparse."""

    def convert(word: str) -> int:
        try:
            value = int(word)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(
                f"is {word!r}, must be a whole number of at least {least}"
            )
        return value

    return convert


def numbers_of(word: str) -> tuple[float, ...]:
    """Numbers with commas between them; none where one of them is no number."""
    try:
        return tuple(number(part) for part in word.split(","))
    except argparse.ArgumentTypeError:
        return ()


def number(word: str) -> float:
    """A finite number, for argparse."""
    value = _float(word)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"is {word!r}, must be a finite number")
    return value


def _float(word: str) -> float:
    """NaN where it is no number."""
    try:
        return float(word)
    except ValueError:
        return math.nan


def positive(word: str) -> float:
    value = number(word)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"is {word!r}, must be positive")
    return value


def steps_of(seconds: float, dt: float) -> int:
    """N, the whole number of steps of ``dt`` s in ``seconds``."""
    steps = steps_in(seconds, dt)
    count = seconds / dt
    if steps < 1 or abs(count - steps) > WHOLE:
        near = max(1, steps) * dt
        raise ValueRangeError(
            f"seconds/dt is {count:.9g}, must be whole to {WHOLE:g} and at least 1: try --seconds "
            f"{near:.9g}"
        )
    return steps


def add_options(parser: argparse.ArgumentParser, *rows: tuple[Any, ...]) -> None:
    """Options, a row each: name, what reads its word (bool: it takes none), default, help, and what
    the help calls the word. The help ends with the default where it does not say it itself."""
    for name, read, default, words, *metavar in rows:
        if read is bool:
            parser.add_argument(name, action="store_true", help=words)
            continue
        if default is not None and "default" not in words:
            words = f"{words} (default {f'{default:g}' if read else default})"
        called = metavar[0] if metavar else None
        parser.add_argument(name, type=read, default=default, metavar=called, help=words)


ROBOT = (
    "a name that `octo robots` lists, or a URDF or MJCF file; for solve, compare and simulate also "
    "a soft body: ball, beam or a mesh file, sizes behind it as in beam:young=2e4"
)
BASE = "auto, floating or fixed (default auto: an MJCF as written, a URDF floating)"
POSE = (
    "a pose of the robot's file, or nx numbers in .json, .npy or .txt; with --goal up "
    "lying:SEED, lying:back or lying:front"
)
CONTACTS = "few spheres of the collision shapes (default), or all vertices of their meshes"
TERRAIN = "the ground; FUNCTION(point, p) is a signed distance in CasADi"
WORLD = (
    "shapes in place of --terrain: a name of octo.worlds with its sizes "
    f"(stairs:rise=0.1,run=0.3,n=5), or a file ({', '.join(ENDINGS)}; map.png:cell=0.05,height=1)"
)
CELL = "m, from one sample of a map, or of a mesh's distances, to the next"
LAW = (
    "a number or coulomb[:MU]: regularised Coulomb; viscous[:RATIO] (default): Eq. 6, "
    "w_par/w_perp in s/m"
)


def add_base_arguments(parser: argparse.ArgumentParser) -> None:
    """What says which robot starts how, on what ground."""
    parser.add_argument("robot", metavar="ROBOT", help=ROBOT)
    add_options(
        parser,
        ("--base", None, "auto", BASE),
        ("--contacts", None, "few", CONTACTS, "few|vertices"),
        ("--pose", None, None, POSE, "NAME|FILE"),
    )
    parser.add_argument(
        "--terrain", default="plane", metavar="plane|slope:DEGREES|FILE.py:FUNCTION", help=TERRAIN
    )
    add_world_arguments(parser)


def add_world_arguments(parser: argparse.ArgumentParser) -> None:
    """Shapes as the ground."""
    add_options(
        parser,
        ("--world", None, None, WORLD, "FILE|NAME[:SIZES]"),
        ("--cell", positive, None, CELL, "M"),
    )


def add_robot_arguments(parser: argparse.ArgumentParser) -> None:
    """The same with the contact law and the step."""
    add_base_arguments(parser)
    add_law_argument(parser)
    add_options(parser, ("--dt", positive, 0.025, "s, of one step"))


def add_law_argument(parser: argparse.ArgumentParser) -> None:
    add_options(parser, ("--friction", None, "viscous", LAW, "MU|LAW"))


def add_limits_arguments(parser: argparse.ArgumentParser) -> None:
    """Whether the limits of the robot must hold."""
    held = "soft: what the terms make of torques, joints, speeds and friction; hard: these hold"
    mu = f"friction of the ground, of --limits hard (default {MU:g})"
    add_options(parser, ("--limits", None, "soft", held, "soft|hard"), ("--mu", positive, None, mu))


def check_limits(arguments: argparse.Namespace) -> None:
    """Refuse words about limits that do not go together.

    Raises
    ------
    OctoError: names the option.
    """
    one_of("limits", arguments.limits, get_args(Kind))
    if arguments.mu is not None and arguments.limits != "hard":
        raise UsageError("--mu is of limits that hold: it goes with --limits hard")


def limits_of(robot: Character, arguments: argparse.Namespace) -> list[Constraint]:
    """What must hold."""
    if arguments.limits != "hard":
        return []
    return limits(robot, mu=MU if arguments.mu is None else arguments.mu)


def add_solver_arguments(
    parser: argparse.ArgumentParser,
    device: str = "auto",
    seeds: int | None = 1,
    starts: str | None = None,
) -> None:
    """How a problem is solved; ``starts`` says in words what a default of None means."""
    found = "what octo wrote, to start from: a solution (.npz) or its folder"
    add_options(
        parser,
        ("--passes", whole(1), None, "passes of growing contact stiffness (default: octo's own)"),
        ("--seeds", whole(1), seeds, f"starts, solved as one batch (default {starts or seeds})"),
        ("--seed", whole(0), 0, "number of the first start"),
        ("--start", None, None, found, "SOLUTION"),
        ("--threads", whole(1), 1, "of the CPU"),
        ("--max-iterations", whole(1), None, "of one pass"),
        ("--time-limit", positive, None, "s, of all passes"),
        ("--tolerance", positive, None, "‖C‖∞ relative to mg"),
    )
    add_device_argument(parser, device, f"auto, cpu or cuda (default {device})")


def add_device_argument(parser: argparse.ArgumentParser, device: str, words: str) -> None:
    """Where it is computed; ``device`` where nothing is said, which ``octo.cli.main.parse`` fills
    in."""
    add_options(
        parser,
        ("--device", None, None, words),
        ("--verbose", bool, False, "say on which device, and why, as --device does"),
    )
    parser.set_defaults(usual_device=device)


LIMITS = ("max_iterations", "time_limit", "tolerance")
SOLVER = ("passes", "seeds", "seed", "threads", *LIMITS, "device")


def solver_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """What ``octo.solve`` is called with; a start is loaded by the caller."""
    return {name: getattr(arguments, name) for name in SOLVER}


def robot_of(arguments: argparse.Namespace) -> Character:
    """The robot of the command line; a line on stderr says which of its shapes could not be
    read."""
    robot = load(arguments.robot, arguments.base, arguments.contacts)
    lost = lost_shapes(robot)
    if lost:
        print(f"octo: {arguments.robot}: {lost}", file=sys.stderr)
    return robot


def pose_of(robot: Character, word: str | None) -> Array | None:
    """(nx,) rad and m: a pose that the robot knows by name, or the numbers of a file."""
    if word is None:
        return None
    if word in robot.poses:
        return np.asarray(robot.poses[word], dtype=float)
    path = Path(word)
    if path.suffix not in POSE_FILES:
        valid = f"{', '.join(robot.poses) or 'no names'}, or a file ({', '.join(POSE_FILES)})"
        raise UsageError(f"pose {word!r} is not known; robot {robot.name!r} has {valid}")
    pose = _read_numbers(path)
    if pose.shape != (robot.nx,):
        wanted = f"({robot.nx},), the coordinates of {robot.name!r}"
        raise ShapeError(f"pose {word!r}", pose.shape, wanted)
    return numbers(f"pose {word!r}", pose)


def _read_numbers(path: Path) -> Array:
    try:
        if path.suffix == ".json":
            return np.asarray(json.loads(path.read_text(encoding="utf-8")), dtype=float)
        if path.suffix == ".npy":
            return np.asarray(np.load(path, allow_pickle=False), dtype=float)
        return np.atleast_1d(np.loadtxt(path)).ravel()
    except FileNotFoundError as error:
        raise RobotFileError(f"pose file {path} does not exist") from error
    except (OSError, ValueError, TypeError) as error:
        raise RobotFileError(
            f"pose file {path} does not hold a list of numbers: {error}"
        ) from error


def law_of(word: str) -> ContactLaw | None:
    """The contact law of ``--friction``; None is octo's own."""
    name, _, value = word.partition(":")
    if name == "viscous":
        ratio = _friction_number(word, value, None)
        return None if ratio is None else Smooth(friction=Viscous(w_par=ratio * Smooth().w_perp))
    mu = _friction_number(word, value if name == "coulomb" else word, Coulomb().mu)
    assert mu is not None
    return Smooth(friction=Coulomb(mu=mu))


def _friction_number(word: str, text: str, default: float | None) -> float | None:
    if not text and ":" not in word:
        return default
    value = _float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise ValueRangeError(
            f"friction is {word!r}, must be a positive mu, coulomb[:MU] or viscous[:RATIO]"
        )
    return value


def terrain_of(word: str) -> Plane | Terrain:
    """The ground of ``--terrain``."""
    name, _, value = word.partition(":")
    if word == "plane":
        return Plane()
    if name == "slope":
        return Plane(slope=_slope(word, value))
    file, _, function = word.rpartition(":")
    if not file.endswith(".py") or not function:
        raise UnknownNameError("terrain", word, ("plane", "slope:DEGREES", "FILE.py:FUNCTION"))
    made = _attribute(Path(file), function)
    terrain = made if isinstance(made, (Plane, Terrain)) else Terrain(made)
    _try(terrain, word)
    return terrain


def _slope(word: str, value: str) -> float:
    """rad."""
    degrees = _float(value)
    if not abs(degrees) < 90.0:
        raise ValueRangeError(
            f"terrain is {word!r}: the slope must be a number of degrees between -90 and 90"
        )
    return math.radians(degrees)


def _attribute(file: Path, name: str) -> Any:
    """What a user's Python file calls ``name``."""
    if not file.is_file():
        raise RobotFileError(f"terrain file {file} does not exist")
    module = ModuleType("octo_user_terrain")
    module.__file__ = str(file)
    try:  # not imported, which would leave bytecode beside the user's file
        exec(compile(file.read_bytes(), file, "exec"), vars(module))
    except Exception as error:  # a user's code may raise anything
        raise ProblemError(
            f"terrain file {file} cannot be run: {type(error).__name__}: {error}"
        ) from error
    if not hasattr(module, name):
        known = [key for key, value in vars(module).items() if callable(value)]
        raise UnknownNameError(f"function of {file}", name, known)
    return getattr(module, name)


def _try(terrain: Plane | Terrain, word: str) -> None:
    """Refuse a user-written distance that is no scalar expression of the point."""
    point, p = ca.SX.sym("point", 3), {key: ca.SX.sym(key) for key in terrain.parameters}
    try:
        distance = ca.SX(terrain.distance(point, p))
        fits = distance.numel() == 1 and bool(ca.depends_on(distance, point))
    except Exception as error:  # a user's code may raise anything
        raise ProblemError(
            f"terrain {word!r} cannot be evaluated: {type(error).__name__}: {error}"
        ) from error
    if not fits:
        raise ProblemError(
            f"terrain {word!r} must return one CasADi expression of the point (3,), its signed "
            "distance in m"
        )
