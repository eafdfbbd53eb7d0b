"""MJCF files: compiled by MuJoCo; which tree is the robot, which base it has, what octo leaves out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np

from octo.errors import RobotFileError, UnsupportedFeatureError
from octo.model.actuators import drives_joint
from octo.model.character import Character
from octo.model.compiled import character_of
from octo.model.features import left_out_features
from octo.model.robot_file import RobotFile, import_mujoco, name_of, one_line, quiet_compiler

UNNAMED = "MuJoCo Model"  # what MuJoCo calls a file without a name


def load_mjcf(path: Path, base: Literal["auto", "floating", "fixed"] = "auto") -> Character:
    """The character of an MJCF; ``base`` "auto" is the one written in the file."""
    notes: list[str] = []
    spec, model = _compiled(path, notes)
    if model.nbody == 1:
        raise RobotFileError(f"{path.name}: has no <body>, must have one at least")
    free, others = _robot_tree(model, notes)
    if base == "fixed":
        free = None
    elif base == "floating" and free is None:
        free = _body_to_free(path.name, model, others)
    name = path.stem if spec.modelname in ("", UNNAMED) else spec.modelname
    source = RobotFile(model, name, path.name, free, left_out=others)
    notes += left_out_features(model, others)
    return character_of(source, notes)


def _compiled(path: Path, notes: list[str]) -> tuple[Any, Any]:
    """MjSpec and MjModel of an MJCF; geoms whose mesh file is missing are dropped where they give no mass."""
    mujoco = import_mujoco()
    try:
        with quiet_compiler():
            spec = mujoco.MjSpec.from_file(str(path))
            _drop_missing_meshes(path, spec, notes)
            return spec, spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise RobotFileError(f"{path.name}: MuJoCo does not compile it: {one_line(error)}") from None


def _drop_missing_meshes(path: Path, spec: Any, notes: list[str]) -> None:
    folder = Path(spec.modelfiledir) / spec.meshdir
    missing = {
        mesh.name or Path(mesh.file).stem: mesh for mesh in spec.meshes if mesh.file and not (folder / mesh.file).is_file()
    }
    for geom in [geom for geom in spec.geoms if geom.meshname in missing]:
        if not (geom.parent.explicitinertial or geom.mass == 0.0 or geom.density == 0.0):
            mesh = Path(missing[geom.meshname].file).name
            what = f"mesh file {mesh} is missing and body {geom.parent.name!r} takes its mass from it"
            raise RobotFileError(f"{path.name}: {what}; give the body an <inertial>")
        spec.delete(geom)
    for mesh in missing.values():
        notes.append(f"mesh {Path(mesh.file).name}: the file is missing")
        spec.delete(mesh)


def _robot_tree(model: Any, notes: list[str]) -> tuple[int | None, frozenset[int]]:
    """The body that floats (None: none does) and the bodies of further floating trees, which are left out.

    Of several trees the robot is the one with most actuators, then most degrees of freedom.
    """
    mujoco = import_mujoco()
    trees: dict[int, list[int]] = {}
    for b in range(1, model.nbody):
        trees.setdefault(int(model.body_rootid[b]), []).append(b)
    driven = np.zeros(model.nbody, dtype=int)
    for a in range(model.nactuator):
        if drives_joint(model, a):
            driven[model.jnt_bodyid[model.actuator_trnid[a, 0]]] += 1
    robot = max(trees, key=lambda root: (driven[trees[root]].sum(), model.body_dofnum[trees[root]].sum(), -root))

    def floats(root: int) -> bool:
        return bool(model.body_jntnum[root]) and model.jnt_type[model.body_jntadr[root]] == mujoco.mjtJoint.mjJNT_FREE

    others: set[int] = set()
    for root, members in trees.items():
        if floats(root) and root != robot:
            others.update(members)
            mass = float(model.body_subtreemass[root])
            notes.append(f"free body {name_of(model, 'body', root)} ({mass:.3g} kg): octo models one floating tree")
    return robot if floats(robot) else None, frozenset(others)


def _body_to_free(file: str, model: Any, others: frozenset[int]) -> int:
    """The one body of the world that carries the robot and has no joints of its own."""
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and b not in others]
    moving = [b for b in roots if any(model.body_jntnum[c] for c in range(b, model.nbody) if model.body_rootid[c] == b)]
    candidates = moving or [b for b in roots if model.body_subtreemass[b] > 0.0]
    names = ", ".join(name_of(model, "body", b) for b in candidates)
    if len(candidates) != 1:
        raise UnsupportedFeatureError(
            f"{file}: base is 'floating', must be 'auto' or 'fixed': {len(candidates)} bodies of the world could float ({names})"
        )
    if model.body_jntnum[candidates[0]]:
        raise UnsupportedFeatureError(
            f"{file}: base is 'floating', must be 'auto' or 'fixed': body {names} has joints to the world of its own"
        )
    return candidates[0]
