"""Values that nobody should give, and what a message may not hold."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from random import Random
from typing import Any

import numpy as np

# of octo solve
QUICK = (
    "--seconds",
    "0.1",
    "--dt",
    "0.05",
    "--passes",
    "1",
    "--max-iterations",
    "1",
    "--costs",
    "paper",
)
WORDS = (
    "",
    " ",
    "-",
    "--",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-308",
    "1e200",
    "1e22",
    "1e999",
    "-1",
    "0",
    "-0.0",
    "0.5",
    "1",
    "3",
    "1_000",
    "0x10",
    "1e",
    "1,2",
    "1;2",
    "½",
    "١٢",
    "true",
    "None",
    "%s%n",
    "{0}",
    "$HOME",
    "~",
    "..",
    "/",
    "/dev/null",
    "a" * 300,
    "a" * 70000,
    "a\nb",
    "a\tb",
    "\x1b[31m",
    "\u202e",
    "\ud800",
    "ü",
    "日本",
    "\U0001f600",
    "*",
    "?",
    "'",
    '"',
    "\\",
    "<",
    "&",
    "9" * 400,
    "1e22",
    str(10**30),
    str(2**31),
    str(2**63),
    str(2**64),
    "4294967296",
    "1000000000",
)
NUMBERS = (
    0,
    1,
    -1,
    2,
    3,
    7,
    0.5,
    -0.5,
    math.nan,
    math.inf,
    -math.inf,
    1e308,
    -1e308,
    1e-308,
    5e-324,
    1e200,
    1e22,
    1e9,
    -1e9,
    2**31,
    2**63,
    2**64,
    10**30,
    10**400,
    -(10**30),
    True,
    False,
    0.1 + 0.2,
    -0.0,
)


def _endless() -> Any:
    while True:
        yield 1.0


def _holding_itself() -> list[Any]:
    found: list[Any] = []
    found.append(found)
    return found


def _deep(depth: int) -> Any:
    found: Any = 1.0
    for _ in range(depth):
        found = [found]
    return found


OBJECTS: tuple[Callable[[], Any], ...] = (
    lambda: None,
    lambda: ...,
    object,
    lambda: NotImplemented,
    lambda: [],
    lambda: (),
    lambda: {},
    lambda: set(),
    lambda: b"walk",
    lambda: [1, 2, 3],
    lambda: [1.0, None],
    lambda: ["a", "b"],
    lambda: {"a": 1},
    lambda: {1: 2},
    lambda: {"a", "b"},
    lambda: [[1], [2, 3]],
    lambda: range(3),
    lambda: iter([1.0, 2.0]),
    lambda: (k for k in (1, 2)),
    _endless,
    _holding_itself,
    lambda: _deep(50),
    lambda: _deep(3000),
    lambda: lambda *a, **k: None,
    lambda: print,
    lambda: int,
    lambda: Exception("no"),
    lambda: np,
    lambda: 1 + 2j,
    lambda: Decimal("1.5"),
    lambda: Fraction(1, 3),
    lambda: slice(1, 2),
    lambda: memoryview(b"abc"),
    lambda: bytearray(b"abc"),
    lambda: np.array(["a", "b"]),
    lambda: np.array(1.0),
    lambda: np.array([]),
    lambda: np.zeros((2, 2)),
    lambda: np.full(3, np.nan),
    lambda: np.full(14, np.inf),
    lambda: np.zeros(14),
    lambda: np.full(14, 1e200),
    lambda: np.array([1, None], dtype=object),
    lambda: np.zeros(3, dtype=complex),
    lambda: np.array("2020-01-01", dtype="datetime64[D]"),
    lambda: np.zeros((0, 3)),
    lambda: np.zeros((1, 1, 1, 1)),
    lambda: np.float32(0.5),
    lambda: np.int8(3),
    lambda: np.bool_(True),
    lambda: np.ma.masked,
    lambda: np.zeros(3, dtype=[("a", float)]),
    lambda: np.str_("walk"),
)


def any_number(random: Random) -> Any:
    return random.choice(NUMBERS)


def any_word(random: Random) -> str:
    return random.choice(WORDS)


def anything(random: Random) -> Any:
    """A number, a word or an object that is neither."""
    which = random.random()
    if which < 0.35:
        return any_number(random)
    return any_word(random) if which < 0.5 else random.choice(OBJECTS)()


def shown(value: object) -> str:
    """Short, for a report."""
    try:
        text = repr(value)
    except Exception as error:
        text = f"{type(value).__name__}, whose repr raises {type(error).__name__}"
    return text if len(text) < 80 else f"{text[:60]}… ({len(text)} characters)"


WRITTEN_OUT = re.compile(
    r"(?:Character|Problem|Body|Solution|Joint)\((?:name|model|bodies)?=?| object at "
    r"0x|Traceback|bodies="
)
LONGEST = 1500  # characters of a message


def flaw_of_message(text: str) -> str | None:
    """What is wrong with an error's text; None: nothing."""
    found = WRITTEN_OUT.search(text)
    if found:
        return f"the message holds {found.group()!r}"
    if "\n" in text.strip():
        return "the message has several lines"
    if len(text) > LONGEST:
        return f"the message has {len(text)} characters"
    return None if text.strip() else "the message is empty"
