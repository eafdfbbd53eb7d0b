"""Files of a command: the folder is checked first, numbers are written before pictures."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from octo.checks import ending
from octo.errors import MissingExtraError, OctoError, OutputError
from octo.files import file_name, place, reason, scratch
from octo.interrupts import postponed

Writer = Callable[[Path], object]
PICTURES = (".png", ".html", ".pdf", ".svg")  # that cost no numbers when they fail
# how the names of folders begin that receive what found no room where it should go
RESCUED = "octo-rescued-"


def default_folder(robot: str, what: str) -> str:
    """The folder of a command that was given none: "octo-ROBOT-GOAL", here and nowhere else
    whatever the robot is called."""
    return f"octo-{file_name(robot)}-{file_name(what)}"


class OutputFolder:
    """A folder that receives files: first all numbers or none, then the pictures that can be
    drawn."""

    def __init__(self, path: str | os.PathLike[str]):
        self.path = Path(path)

    def check(self, names: tuple[str, ...] = ()) -> None:
        """Refuse a folder that cannot be written, by trying; nothing is left behind.

        Raises
        ------
        OutputError: says why.
        """
        made: list[Path] = []
        try:
            made = [folder for folder in (self.path, *self.path.parents) if not folder.exists()]
            self.path.mkdir(parents=True, exist_ok=True)
            with scratch(self.path):
                pass
            blocked = [name for name in names if (self.path / name).is_dir()]
        except (OSError, ValueError) as error:
            raise OutputError(
                f"out is {str(self.path)!r}, which cannot be written: {reason(error)}"
            ) from error
        finally:
            for folder in made:
                with contextlib.suppress(OSError, ValueError):
                    folder.rmdir()
        if blocked:
            raise OutputError(
                f"out is {str(self.path)!r}, where {blocked[0]} is a folder and not a file"
            )

    def write(self, writers: Mapping[str, Writer]) -> dict[str, Exception]:
        """Write the files by name. A picture (its name says so) that cannot be drawn, for whatever
        reason, is left out.

        All numbers are in place before anything is drawn, and earlier pictures are gone: they would
        show other numbers.

        Returns
        -------
        the pictures left out, and why.

        Raises
        ------
        OutputError: the numbers cannot be written here; says where they are instead.
        KeyboardInterrupt: while pictures were drawn; says where the numbers are.
        """
        pictures = {k: writer for k, writer in writers.items() if Path(k).suffix in PICTURES}
        numbers = {k: writer for k, writer in writers.items() if k not in pictures}
        written = False
        try:
            with postponed():
                try:
                    self._write(self.path, numbers)
                except (OSError, OutputError) as error:
                    raise OutputError(self._rescued(numbers, error)) from error
                if numbers:
                    for name in pictures:
                        with contextlib.suppress(OSError):
                            (self.path / name).unlink(missing_ok=True)
                written = bool(numbers)
            return self._draw(pictures)
        except KeyboardInterrupt:
            if not written:
                raise
            said = f"all is in {self.path}"
            if pictures:
                said = f"{_listed(numbers)} in {self.path}, not all of {_listed(pictures)}"
            raise KeyboardInterrupt(said) from None

    @staticmethod
    def _write(folder: Path, writers: Mapping[str, Writer]) -> None:
        """All of the files, or none."""
        folder.mkdir(parents=True, exist_ok=True)
        with scratch(folder) as beside:
            for name, writer in writers.items():
                writer(beside / name)
            for name in writers:
                place(beside / name, folder / name)

    def _draw(self, writers: Mapping[str, Writer]) -> dict[str, Exception]:
        failed: dict[str, Exception] = {}
        for name, writer in writers.items():
            try:
                self._write(self.path, {name: writer})
            except Exception as error:  # a drawing library may raise anything
                failed[name] = error
        return failed

    def _rescued(self, writers: Mapping[str, Writer], error: Exception) -> str:
        """The files in another folder, and a sentence that says so."""
        found = f"out is {str(self.path)!r}, which cannot be written: {reason(error)}"
        for base in _elsewhere():
            with contextlib.suppress(OSError, OutputError):
                folder = Path(tempfile.mkdtemp(prefix=RESCUED, dir=base))
                try:
                    self._write(folder, writers)
                except BaseException:
                    folder.rmdir()
                    raise
                return f"{found}; {_listed(writers)} are in {folder} instead"
        return found


def folder_of(out: str | None, robot: str, what: str, names: tuple[str, ...]) -> OutputFolder:
    """``--out``, by default "octo-ROBOT-WHAT"; refused where the files cannot be written."""
    folder = OutputFolder(out or default_folder(Path(robot).stem, what))
    folder.check(names)
    return folder


def records_of(word: str | None) -> Path | None:
    """``--json``; refused where it, or the picture beside it, cannot be written."""
    path = None if word is None else ending("json", word, (".json",))
    if path is not None:
        OutputFolder(path.parent).check((path.name, f"{path.stem}.png"))
    return path


def _elsewhere() -> Iterable[str]:
    """Where a solution may go whose folder is full: the user's home, a temporary folder."""
    home = os.path.expanduser("~")
    if os.path.isabs(home):
        yield home
    with contextlib.suppress(OSError):
        yield tempfile.gettempdir()


def _listed(names: Iterable[str]) -> str:
    return " and ".join(names)


def say_left_out(failed: Mapping[str, Exception]) -> None:
    """One line on stderr for each picture left out, one for all whose optional dependency is
    missing."""
    missing = [name for name, error in failed.items() if isinstance(error, MissingExtraError)]
    if missing:
        print(f"octo: {' and '.join(missing)} left out: {failed[missing[-1]]}", file=sys.stderr)
    for name, error in failed.items():
        if name not in missing:
            kind = "" if isinstance(error, OctoError) else f"{type(error).__name__}: "
            print(f"octo: {name} left out: {' '.join(f'{kind}{error}'.split())}", file=sys.stderr)
