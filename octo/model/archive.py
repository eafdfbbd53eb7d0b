"""Files of arrays and JSON (.npz) that octo wrote: all is checked, any damage is one line."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.errors import OctoError, RobotFileError, ShapeError, ValueRangeError

Shape = tuple[int | None, ...]  # None: any number
LONGEST = 200  # characters of what went wrong


@dataclass(frozen=True)
class Archive:
    """What a file holds: arrays by name, and the JSON object of its entry ``plain``."""

    arrays: dict[str, NDArray[Any]]
    plain: dict[str, Any]

    def array(self, name: str, shape: Shape, *, finite: bool = True) -> Array:
        """An array of numbers, as float64.

        Raises
        ------
        ValueRangeError: missing, not numbers, or not finite. ShapeError: another shape.
        """
        found = self._numbers(name, self.arrays.get(name), "fiu")
        wanted = tuple(m if n is None else n for n, m in zip(shape, found.shape, strict=False))
        if found.ndim != len(shape) or found.shape != wanted:
            words = ", ".join("any" if n is None else str(n) for n in shape)
            raise ShapeError(name, found.shape, f"({words})")
        if finite and not np.isfinite(found).all():
            where = tuple(int(k) for k in np.argwhere(~np.isfinite(found))[0])
            raise ValueRangeError(f"{name} is not finite at index {where}")
        return np.ascontiguousarray(found, dtype=float)

    def indices(self, name: str, size: int, below: int) -> NDArray[np.intp]:
        """(size,) whole numbers from 0 to ``below`` − 1."""
        found = self._numbers(name, self.arrays.get(name), "iu")
        if found.shape != (size,):
            raise ShapeError(name, found.shape, (size,))
        if found.size and not (found.min() >= 0 and found.max() < below):
            raise ValueRangeError(f"{name} has an index out of 0…{below - 1}")
        return found.astype(np.intp)

    @staticmethod
    def _numbers(name: str, found: NDArray[Any] | None, kinds: str) -> NDArray[Any]:
        if found is None:
            raise ValueRangeError(f"{name} is missing")
        if found.dtype.kind not in kinds:
            wanted = "whole numbers" if kinds == "iu" else "numbers"
            raise ValueRangeError(f"{name} holds {found.dtype.name} values, must be {wanted}")
        return found

    def group(self, prefix: str) -> dict[str, Array]:
        """The columns whose names begin with ``prefix``, without it: one length, NaN where nothing
        is known."""
        names = [name for name in self.arrays if name.startswith(prefix)]
        columns = {
            name.removeprefix(prefix): self.array(name, (None,), finite=False) for name in names
        }
        if len({len(column) for column in columns.values()}) > 1:
            raise ValueRangeError(f"the columns {prefix}… differ in length")
        return columns

    def word(self, name: str) -> str:
        return printable(self._plain(name, str, "a word"))

    def number(self, name: str, *, positive: bool = False, finite: bool = True) -> float:
        found = self._plain(name, (int, float), "a number")
        legal = (math.isfinite(found) or not finite) and (found > 0.0 or not positive)
        if isinstance(found, bool) or not legal:
            wanted = "a positive finite number" if positive else "a finite number"
            raise ValueRangeError(f"{name} is {found!r}, must be {wanted}")
        return float(found)

    def whole(self, name: str) -> int:
        found = self._plain(name, int, "a whole number")
        if isinstance(found, bool) or found < 0:
            raise ValueRangeError(
                f"{name} is {found!r}, must be a whole number that is not negative"
            )
        return int(found)

    def flag(self, name: str) -> bool:
        return bool(self._plain(name, bool, "true or false"))

    def words(self, name: str) -> tuple[str, ...]:
        found = self._plain(name, list, "a list")
        if not all(isinstance(word, str) for word in found):
            raise ValueRangeError(f"{name} must hold words only")
        return tuple(printable(word) for word in found)

    def numbers(self, name: str, *, finite: bool = True) -> dict[str, float]:
        """Numbers by name."""
        found = self._plain(name, dict, "numbers by name")
        for key, value in found.items():
            legal = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not legal or (finite and not math.isfinite(value)):
                what = f"{name} has {str(value)[:40]!r} for {key!r}"
                raise ValueRangeError(f"{what}, must be a finite number")
        return {key: float(value) for key, value in found.items()}

    def records(self, name: str) -> tuple[dict[str, Any], ...]:
        """A list of JSON objects."""
        found = self._plain(name, list, "a list")
        if not all(isinstance(record, dict) for record in found):
            raise ValueRangeError(f"{name} must hold records only")
        return tuple(found)

    def _plain(self, name: str, kind: Any, wanted: str) -> Any:
        if name not in self.plain:
            raise ValueRangeError(f"{name} is missing")
        found = self.plain[name]
        if not isinstance(found, kind):
            raise ValueRangeError(f"{name} is of type {type(found).__name__}, must be {wanted}")
        return found


@contextlib.contextmanager
def opened(path: str | os.PathLike[str], kind: str, plain: str = "plain") -> Iterator[Archive]:
    """The archive, for what is made of it: whatever goes wrong meanwhile is one line that names the
    file.

    ``kind`` is what the file should be, in a word. ``plain`` is the entry that holds the JSON.

    Raises
    ------
    RobotFileError: it is missing, or not what octo wrote.
    """
    try:
        with open(Path(path), "rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        found = json.loads(str(arrays.pop(plain)))
        if not isinstance(found, dict):
            raise ValueRangeError(f"{plain} is no JSON object")
        yield Archive(arrays, found)
    except FileNotFoundError as error:
        raise RobotFileError(f"{kind} file {path} does not exist") from error
    # a damaged file may raise anything, from zlib's errors to those of a robot's own checks
    except Exception as error:
        raise RobotFileError(
            f"{path} is not a {kind} that octo saved (.npz): {_sentence(error)}"
        ) from error


def printable(word: str) -> str:
    """With spaces for what a terminal or a table would take for a command."""
    return "".join(c if c.isprintable() else " " for c in word)


def _sentence(error: Exception) -> str:
    if isinstance(error, KeyError):
        text = f"{error.args[0] if error.args else 'an entry'} is missing"
    else:
        own = isinstance(error, OctoError) and str(error)
        text = str(error) if own else f"{type(error).__name__}: {error}"
    text = " ".join(printable(text).split())
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"
