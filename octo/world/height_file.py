"""Maps of heights as they are on disk: a picture, or an array."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from octo.checks import Array
from octo.errors import MissingExtraError, RobotFileError

WHITE = {"1": 1.0, "L": 255.0, "I;16": 65535.0, "I": 65535.0, "F": 1.0}  # by the kind of a picture


def read_heights(path: Path) -> Array:
    """Heights (nx, ny) of a file: the numbers of an .npy file, of a picture 0 (black) to 1.

    A picture is seen from above with y upward: its columns are x, its last row is the least y.

    Raises
    ------
    RobotFileError: it cannot be read, or holds no table of numbers. MissingExtraError: Pillow,
        which reads pictures, is not installed.
    """
    if path.suffix.lower() == ".npy":
        return _array(path)
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError:
        raise MissingExtraError("reading a picture as heights", "view") from None
    try:
        with Image.open(path) as picture:
            plain = picture if picture.mode in WHITE else picture.convert("L")
            values = np.asarray(plain, dtype=float) / WHITE[plain.mode]
    except (OSError, UnidentifiedImageError, ValueError) as error:
        raise RobotFileError(f"{path.name}: cannot be read as a picture: {error}") from None
    return np.ascontiguousarray(values[::-1].T)


def _array(path: Path) -> Array:
    try:
        found = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise RobotFileError(f"{path.name}: cannot be read as an array: {error}") from None
    if not isinstance(found, np.ndarray) or found.ndim != 2 or found.dtype.kind not in "biuf":
        shape = getattr(found, "shape", "several arrays")
        raise RobotFileError(f"{path.name}: holds {shape}, must be numbers of shape (nx, ny)")
    return np.asarray(found, dtype=float)
