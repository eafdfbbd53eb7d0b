"""Soft bodies in a shell: ball, beam or a mesh file, with sizes and material behind a colon."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from octo.cli.world import values_of
from octo.errors import RobotFileError
from octo.files import is_file
from octo.soft.body import DAMPING, Body
from octo.soft.gallery import ball, beam
from octo.soft.read import ENDINGS

SHAPES: dict[str, Callable[..., Body]] = {"ball": ball, "beam": beam}
RATES: dict[str, type] = {"alpha": float, "beta": float}  # of the damping
OF_FILES: dict[str, type] = RATES | {"modes": int, "elasticity": str}
OF_FILES |= dict.fromkeys(("young", "poisson", "density", "scale", "edge"), float)


def is_soft(word: str) -> bool:
    """Whether a word names a soft body: ball, beam, or a mesh file, with or without sizes."""
    return _shape(word) is not None or _file(word)[0].suffix.lower() in ENDINGS


def folder_word(word: str) -> str:
    """A soft body as the name of a folder begins: with all its sizes, though they have dots."""
    return word.replace(".", "_")


def body_of(word: str) -> Body:
    """The soft body of ``ball``, ``beam:young=2e4,modes=6`` or ``FILE.msh:scale=0.001``.

    Raises
    ------
    OctoError: no such size or file, or a mesh that is no body.
    """
    name = _shape(word)
    if name is not None:
        fields = inspect.signature(SHAPES[name]).parameters.values()
        known = {
            p.name: type(p.default) for p in fields if isinstance(p.default, int | float | str)
        }
        given = values_of(f"soft body {name!r}", word.partition(":")[2], known | RATES)
        return SHAPES[name](**_damped(given))
    path, sizes = _file(word)
    if not is_file(path):
        raise RobotFileError(f"mesh file {path} does not exist")
    return Body.from_mesh(path, **_damped(values_of(f"soft body {path.name!r}", sizes, OF_FILES)))


def _shape(word: str) -> str | None:
    name, colon, _ = word.partition(":")
    return name if name in SHAPES and (colon or not is_file(Path(word))) else None


def _file(word: str) -> tuple[Path, str]:
    """The path of a file and the sizes behind it."""
    path, colon, sizes = word.rpartition(":")
    return (Path(path), sizes) if colon and not is_file(Path(word)) else (Path(word), "")


def _damped(values: dict[str, Any]) -> dict[str, Any]:
    """``alpha`` and ``beta`` as one ``damping``."""
    alpha, beta = values.pop("alpha", DAMPING[0]), values.pop("beta", DAMPING[1])
    return {**values, "damping": (alpha, beta)}
