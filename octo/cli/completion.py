"""``octo completion``: a script with which a shell completes commands, options and words."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping
from typing import get_args

from octo.cli.graph import DOING
from octo.cli.soft import SHAPES
from octo.errors import UnknownNameError
from octo.goals import Kind, Preset
from octo.model.gallery import CHARACTERS
from octo.model.load import BASES
from octo.worlds import WORLDS

SHELLS = ("bash", "zsh", "fish")
TAKES = (  # of options, the words that they take, or that begin what they take
    "basis nodes hermite; contacts few vertices; device auto cpu cuda; terrain plane slope:; "
    "friction viscous coulomb; limits soft hard; plant mujoco octo; feedback base none; "
    "with ipopt fatrop; period auto"
)
WORDS = {f"--{name}": tuple(words) for name, *words in map(str.split, TAKES.split("; "))}
WORDS |= {"--goal": get_args(Kind), "--costs": get_args(Preset), "--base": BASES}
WORDS |= {"--world": tuple(WORLDS)}
OR_FILES = ("--world",)  # options that take a file as well
OTHERS: dict[str, tuple[str, ...]] = {"mpc --goal": ("walk", "stride", "turn", "stand")}
OTHERS |= {"learn --goal": ("walk", "stride", "turn", "stand")}
OTHERS |= {f"{name} --goal": (*get_args(Kind), "roll", "crawl") for name in ("solve", "compare")}
OTHERS |= {"replay --plant": ("mujoco",), "mpc --basis": ("nodes",)}
# commands whose first word may be a robot's name
ROBOTS = ("solve", "cycle", "learn", "mpc", "compare", "simulate", "info")
SOFT = ("solve", "compare", "simulate", "info")  # and a soft body's
BASH = """_octo() {
  local current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]} words= files=yes
  [[ $current == '=' ]] && current=
  [[ $before == '=' ]] && before=${COMP_WORDS[COMP_CWORD-2]}
  if (( COMP_CWORD == 1 )); then
    words=TOP files=
  else
    case ${COMP_WORDS[1]}:$before in
CASES
    esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$current"))
  [[ $files ]] && COMPREPLY+=($(compgen -f -- "$current"))
}
complete -o filenames -F _octo octo"""
HOW = {
    "bash": "octo completion bash > ~/.local/share/bash-completion/completions/octo",
    "zsh": 'eval "$(octo completion zsh)", in ~/.zshrc behind compinit',
    "fish": "octo completion fish > ~/.config/fish/completions/octo.fish",
}
Parsers = Mapping[str, argparse.ArgumentParser]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", metavar="SHELL", help=f"{', '.join(SHELLS)}")
    parser.epilog = "; ".join(f"{shell}: {how}" for shell, how in HOW.items())
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """``commands`` of the arguments, the parser of each command, is set by who made them."""
    if arguments.shell not in SHELLS:
        raise UnknownNameError("shell", arguments.shell, SHELLS)
    print(script(arguments.shell, arguments.commands))
    return 0


def script(shell: str, commands: Parsers) -> str:
    """The text for a shell to read: everything in it is known now, so that completing runs no
    Python."""
    text = _fish(commands) if shell == "fish" else _bash(commands)
    return f"autoload -U +X bashcompinit && bashcompinit\n{text}" if shell == "zsh" else text


def _options(parser: argparse.ArgumentParser) -> list[str]:
    return [name for name in parser._option_string_actions if name.startswith("--")]


def _words(command: str, option: str) -> tuple[str, ...]:
    """What an option of a command may be followed by; nothing for numbers, files and flags."""
    return OTHERS.get(f"{command} {option}", WORDS.get(option, ()))


def _first(command: str, commands: Parsers) -> tuple[str, ...]:
    """What a command's first word may be, beside a file."""
    words = {"help": tuple(commands), "completion": SHELLS, "graph": tuple(DOING)}
    bodies = tuple(SHAPES) if command in SOFT else ()
    return words.get(command, (*CHARACTERS, *bodies) if command in ROBOTS else ())


def _bash(commands: Parsers) -> str:
    lines = []
    for name, parser in commands.items():
        options = shlex.quote(" ".join(_options(parser)))
        first = shlex.quote(" ".join(_first(name, commands)))
        for option in _options(parser):
            if _words(name, option):
                words = shlex.quote(" ".join(_words(name, option)))
                alone = "" if option in OR_FILES else " files="
                lines.append(f"      {name}:{option}) words={words}{alone} ;;")
        lines += [
            f"      {name}:*) words={first}",
            f"        [[ $current == -* ]] && words={options} files= ;;",
        ]
    top = shlex.quote(" ".join([*commands, "--help", "--version", "-V"]))
    return BASH.replace("TOP", top).replace("CASES", "\n".join(lines))


def _fish(commands: Parsers) -> str:
    alone = "complete -c octo -n __fish_use_subcommand"
    lines = [
        f"{alone} -f -a {name} -d {shlex.quote(parser.description or '')}"
        for name, parser in commands.items()
    ]
    lines += [f"{alone} -l version -s V", f"{alone} -l help -s h"]
    for command, parser in commands.items():
        here = f"complete -c octo -n '__fish_seen_subcommand_from {command}'"
        first = _first(command, commands)
        lines += [f"{here} -a {shlex.quote(' '.join(first))}"] if first else []
        for name in _options(parser):
            action = parser._option_string_actions[name]
            takes = "" if action.nargs == 0 else " -r"
            own = shlex.quote(" ".join(_words(command, name)))
            words = f" -a {own}" if _words(command, name) else ""
            text = " ".join((action.help or "").replace("%%", "%").split())
            option = f"-l {name.removeprefix('--')}{takes}{words}"
            lines.append(f"{here} {option} -d {shlex.quote(text)}")
    return "\n".join(lines)
