"""URDF files: checked and prepared as an XML tree, then compiled by MuJoCo, which by itself would fuse the root link to
the world, invent masses, and stop at meshes it cannot read."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np

from octo.errors import ModelError, RobotFileError, UnsupportedFeatureError
from octo.model.character import Array, Character
from octo.model.compiled import character_of
from octo.model.kinematics import axis_rotation
from octo.model.robot_file import Inertial, RobotFile, import_mujoco, one_line

MOVABLE = {"revolute", "continuous", "prismatic"}
READABLE_MESHES = {".stl", ".obj", ".msh"}
STAND_IN = 1e-10  # kg or kg m², for what MuJoCo refuses to compile; the character gets what the file says


@dataclass
class Prepared:
    """A URDF that MuJoCo compiles as it is meant, and what only the file itself says."""

    path: Path
    name: str
    tree: ElementTree.Element
    root: str  # link that hangs on the world
    meshes: dict[str, bytes] = field(default_factory=dict)
    mesh_files: dict[str, str] = field(default_factory=dict)  # name inside the prepared file -> as written
    inertials: dict[str, Inertial] = field(default_factory=dict)  # by link
    effort: dict[str, float] = field(default_factory=dict)  # N m or N, by joint
    dropped: list[str] = field(default_factory=list)


def load_urdf(path: Path, base: Literal["auto", "floating", "fixed"] = "auto") -> Character:
    """The character of a URDF; ``base`` "auto" is a floating one."""
    prepared = prepare(path)
    model = compile_prepared(prepared)
    free = None if base == "fixed" else model.body(prepared.root).id
    source = RobotFile(model, prepared.name, path.name, free, prepared.inertials, prepared.effort)
    return character_of(source, prepared.dropped)


def prepare(path: Path) -> Prepared:
    """Read and check the URDF at ``path``."""
    try:
        tree = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise RobotFileError(f"{path.name}: not well-formed XML: {error}") from None
    if tree.tag != "robot":
        raise RobotFileError(f"{path.name}: top element is <{tree.tag}>, a URDF has <robot>")
    for child in list(tree):
        if child.tag not in ("link", "joint"):
            tree.remove(child) if child.tag != "transmission" else None
    prepared = Prepared(path, tree.get("name") or path.stem, tree, "")
    _check_names(path.name, tree)
    prepared.root = _root(path.name, tree)
    _check_joints(prepared)
    _check_masses(prepared)
    _note_joints(prepared)
    _collect_geometry(prepared)
    _rename_world(prepared)
    return prepared


def compile_prepared(prepared: Prepared) -> Any:
    """MuJoCo's model of a prepared URDF on a fixed base; a mesh that does not compile is dropped by name."""
    try:
        return make_spec(prepared).compile()
    except ValueError:
        for name, reason in _unreadable(prepared.meshes).items():
            _drop_mesh(prepared, name, reason)
    try:
        return make_spec(prepared).compile()
    except ValueError as error:
        raise RobotFileError(f"{prepared.path.name}: MuJoCo does not compile it: {one_line(error)}") from None


def make_spec(prepared: Prepared) -> Any:
    """The prepared URDF as an MjSpec: no mass from geoms, no fusing, no balancing of inertias."""
    mujoco = import_mujoco()
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(prepared.tree, encoding="unicode"), assets=dict(prepared.meshes))
    spec.compiler.fusestatic = spec.compiler.discardvisual = spec.compiler.balanceinertia = False
    for geom in spec.geoms:
        geom.density = 0.0
    for mesh in spec.meshes:
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a volume is not needed: open surfaces are common
    for body in spec.bodies:
        inertial = prepared.inertials.get(body.name)
        if inertial is not None:
            _give_inertial(body, inertial)
    return spec


def _give_inertial(body: Any, inertial: Inertial) -> None:
    """Set mass, centre and inertia of an MjSpec body; a ball's where MuJoCo would refuse the file's."""
    small, middle, large = np.linalg.eigvalsh(inertial.inertia)
    legal = inertial.mass > 0.0 and small > STAND_IN and small + middle >= large
    body.explicitinertial, body.mass, body.ipos = True, max(inertial.mass, STAND_IN), inertial.com
    body.iquat = [1.0, 0.0, 0.0, 0.0]
    if legal:
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertial.inertia
        body.fullinertia = [xx, yy, zz, xy, xz, yz]
    else:
        body.fullinertia, body.inertia = [math.nan, 0.0, 0.0, 0.0, 0.0, 0.0], np.full(3, max(middle, STAND_IN))


