"""Command lines: every option of every command, with values that nobody should give."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from random import Random

from octo.cli.main import parser
from tests.fuzz.judge import command
from tests.fuzz.values import QUICK, any_number, any_word

SMALL = (*QUICK, "--out", "out")
USUAL = {  # a call that is quickly done
    "solve": ("solve", "chain", *SMALL),
    "cycle": (
        "cycle",
        "chain",
        "--passes",
        "1",
        "--max-iterations",
        "1",
        "--seeds",
        "1",
        "--steps",
        "8",
        "--out",
        "out",
    ),
    "mpc": ("mpc", "mammal", "--horizon", "5", "--seconds", "0.05", "--out", "out"),
    "compare": (
        "compare",
        "chain",
        "--seconds",
        "0.1",
        "--dt",
        "0.05",
        "--max-iterations",
        "1",
        "--with",
        "ipopt",
        "--json",
        "a.json",
    ),
    "bench": ("bench", "--quick", "--only", "nothing"),
    "info": ("info", "chain"),
    "robots": ("robots",),
    "simulate": ("simulate", "chain", "--seconds", "0.1", "--dt", "0.05", "--out", "out"),
    "replay": ("replay", "nothing.npz", "--out", "out"),
    "explain": ("explain", "nothing.npz"),
    "export": ("export", "nothing.npz", "--out", "a.glb"),
    "view": ("view", "nothing.npz", "--out", "a.html"),
    "completion": ("completion", "bash"),
    "help": ("help",),
}
KNOWN = (
    "chain",
    "biped",
    "mammal",
    "nothing.urdf",
    ".",
    "walk",
    "jump",
    "turn",
    "stand",
    "hermite",
    "nodes",
    "coulomb:0.5",
    "viscous:1e308",
    "slope:10",
    "slope:1e-308",
    "slope:89.99999",
    "a.py:f",
    "balanced",
    "cpu",
    "cuda",
    "auto",
    "fixed",
    "floating",
    "natural",
    "paper",
    "robot",
    "ipopt",
    "fatrop,ipopt",
    "0.3,0.9",
    "10,0.1,90",
    "a.json",
    "a.npy",
    "a.txt",
    "a.npz",
    "x.html",
    "x.png",
    "x.csv",
    "octo",
)


@functools.cache
def options(name: str) -> tuple[str, ...]:
    return tuple(
        option for option in parser()[1][name]._option_string_actions if option.startswith("--")
    )


def words_of(random: Random) -> list[str]:
    name = random.choice([*USUAL, "solve", "cycle", "simulate", "compare", "mpc"])
    words = list(USUAL[name])
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        what = random.random()
        if what < 0.65:
            option = random.choice(options(name))
            value = _value(random)
            words += [f"{option}={value}"] if random.random() < 0.5 else [option, value]
        elif what < 0.8:
            words[random.randrange(len(words))] = _value(random)
        elif what < 0.9:
            words.insert(random.randrange(len(words) + 1), _value(random))
        elif len(words) > 1:
            del words[random.randrange(len(words))]
    return words


def _value(random: Random) -> str:
    which = random.random()
    if which < 0.6:
        return any_word(random).replace("\0", "")
    return str(random.choice(KNOWN)) if which < 0.8 else _written(any_number(random))


def _written(value: object) -> str:
    try:
        return str(value)
    except ValueError:  # more digits than Python writes
        return "9" * 5000


def fits(words: Sequence[str]) -> bool:
    """Whether a system would hand these words to a program."""
    try:
        return all(b"\0" not in word.encode("utf-8", "surrogateescape") for word in words)
    except UnicodeEncodeError:
        return False


def case(random: Random, folder: Path) -> None:
    words = words_of(random)
    if not fits(words):
        words = [word.encode("utf-8", "replace").decode() for word in words]
    for name in ("a.json", "a.txt", "a.npy", "a.py"):
        if random.random() < 0.3:
            text = random.choice(
                (
                    "",
                    "[]",
                    "[1, 2]",
                    "nan",
                    "{}",
                    "def f(point, p): return point[2]",
                    "raise SystemExit(3)",
                    "\0",
                    "x" * 1000,
                )
            )
            (folder / name).write_text(text, encoding="utf-8")
    command(words, folder)
