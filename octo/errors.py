"""One exception class per mistake, all under :class:`OctoError`.

A message is one line: it names the field, the value found and what is allowed. The command line
prints it and exits with code 2; nothing of octo raises a bare ``ValueError`` for bad input.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

SHORT = 60  # characters of a value that a message quotes
PLAIN = (type(None), bool, int, float, complex, str, bytes)
LONGEST_WORD = 300  # characters of a message without a space between them; longer ones are cut
LONGEST = 1200  # characters of a message, of which the end says what is allowed


def said(value: object) -> str:
    """A value in a message, in one short line: plain ones as they are written, of others the
    kind."""
    shown: Any = value[:SHORT] if isinstance(value, (list, tuple)) else value
    held = shown if isinstance(shown, (list, tuple)) else [object()]
    if isinstance(shown, dict):
        held = [*shown, *shown.values()]
    kind_of_array = getattr(getattr(value, "dtype", None), "kind", "O")
    listed = all(isinstance(entry, PLAIN) for entry in held)
    scalar = kind_of_array != "O" and getattr(value, "shape", None) == ()
    if isinstance(value, int) and abs(value) >= 10**SHORT:
        text = f"a number of {value.bit_length()} bits"
    elif listed or scalar or isinstance(value, PLAIN):
        try:
            text = repr(shown)
        except ValueError:  # Python does not write numbers of more than 4300 digits
            text = f"a {type(value).__name__} with a number of more digits than can be written"
    elif isinstance(shape := getattr(value, "shape", None), tuple) and hasattr(value, "dtype"):
        text = f"an array of shape {shape}"
    else:
        kind = type(value).__name__
        text = f"{'an' if kind[0].lower() in 'aeiou' else 'a'} {kind}"
    return text if len(text) <= SHORT else f"{text[: SHORT - 1]}…"


def one_line(text: str) -> str:
    """A message without line breaks and what a terminal takes for commands; words and lists that
    are too long are cut."""
    words = [word if len(word) <= LONGEST_WORD else f"{word[:SHORT]}…" for word in text.split()]
    line = "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii")
        for c in " ".join(words)
    )
    return line if len(line) <= LONGEST else f"{line[: 3 * LONGEST // 4]} … {line[-LONGEST // 5 :]}"


class OctoError(Exception):
    """Anything octo refuses to do, in one line. Catch this to catch every refusal."""

    def __init__(self, message: str = ""):
        super().__init__(one_line(str(message)))


class UsageError(OctoError):
    """A command line or a call that octo does not understand."""


class ModelError(OctoError):
    """The robot itself is not legal: masses, tree, joints, contacts."""


class RobotFileError(ModelError):
    """A robot file is missing, malformed or uses something that cannot be left out."""


class UnsupportedFeatureError(RobotFileError):
    """A robot file uses a feature octo does not model and cannot drop."""


class UnknownNameError(OctoError):
    """A name (robot, body, joint, goal, option) that does not exist; lists the nearest valid ones,
    or says ``hint``."""

    def __init__(self, kind: str, name: object, valid: Iterable[str], hint: str = ""):
        names = sorted(str(v) for v in valid)
        word = name if isinstance(name, str) else said(name)
        begun = [valid_name for valid_name in names if word and valid_name.startswith(word)]
        near = begun or difflib.get_close_matches(word[:SHORT], names, n=3, cutoff=0.4)
        nearest = f"valid: {', '.join(names) or 'none'}"
        if near:
            nearest = f"did you mean {' or '.join(near)}?"
        super().__init__(f"{kind} {said(name)} is not known; {hint or nearest}")


class ShapeError(OctoError):
    """An array has the wrong shape."""

    def __init__(self, field: str, found: tuple[int, ...], expected: object):
        super().__init__(f"{field} has shape {tuple(found)}, expected {expected}")


class ValueRangeError(OctoError):
    """A value is NaN, infinite or outside what is allowed."""


class ProblemError(OctoError):
    """A problem description contradicts itself."""


class MirrorError(OctoError):
    """A robot has no left-right mirror."""


class StaticPoseError(OctoError):
    """No static pose was found to start from."""


class OutputError(OctoError):
    """A file or folder cannot be written."""


class DeviceError(OctoError):
    """The device asked for cannot be used."""


class MissingExtraError(OctoError):
    """An optional dependency is needed for what was asked."""

    def __init__(self, what: str, extra: str):
        super().__init__(f"{what} needs the extra '{extra}': pip install 'octo-trajopt[{extra}]'")