def _unreadable(meshes: Mapping[str, bytes]) -> dict[str, str]:
    """The meshes that MuJoCo refuses, each tried alone, with its reason."""
    mujoco, reasons = import_mujoco(), {}
    for name, data in meshes.items():
        spec = mujoco.MjSpec()
        spec.assets = {name: data}
        mesh = spec.add_mesh(name="mesh", file=name)
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        geom = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
        geom.density = 0.0
        try:
            spec.compile()
        except ValueError as error:
            reasons[name] = one_line(error)
    return reasons


def _drop_mesh(prepared: Prepared, name: str, reason: str) -> None:
    del prepared.meshes[name]
    for link in prepared.tree.iter("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is not None and mesh.get("filename") == name:
                link.remove(collision)
                prepared.dropped.append(f"collision mesh {prepared.mesh_files[name]} of link {link.get('name')}: {reason}")


def _check_names(file: str, tree: ElementTree.Element) -> None:
    for tag in ("link", "joint"):
        names = [element.get("name") for element in tree.findall(tag)]
        for name in names:
            if not name:
                raise RobotFileError(f"{file}: a <{tag}> has no name")
            if names.count(name) > 1:
                raise RobotFileError(f"{file}: {tag} name {name!r} occurs {names.count(name)} times, names must differ")
    if not tree.findall("link"):
        raise RobotFileError(f"{file}: has no <link>")


def _root(file: str, tree: ElementTree.Element) -> str:
    """Name of the one link that is nobody's child."""
    links = [str(link.get("name")) for link in tree.findall("link")]
    parents: dict[str, str] = {}
    for joint in tree.findall("joint"):
        name, ends = joint.get("name"), []
        for end in ("parent", "child"):
            element = joint.find(end)
            link = None if element is None else element.get("link")
            if link not in links:
                raise RobotFileError(f"{file}: joint {name!r}: {end} link is {link!r}, must be a link of the file")
            ends.append(str(link))
        if ends[1] in parents:
            raise UnsupportedFeatureError(
                f"{file}: link {ends[1]!r} has two parent joints ({name!r} is one): closed loops are not modelled"
            )
        parents[ends[1]] = ends[0]
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        raise RobotFileError(f"{file}: {len(roots)} links have no parent ({', '.join(roots) or 'a loop'}), exactly one must")
    return roots[0]


def _check_joints(prepared: Prepared) -> None:
    """Joint types; a floating joint is legal between a bare root and the rest, where it says where the base starts."""
    file = prepared.path.name
    for joint in prepared.tree.findall("joint"):
        name, kind = joint.get("name"), joint.get("type")
        if kind == "floating":
            _take_floating_joint(prepared, joint)
        elif kind == "planar":
            raise UnsupportedFeatureError(
                f"{file}: joint {name!r} is planar; allowed are revolute, continuous, prismatic, fixed, floating at the root"
            )
        elif kind not in MOVABLE | {"fixed"}:
            raise RobotFileError(
                f"{file}: joint {name!r}: type is {kind!r}, allowed are revolute, continuous, prismatic, fixed, floating"
            )
        if kind in MOVABLE and np.linalg.norm(_numbers(file, f"joint {name!r}: axis", joint, "axis", "xyz", "1 0 0")) == 0.0:
            raise RobotFileError(f"{file}: joint {name!r}: axis is zero, must have a direction")
        limit = joint.find("limit")
        if kind in ("revolute", "prismatic") and limit is not None:
            lower, upper = (_number(file, f"joint {name!r}: limit {end}", limit.get(end, "0")) for end in ("lower", "upper"))
            if lower > upper:
                raise RobotFileError(f"{file}: joint {name!r}: lower limit {lower} is above the upper limit {upper}")


def _take_floating_joint(prepared: Prepared, joint: ElementTree.Element) -> None:
    """Make the child of a bare root's floating joint the root of the robot."""
    tree, file = prepared.tree, prepared.path.name
    root = next(link for link in tree.findall("link") if link.get("name") == prepared.root)
    siblings = [other for other in tree.findall("joint") if other.find("parent").get("link") == prepared.root]  # type: ignore[union-attr]
    bare = root.find("inertial") is None and root.find("collision") is None
    if siblings != [joint] or not bare:
        message = "a floating joint may only hang on a root link without mass, geometry and other joints"
        raise UnsupportedFeatureError(f"{file}: joint {joint.get('name')!r} is floating; {message}")
    prepared.root = str(joint.find("child").get("link"))  # type: ignore[union-attr]
    tree.remove(root)
    tree.remove(joint)
    origin = joint.find("origin")
    if origin is not None:
        prepared.dropped.append(f"origin of the floating joint {joint.get('name')}: the base starts at the world's origin")


def _check_masses(prepared: Prepared) -> None:
    """Masses and inertias as written; MuJoCo would invent, refuse or balance some of them."""
    file = prepared.path.name
    for link in prepared.tree.findall("link"):
        name = str(link.get("name"))
        element = link.find("inertial")
        prepared.inertials[name] = _inertial(prepared, name, element)
        if element is not None:
            link.remove(element)
    mass = {name: inertial.mass for name, inertial in prepared.inertials.items()}
    if sum(mass.values()) <= 0.0:
        raise RobotFileError(f"{file}: total mass is {sum(mass.values())} kg, must be positive")
    child_joints: dict[str, list[ElementTree.Element]] = {name: [] for name in mass}
    for joint in prepared.tree.findall("joint"):
        child_joints[joint.find("parent").get("link")].append(joint)  # type: ignore[index,union-attr]
    _check_moved_mass(file, prepared.root, child_joints, mass)


def _check_moved_mass(
    file: str, link: str, child_joints: Mapping[str, list[ElementTree.Element]], mass: Mapping[str, float]
) -> float:
    """Mass (kg) from ``link`` on; every movable joint must carry some."""
    total = mass[link]
    for joint in child_joints[link]:
        child = str(joint.find("child").get("link"))  # type: ignore[union-attr]
        carried = _check_moved_mass(file, child, child_joints, mass)
        if carried == 0.0 and joint.get("type") in MOVABLE:
            raise ModelError(
                f"{file}: joint {joint.get('name')!r} moves link {child!r} of mass 0 kg and nothing else, must move some mass"
            )
        total += carried
    return total


def _inertial(prepared: Prepared, link: str, element: ElementTree.Element | None) -> Inertial:
    """Mass, centre and inertia of one link, its inertia turned to the link's axes; zero without <inertial>."""
    file = prepared.path.name
    if element is None:
        return Inertial(0.0, np.zeros(3), np.zeros((3, 3)))
    mass = _number(file, f"link {link!r}: mass", _attribute(element, "mass", "value"))
    if mass < 0.0:
        raise RobotFileError(f"{file}: link {link!r}: mass is {mass} kg, must not be negative")
    com, angles = (_numbers(file, f"link {link!r}: inertial origin", element, "origin", key) for key in ("xyz", "rpy"))
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    entries = [_number(file, f"link {link!r}: inertia {key}", _attribute(element, "inertia", key, "0")) for key in keys]
    xx, yy, zz, xy, xz, yz = entries
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    small, middle, large = np.linalg.eigvalsh(inertia)
    slack = 1e-3 * large  # rounding of printed numbers
    if small < -slack or small + middle < large - slack:
        prepared.dropped.append(
            f"link {link}: no rigid body has principal inertias {small:.3g}, {middle:.3g}, {large:.3g}; used as written"
        )
    roll, pitch, yaw = (axis_rotation(axis, angle) for axis, angle in zip(np.eye(3), angles, strict=True))
    turn = yaw @ pitch @ roll
    return Inertial(mass, com, turn @ inertia @ turn.T)


def _note_joints(prepared: Prepared) -> None:
    """Efforts, and one sentence for every kind of thing a joint says and octo does not model."""
    joints, dropped = prepared.tree.findall("joint"), prepared.dropped
    movable = [joint for joint in joints if joint.get("type") in MOVABLE]
    for joint in movable:
        name, mimic, limit = str(joint.get("name")), joint.find("mimic"), joint.find("limit")
        effort = 0.0 if limit is None else _number(prepared.path.name, f"joint {name!r}: effort", limit.get("effort", "0"))
        prepared.effort[name] = abs(effort) if effort != 0.0 else math.inf
        if mimic is not None:
            tie = f"{mimic.get('multiplier', '1')}·{mimic.get('joint')} + {mimic.get('offset', '0')}"
            dropped.append(f"mimic joint {name}: loaded as an independent joint, {name} = {tie} is lost")
            joint.remove(mimic)
        if joint.get("type") != "continuous" and (limit is None or limit.get("lower", "0") == limit.get("upper", "0")):
            dropped.append(f"joint {name}: no range in <limit>, taken as unlimited")
            joint.set("type", "continuous" if joint.get("type") == "revolute" else "prismatic")
            _forget_range(limit)
    _note(dropped, "velocity limits", (j for j in movable if float(_attribute(j, "limit", "velocity", "0")) > 0.0))
    rubbing = [j for j in movable if float(_attribute(j, "dynamics", "friction", "0")) != 0.0]
    _note(dropped, "dry friction", rubbing)
    for joint in rubbing:
        joint.find("dynamics").set("friction", "0")  # type: ignore[union-attr]
    _note(dropped, "safety controllers", (j for j in joints if j.find("safety_controller") is not None))
    transmissions = prepared.tree.findall("transmission")
    if transmissions:
        dropped.append(f"{len(transmissions)} transmissions: u is the torque at the joint")
    for element in transmissions:
        prepared.tree.remove(element)


def _forget_range(limit: ElementTree.Element | None) -> None:
    for end in ("lower", "upper"):
        if limit is not None:
            limit.attrib.pop(end, None)


def _note(dropped: list[str], what: str, joints: Iterable[ElementTree.Element]) -> None:
    names = [str(joint.get("name")) for joint in joints]
    if names:
        dropped.append(f"{what} of {len(names)} joints: {', '.join(names)}")


def _collect_geometry(prepared: Prepared) -> None:
    """Remove visuals; give every readable collision mesh a flat name of its own, note the others."""
    for link in prepared.tree.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        for collision in link.findall("collision"):
            collision.attrib.pop("name", None)  # MuJoCo wants geom names to differ, URDF does not
            geometry = collision.find("geometry")
            if geometry is None or len(geometry) == 0:
                link.remove(collision)
                prepared.dropped.append(f"collision of link {link.get('name')}: it has no geometry")
                continue
            mesh = geometry.find("mesh")
            if mesh is not None and not _take_mesh(prepared, str(link.get("name")), mesh):
                link.remove(collision)


def _take_mesh(prepared: Prepared, link: str, mesh: ElementTree.Element) -> bool:
    """Read the mesh's file under a name of its own; False when it cannot be used."""
    written = mesh.get("filename", "")
    found = find_mesh(written, prepared.path)
    suffix = Path(written).suffix.lower()
    if suffix not in READABLE_MESHES:
        prepared.dropped.append(f"collision mesh {written} of link {link}: readable are {', '.join(sorted(READABLE_MESHES))}")
        return False
    if found is None:
        prepared.dropped.append(f"collision mesh {written} of link {link}: the file is missing")
        return False
    name = f"mesh_{len(prepared.meshes)}{suffix}"
    prepared.meshes[name] = found.read_bytes()
    prepared.mesh_files[name] = written
    mesh.set("filename", name)
    return True


def find_mesh(written: str, urdf: Path) -> Path | None:
    """The file that ``written`` in ``urdf`` means: package://, file:// or a path beside the URDF; None when missing."""
    here = urdf.resolve().parent
    if not written.startswith("package://"):
        candidates = [here / written.removeprefix("file://")]
    else:
        inside = written.removeprefix("package://")
        _package, _, rest = inside.partition("/")
        folders = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
        candidates = [folder / inside for folder in (*here.parents, here, *folders)]
        # A package folder is often renamed when it is copied: the rest of the path still says where the mesh is.
        candidates += [folder / rest for folder in (here, *here.parents[:3], *folders)]
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def _rename_world(prepared: Prepared) -> None:
    """A link called "world" would become MuJoCo's world and lose its mass."""

    def renamed(link: str) -> str:
        return "world_link" if link == "world" else link

    for tag, key in (("link", "name"), ("parent", "link"), ("child", "link")):
        for element in prepared.tree.iter(tag):
            element.set(key, renamed(str(element.get(key))))
    prepared.inertials = {renamed(link): inertial for link, inertial in prepared.inertials.items()}
    prepared.root = renamed(prepared.root)


def _attribute(element: ElementTree.Element, child: str, key: str, default: str = "nan") -> str:
    found = element.find(child)
    return default if found is None else found.get(key, default)


def _number(file: str, what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotFileError(f"{file}: {what} is {text!r}, must be a finite number")
    return value


def _numbers(file: str, what: str, element: ElementTree.Element, child: str, key: str, default: str = "0 0 0") -> Array:
    """Three numbers (3,) of an attribute of a child."""
    words = _attribute(element, child, key, default).split()
    if len(words) != 3:
        raise RobotFileError(f"{file}: {what} {key} is {' '.join(words)!r}, must be three numbers")
    return np.array([_number(file, f"{what} {key}", word) for word in words])
