"""MJCF files: which trees are the robot, which base it has, what octo leaves out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from octo.errors import RobotFileError, UnsupportedFeatureError
from octo.model import looks, xml_file
from octo.model.actuators import drives_joint
from octo.model.character import Character
from octo.model.compiled import character_of
from octo.model.contacts import Contacts
from octo.model.features import left_out_features
from octo.model.robot_file import RobotFile, import_mujoco, name_of, quiet_compiler, uncompiled

UNNAMED = "MuJoCo Model"  # what MuJoCo calls a file without a name


def load_mjcf(
    path: Path, base: Literal["auto", "floating", "fixed"] = "auto", contacts: Contacts = "few"
) -> Character:
    """The character of an MJCF; ``base`` "auto" is the one written in the file."""
    notes: list[str] = []
    xml_file.check(path)
    spec, model = compiled(path, notes)
    if model.nbody == 1:
        raise RobotFileError(f"{path.name}: has no <body>, must have one at least")
    free, others = _robot_tree(path, model, notes)
    if base == "fixed":
        free = None
    elif base == "floating" and free is None:
        free = _body_to_free(path.name, model, others)
    name = path.stem if spec.modelname in ("", UNNAMED) else spec.modelname
    source = RobotFile(model, name, path.name, free, left_out=others, looks=looks.of_mjcf(model))
    notes += left_out_features(model, others)
    return character_of(source, notes, contacts)


def compiled(path: Path, notes: list[str]) -> tuple[Any, Any]:
    """MjSpec and MjModel; geoms whose mesh file is missing are dropped where they have no mass."""
    mujoco = import_mujoco()
    try:
        with quiet_compiler():
            spec = mujoco.MjSpec.from_file(str(path))
            _drop_missing_meshes(path, spec, notes)
            return spec, spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise uncompiled(path, error) from None


def _drop_missing_meshes(path: Path, spec: Any, notes: list[str]) -> None:
    folder = Path(spec.modelfiledir) / spec.meshdir
    lost = [mesh for mesh in spec.meshes if mesh.file and not (folder / mesh.file).is_file()]
    missing = {mesh.name or Path(mesh.file).stem: mesh for mesh in lost}
    bare: dict[str, list[str]] = {}
    for geom in [geom for geom in spec.geoms if geom.meshname in missing]:
        if not (geom.parent.explicitinertial or geom.mass == 0.0 or geom.density == 0.0):
            what = f"mesh file {Path(missing[geom.meshname].file).name} is missing"
            takes = f"body {geom.parent.name!r} takes its mass from it"
            raise RobotFileError(f"{path.name}: {what} and {takes}; give the body an <inertial>")
        if geom.contype or geom.conaffinity:
            bare.setdefault(geom.meshname, []).append(geom.parent.name or "without a name")
        spec.delete(geom)
    for name, mesh in missing.items():
        of = f"collision mesh of bodies {', '.join(bare[name])}, " if name in bare else ""
        notes.append(f"{of}mesh {Path(mesh.file).name}: the file is missing")
        spec.delete(mesh)


def _robot_tree(path: Path, model: Any, notes: list[str]) -> tuple[int | None, frozenset[int]]:
    """The body that floats (None: none does) and the bodies that are not the robot, which are left
    out.

    Of several trees the robot is the one with most actuators, then most degrees of freedom. What
    has no joints is fixed to the world and is world: tables, targets, mocap bodies. Beside a robot
    that floats so is what hangs on the world by joints of its own, as a door; beside one that
    stands on the world itself such trees are kept, but count as the robot's mass only where they
    are driven. Nodes of deformable bodies and further floating trees are always left out.
    """
    trees: dict[int, list[int]] = {}
    for b in range(1, model.nbody):
        trees.setdefault(int(model.body_rootid[b]), []).append(b)
    soft = _without_soft_bodies(path, model, trees, notes)
    driven = _driven(model)
    dofs = model.body_dofnum
    robot = max(trees, key=lambda root: (driven[trees[root]].sum(), dofs[trees[root]].sum(), -root))

    others, standing, robot_bodies = set(soft), [], trees[robot]
    moves = {root: bool(model.body_dofnum[members].any()) for root, members in trees.items()}
    for root, members in trees.items():
        still = not moves[root]
        mass = float(model.body_subtreemass[root])
        which = f"{name_of(model, 'body', root)} ({mass:.3g} kg)"
        if root == robot or not moves[robot]:
            continue
        if floats(model, root):
            notes.append(f"free body {which}: octo.load_scene makes it an object")
        elif still and mass > 0.0:
            notes.append(f"body {which} is fixed to the world: it is world, not robot")
        elif not still and floats(model, robot):
            notes.append(
                f"body {which} hangs on the world by joints of its own: octo.load_scene makes it "
                "an object"
            )
        elif not still and driven[robot_bodies].any() and not driven[members].any():
            notes.append(
                f"body {which} hangs on the world and nothing drives it: it moves, but its mass is "
                "not the robot's"
            )
        elif not still:
            standing.append(which)
        if still or floats(model, root) or floats(model, robot):
            others.update(members)
    if standing:
        notes.append(
            "several trees stand on the world and all are the robot's, also those of bodies "
            f"{', '.join(standing)}"
        )
    return robot if floats(model, robot) else None, frozenset(others)


def floats(model: Any, root: int) -> bool:
    """Whether the first body of a tree has a free joint."""
    free = import_mujoco().mjtJoint.mjJNT_FREE
    return bool(model.body_jntnum[root]) and model.jnt_type[model.body_jntadr[root]] == free


def beside_robot(path: Path, model: Any) -> list[int]:
    """First bodies of the trees that move and are left out of the robot, soft ones excepted."""
    others = _robot_tree(path, model, [])[1]
    roots = sorted({int(model.body_rootid[b]) for b in others})
    found = []
    for root in roots:
        members = [b for b in range(1, model.nbody) if model.body_rootid[b] == root]
        nodes = all(_is_node(model, b) for b in members if model.body_dofnum[b])
        if model.body_dofnum[members].any() and not nodes:
            found.append(root)
    return found


def _driven(model: Any) -> NDArray[np.intp]:
    """(bodies,) how many actuators drive a joint of each."""
    driven = np.zeros(model.nbody, dtype=np.intp)
    for a in range(model.nactuator):
        if drives_joint(model, a):
            driven[model.jnt_bodyid[model.actuator_trnid[a, 0]]] += 1
    return driven


def _without_soft_bodies(
    path: Path, model: Any, trees: dict[int, list[int]], notes: list[str]
) -> set[int]:
    """Take the nodes of deformable bodies (flex) out of ``trees``; a flex in one body is a rigid
    shape.

    Raises
    ------
    UnsupportedFeatureError: a deformable body is all that moves, or is tied to something else that
        does.
    """
    soft: set[int] = set()
    for f in range(model.nflex):
        if model.flex_rigid[f]:
            continue
        name, bodies = name_of(model, "flex", f), _flex_bodies(model, f)
        nodes = {b for b in bodies if _is_node(model, b)}
        for root in {int(model.body_rootid[b]) for b in bodies}:
            rest = [b for b in trees.get(root, []) if b not in nodes]
            moving = [b for b in rest if model.body_dofnum[b]]
            if moving:
                what = f"deformable body (flex) {name!r} moves with body"
                body = name_of(model, "body", moving[0])
                raise UnsupportedFeatureError(
                    f"{path.name}: {what} {body!r}; octo models rigid bodies, take it out"
                )
            trees[root] = rest
        what = f"deformable body (flex) {name} of {len(nodes)} nodes"
        notes.append(f"{what}: octo models rigid bodies")
        soft.update(nodes)
    for root in [root for root, members in trees.items() if not members]:
        del trees[root]
    if soft and not any(model.body_dofnum[members].any() for members in trees.values()):
        raise UnsupportedFeatureError(
            f"{path.name}: all that moves is a deformable body (flex); octo models rigid bodies"
        )
    return soft


def _flex_bodies(model: Any, f: int) -> set[int]:
    """Bodies that carry the vertices or the nodes of flex ``f``."""
    found: set[int] = set()
    for kind in ("vert", "node"):
        first, count = (getattr(model, f"flex_{kind}{what}")[f] for what in ("adr", "num"))
        bodies = getattr(model, f"flex_{kind}bodyid")[first : first + count]
        found |= {int(b) for b in bodies if b > 0}
    return found


def _is_node(model: Any, b: int) -> bool:
    """Whether body ``b`` is there for a flex alone: it has slides and no shape."""
    joints = model.jnt_type[model.body_jntadr[b] : model.body_jntadr[b] + model.body_jntnum[b]]
    slide = import_mujoco().mjtJoint.mjJNT_SLIDE
    return bool(len(joints) and (joints == slide).all() and not model.body_geomnum[b])


def _body_to_free(file: str, model: Any, others: frozenset[int]) -> int:
    """The one body of the world that carries the robot and has no joints of its own."""
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and b not in others]
    owned = model.body_rootid[:, None] == roots  # (bodies, roots)
    moving = [b for b, own in zip(roots, owned.T, strict=True) if model.body_jntnum[own].any()]
    candidates = moving or [b for b in roots if model.body_subtreemass[b] > 0.0]
    names = ", ".join(name_of(model, "body", b) for b in candidates)
    must = f"{file}: base is 'floating', must be 'auto' or 'fixed'"
    if len(candidates) != 1:
        could = f"{len(candidates)} bodies of the world could float ({names})"
        raise UnsupportedFeatureError(f"{must}: {could}")
    if model.body_jntnum[candidates[0]]:
        raise UnsupportedFeatureError(f"{must}: body {names} has joints to the world of its own")
    return candidates[0]
