"""The parser of the command line, and the exit codes."""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import NoReturn

import octo
from octo.cli import (
    bench,
    compare,
    completion,
    cycle,
    explain,
    export,
    graph,
    inspect,
    learn,
    mpc,
    replay,
    simulate,
    solve,
    view,
)
from octo.errors import OctoError, UnknownNameError, UsageError

REFUSED = 2
EXAMPLES = """examples:
  octo solve mammal --goal walk --speed 0.5 --seconds 10 --out demo
  octo solve go2.urdf --goal turn --speed 0.5 --costs robot
  octo solve ball --goal jump --out hop
  octo cycle mammal --speed 0.5 --period auto --out stride
  octo learn biped --seconds 10 --hidden 16,16 --out walk
  octo compare mammal --seconds 10 --seeds 5 --with ipopt,fatrop --json compare.json
  octo bench --json bench.json
  octo graph build mammal --motions walk,left,jump --seconds 10 --out mammal.graph
  octo graph play mammal.graph --script walk:3,left:2,jump:1 --out played
  octo mpc go2.urdf --goal walk --speed 0.3 --seconds 20 --push 50,0.2,90 --out walk
  octo info go2.urdf --json
  octo simulate biped --seconds 2 --hold
  octo replay demo --starts 5
  octo explain demo
  octo view demo --out motion.html
  octo export demo --out motion.glb
  octo completion bash > ~/.local/share/bash-completion/completions/octo"""


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose mistakes are one-line errors like all others."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; see {self.prog} --help")


def parser() -> tuple[Parser, dict[str, Parser]]:
    """The whole parser, and that of each command."""
    top = Parser(
        prog="octo",
        description=octo.__doc__,
        epilog=EXAMPLES,
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("-V", "--version", action="version", version=f"octo {octo.__version__}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)
    made: dict[str, Parser] = {}
    modules: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {
        "solve": ("find a motion and write it", solve.add_arguments),
        "cycle": ("find a stride that repeats itself and write it", cycle.add_arguments),
        "learn": ("find a motion and a network that says it", learn.add_arguments),
        "graph": ("motions and transitions between them, and ways through", graph.add_arguments),
        "mpc": ("let a controller that plans ahead walk a robot in MuJoCo", mpc.add_arguments),
        "compare": (
            "solve the same problem with octo and with other solvers",
            compare.add_arguments,
        ),
        "bench": ("what octo costs on this machine", bench.add_arguments),
        "info": (
            "what a robot file holds, or what this machine can use",
            inspect.add_info_arguments,
        ),
        "robots": ("the robots that octo brings along", inspect.add_robots_arguments),
        "simulate": ("let a robot move without a plan", simulate.add_arguments),
        "replay": ("run a saved plan in MuJoCo", replay.add_arguments),
        "explain": ("why a saved solve ended as it did", explain.add_arguments),
        "view": ("a picture of a saved solution or log", view.add_arguments),
        "export": ("a saved motion as animated glTF, BVH or video", export.add_arguments),
        "completion": (
            "a script with which a shell completes what you type",
            completion.add_arguments,
        ),
        "help": ("what octo can do, or how one command is used", add_help_arguments),
    }
    for name, (sentence, add_arguments) in modules.items():
        made[name] = commands.add_parser(
            name, help=sentence, description=sentence, allow_abbrev=False
        )
        add_arguments(made[name])
    made["completion"].set_defaults(commands=made)
    return top, made


def add_help_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "topic", metavar="COMMAND", nargs="?", help="a command (default: all of them)"
    )
    parser.set_defaults(run=show_help)


def show_help(arguments: argparse.Namespace) -> int:
    """``octo help COMMAND`` is ``octo COMMAND --help``."""
    top, commands = parser()
    if arguments.topic is not None and arguments.topic not in commands:
        raise UnknownNameError("command", arguments.topic, commands)
    (top if arguments.topic is None else commands[arguments.topic]).print_help()
    return 0


def parse(words: Sequence[str]) -> argparse.Namespace:
    """The arguments; a command or an option that does not exist is refused with its nearest
    names."""
    top, commands = parser()
    words = solve.with_place(words)
    if words and not words[0].startswith("-") and words[0] not in commands:
        raise UnknownNameError("command", words[0], commands)
    for word in words:  # argparse takes the two dashes for the end of all options
        if word.startswith("--") and word.endswith("=--"):
            raise UsageError(f"argument {word.removesuffix('=--')}: is '--', must be a value")
    arguments, left = top.parse_known_args(words)
    if left:
        own = commands[arguments.command] if arguments.command else top
        valid = getattr(arguments, "parser", own)._option_string_actions
        if left[0].startswith("-"):
            raise UnknownNameError(
                "option", left[0], [name for name in valid if name.startswith("--")]
            )
        raise UsageError(
            f"argument {left[0]!r} is not expected; see octo {arguments.command} --help"
        )
    if arguments.command is None:
        raise UsageError(f"a command is missing, must be one of {', '.join(commands)}")
    if "device" in arguments:
        arguments.verbose = arguments.verbose or arguments.device is not None
        arguments.device = arguments.device or arguments.usual_device
    return arguments


class Lines(logging.Handler):
    """What the package logs, as lines like octo's others."""

    def emit(self, record: logging.LogRecord) -> None:
        print(f"octo: {record.getMessage()}", file=sys.stderr)


@contextlib.contextmanager
def logged_on_stderr(everything: bool) -> Iterator[None]:
    """With octo's warnings on stderr; ``everything``: also on which device it solves, and why."""
    log, lines = logging.getLogger("octo"), Lines()
    level = log.level
    log.addHandler(lines)
    log.setLevel(logging.INFO if everything else logging.WARNING)
    try:
        yield
    finally:
        log.removeHandler(lines)
        log.setLevel(level)


def main(words: Sequence[str] | None = None) -> int:
    """Run one command; the exit code."""
    try:
        arguments = parse(sys.argv[1:] if words is None else words)
        with logged_on_stderr(getattr(arguments, "verbose", False)):
            return int(arguments.run(arguments))
    except OctoError as error:
        print(f"octo: error: {' '.join(str(error).split())}", file=sys.stderr)
        return REFUSED
    except MemoryError:
        print(
            "octo: error: this machine has not enough memory for so many steps or starts",
            file=sys.stderr,
        )
        return REFUSED
    except BrokenPipeError:  # `octo robots | head`: the reader has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
