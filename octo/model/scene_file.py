"""``octo.load_scene``: an MJCF's robot, and what stands around it and is driven by nothing."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from octo.errors import RobotFileError, UsageError, said
from octo.model import looks, mjcf
from octo.model.character import Character
from octo.model.compiled import character_of
from octo.model.contacts import Contacts
from octo.model.element import DryFriction
from octo.model.load import Base, dialect, load
from octo.model.quaternions import rotation_of
from octo.model.robot_file import RobotFile, import_mujoco, name_of
from octo.model.scene import Scene


def load_scene(
    path: str | os.PathLike[str],
    base: Base = "auto",
    contacts: Contacts = "few",
    *,
    touching: Sequence[tuple[str, str]] | None = None,
) -> Scene:
    """The robot of an MJCF, and its other moving bodies as objects: free ones, and those that hang
    on the world by joints, as a door beside a robot that floats.

    What stands still is not part of it: ``octo.load_world(path)`` is the ground.

    Parameters
    ----------
    path: of the file. base, contacts: of the robot, as :func:`octo.load` takes them.
    touching: which bodies touch each other, as the contacts of an :class:`octo.Scene`.

    Raises
    ------
    UsageError: the file is no MJCF. RobotFileError: nothing beside the robot moves in it; what
        :func:`octo.load` refuses. ModelError: what an octo.Scene refuses.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise UsageError(f"path is {said(path)}, must be that of an MJCF file")
    robot, file = load(path, base, contacts), Path(path)
    if not file.is_file() or dialect(file) != "mujoco":
        raise UsageError(f"{os.fspath(path)} is no MJCF, and has no objects: octo.load reads it")
    objects = _objects(file)
    if not objects:
        raise RobotFileError(f"{file.name}: nothing beside the robot moves in it: use octo.load")
    kept = [note for note in robot.dropped if "octo.load_scene makes it an object" not in note]
    return Scene(replace(robot, dropped=tuple(kept)), objects, touching)


def _objects(file: Path) -> list[Character]:
    """What moves in a file beside its robot, a Character each tree."""
    notes: list[str] = []
    _, model = mjcf.compiled(file, notes)
    others = mjcf.beside_robot(file, model)
    drawn = looks.of_mjcf(model)
    return [_object(file, model, root, drawn) for root in others]


def _object(file: Path, model: Any, root: int, drawn: dict[int, list[looks.Look]]) -> Character:
    away = frozenset(b for b in range(1, model.nbody) if model.body_rootid[b] != root)
    free = root if mjcf.floats(model, root) else None
    name = name_of(model, "body", root)
    source = RobotFile(model, name, file.name, free, left_out=away, looks=drawn)
    found = character_of(source, (), "few", solid=True)
    notes = [note for note in found.dropped if "geoms of the world" not in note]  # the robot's
    rubbing, elements = _dry(model, root)
    if rubbing:
        notes.append(f"dry friction (frictionloss) of joints: {', '.join(rubbing)}")
    return replace(found, name=name, dropped=tuple(notes), elements=elements)


def _dry(model: Any, root: int) -> tuple[list[str], tuple[DryFriction, ...]]:
    """Joints of a tree whose dry friction is left out, and that of a hinge or a slide between its
    first body and the world, as an element."""
    mujoco = import_mujoco()
    tree = np.flatnonzero(model.body_rootid == root)
    rubbing = [
        j
        for j in range(model.njnt)
        if model.jnt_bodyid[j] in tree and model.dof_frictionloss[model.jnt_dofadr[j]] > 0.0
    ]
    lost, found = [], []
    for j in rubbing:
        alone = model.jnt_bodyid[j] == root and model.body_jntnum[root] == 1
        kind, axis = model.jnt_type[j], np.array(model.jnt_axis[j])
        limit = float(model.dof_frictionloss[model.jnt_dofadr[j]])
        slides = kind == mujoco.mjtJoint.mjJNT_SLIDE
        if not alone or not (slides or kind == mujoco.mjtJoint.mjJNT_HINGE):
            lost.append(name_of(model, "joint", j))
            continue
        # 1 m beside a hinge, so that N are N m
        across = np.linalg.svd(axis[None])[2][1]
        point = np.array(model.jnt_pos[j]) + (0.0 if slides else across)
        place = model.body_pos[root] + rotation_of(model.body_quat[root]) @ point
        found.append(
            DryFriction(None, tuple(place), name_of(model, "body", root), tuple(point), limit)
        )
    return lost, tuple(found)
