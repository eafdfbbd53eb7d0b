"""Files of a command: the folder is checked first, files are written beside, then renamed."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from octo.errors import MissingExtraError, OutputError

Writer = Callable[[Path], None]


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

    def write(self, writers: Mapping[str, Writer]) -> tuple[list[str], MissingExtraError | None]:
        """Write the files by name. A picture whose optional dependency is missing is left out.

        Returns
        -------
        the names left out, and why.
        """
        missing: list[str] = []
        reason: MissingExtraError | None = None
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=self.path, prefix=".octo-") as scratch:
                for name, writer in writers.items():
                    try:
                        writer(Path(scratch) / name)
                    except MissingExtraError as error:
                        missing.append(name)
                        reason = error
                for name in writers:
                    if name not in missing:
                        os.replace(Path(scratch) / name, self.path / name)
        except OSError as error:
            raise OutputError(f"out is {str(self.path)!r}, which cannot be written: {error.strerror or error}") from error
        return missing, reason
