"""A robot file as MuJoCo compiled it; the one place that imports MuJoCo to read one."""

from __future__ import annotations

import importlib
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from octo.errors import MissingExtraError, ModelError, RobotFileError
from octo.model.look import Look
from octo.model.quantities import Array
from octo.model.quaternions import rotation_of


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass properties of one link."""

    mass: float  # kg
    com: Array  # (3,) m, link frame
    inertia: Array  # (3, 3) kg m² about the com, link axes


@dataclass(frozen=True)
class Limit:
    """What <limit> says of one joint; infinite where there is no limit."""

    lower: float  # rad or m
    upper: float  # rad or m
    effort: float = math.inf  # N m or N
    velocity: float = math.inf  # rad/s or m/s


@dataclass(frozen=True)
class RobotFile:
    """A compiled robot file and what the compiled model does not say.

    Attributes
    ----------
    model: mujoco.MjModel.
    free_body: MuJoCo's index of the body that floats, None for a fixed base.
    inertials: by body, where the file itself (a URDF) says them: MuJoCo cannot compile all of them.
    limits: by joint, where the file itself (a URDF) says them: then every joint is actuated.
        MuJoCo knows no half a range.
    left_out: MuJoCo's indices of bodies that are no part of the robot.
    looks: by body, what is drawn on it.
    """

    model: Any
    name: str
    file: str
    free_body: int | None = None
    inertials: Mapping[str, Inertial] | None = None
    limits: Mapping[str, Limit] | None = None
    left_out: frozenset[int] = frozenset()
    looks: Mapping[int, Sequence[Look]] = field(default_factory=dict)

    def inertial(self, b: int) -> Inertial:
        """Mass properties of MuJoCo's body ``b``."""
        if self.inertials is not None:
            return self.inertials[self.model.body(b).name]
        axes = rotation_of(self.model.body_iquat[b])
        inertia = axes @ np.diag(self.model.body_inertia[b]) @ axes.T
        return Inertial(float(self.model.body_mass[b]), self.model.body_ipos[b].copy(), inertia)


@dataclass(frozen=True, eq=False)
class Carrier:
    """Where a MuJoCo body is in the body of the character that carries it."""

    body: int  # index of the character's body
    rotation: Array  # (3, 3), to the carrying body's frame
    position: Array  # (3,) m


def import_mujoco(what: str = "reading robot files") -> Any:
    """MuJoCo, or a sentence that says that ``what`` needs it."""
    try:
        return importlib.import_module("mujoco")
    except ImportError:
        raise MissingExtraError(what, "robots") from None


@contextmanager
def quiet_compiler() -> Iterator[None]:
    """MuJoCo's compiler without its warnings, which it also writes to a file in the working
    directory."""
    mujoco = import_mujoco()
    handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        mujoco.set_mju_user_warning(handler)


@contextmanager
def named(file: str) -> Iterator[None]:
    """What is wrong with the robot is said of its file."""
    try:
        yield
    except RobotFileError:
        raise
    except ModelError as error:
        raise ModelError(f"{file}: {error}") from None


def one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def uncompiled(path: Path, error: Exception) -> RobotFileError:
    return RobotFileError(f"{path.name}: MuJoCo does not compile it: {one_line(error)}")


def name_of(model: Any, kind: str, index: int) -> str:
    """The file's name of an element, or its kind and number, with underscores before it where
    another has that name."""
    mujoco = import_mujoco()
    element = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
    name = mujoco.mj_id2name(model, element, index) or f"{kind}{index}"
    while mujoco.mj_name2id(model, element, name) not in (-1, index):
        name = f"_{name}"
    return str(name)
