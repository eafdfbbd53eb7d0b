"""Files of a command: the folder is checked first, files are written beside, then renamed."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from octo.errors import MissingExtraError, OctoError, OutputError

Writer = Callable[[Path], object]
PICTURES = (".png", ".html", ".pdf", ".svg")  # that cost no numbers when they fail


class OutputFolder:
    """A folder that receives files, all of them or none."""

    def __init__(self, path: str | os.PathLike[str]):
        self.path = Path(path)

    def check(self, names: tuple[str, ...] = ()) -> None:
        """Refuse a folder that cannot be written, by trying; nothing is left behind.

        Raises
        ------
        OutputError: says why.
        """
        made = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path):
                pass
        except OSError as error:
            raise OutputError(f"out is {str(self.path)!r}, which cannot be written: {error.strerror or error}") from error
        finally:
            for folder in made:
                with contextlib.suppress(OSError):
                    folder.rmdir()
        for name in names:
            if (self.path / name).is_dir():
                raise OutputError(f"out is {str(self.path)!r}, where {name} is a folder and not a file")

    def write(self, writers: Mapping[str, Writer]) -> dict[str, Exception]:
        """Write the files by name. A picture (its name says so) that cannot be drawn, for whatever reason, is left out.

        An earlier picture of that name goes: beside new numbers it would show other ones.

        Returns
        -------
        the pictures left out, and why.

        Raises
        ------
        OutputError: another file cannot be written; none is.
        """
        failed: dict[str, Exception] = {}
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=self.path, prefix=".octo-") as scratch:
                for name, writer in writers.items():
                    try:
                        writer(Path(scratch) / name)
                    except Exception as error:  # a drawing library may raise anything
                        if Path(name).suffix not in PICTURES:
                            raise
                        failed[name] = error
                for name in writers:
                    if name not in failed:
                        os.replace(Path(scratch) / name, self.path / name)
                    elif len(failed) < len(writers):
                        (self.path / name).unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(f"out is {str(self.path)!r}, which cannot be written: {error.strerror or error}") from error
        return failed


def say_left_out(failed: Mapping[str, Exception]) -> None:
    """One line on stderr for each picture left out, one for all whose optional dependency is missing."""
    missing = [name for name, error in failed.items() if isinstance(error, MissingExtraError)]
    if missing:
        print(f"octo: {' and '.join(missing)} left out: {failed[missing[-1]]}", file=sys.stderr)
    for name, error in failed.items():
        if name not in missing:
            kind = "" if isinstance(error, OctoError) else f"{type(error).__name__}: "
            print(f"octo: {name} left out: {' '.join(f'{kind}{error}'.split())}", file=sys.stderr)
