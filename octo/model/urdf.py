"""URDF files: checked and prepared as an XML tree, then compiled by MuJoCo, which by itself would
fuse the root link to the world, invent masses, and stop at meshes it cannot read."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np

from octo.errors import RobotFileError, UnsupportedFeatureError
from octo.files import is_file
from octo.model import looks, xml_file
from octo.model import urdf_elements as elements
from octo.model.character import Character
from octo.model.compiled import character_of
from octo.model.contacts import Contacts
from octo.model.look import Look
from octo.model.robot_file import (
    Inertial,
    Limit,
    RobotFile,
    import_mujoco,
    one_line,
    quiet_compiler,
    uncompiled,
)
from octo.model.urdf_unknown import check_elements

READABLE_MESHES = (".stl", ".obj", ".msh")
# kg or kg m², for what MuJoCo refuses to compile; the character gets what the file says
STAND_IN = 1e-10


@dataclass
class Prepared:
    """A URDF that MuJoCo compiles as it is meant, and what only the file itself says."""

    path: Path
    name: str
    tree: ElementTree.Element
    root: str  # link that hangs on the world
    # contents by name inside the prepared file
    meshes: dict[str, bytes] = field(default_factory=dict)
    # (file, scale) -> that name
    mesh_names: dict[tuple[Path, str], str] = field(default_factory=dict)
    # name inside the prepared file -> as written
    mesh_files: dict[str, str] = field(default_factory=dict)
    inertials: dict[str, Inertial] = field(default_factory=dict)  # by link
    limits: dict[str, Limit] = field(default_factory=dict)  # by joint
    # (mesh as written, reason) -> links
    unusable: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    dropped: list[str] = field(default_factory=list)
    looks: dict[str, list[Look]] = field(default_factory=dict)  # by link


def load_urdf(
    path: Path, base: Literal["auto", "floating", "fixed"] = "auto", contacts: Contacts = "few"
) -> Character:
    """The character of a URDF; ``base`` "auto" is a floating one."""
    prepared = prepare(path)
    with quiet_compiler():
        model = compile_prepared(prepared)
    free = None if base == "fixed" else model.body(prepared.root).id
    own = (prepared.inertials, prepared.limits)
    drawn = {model.body(link).id: found for link, found in prepared.looks.items()}
    source = RobotFile(model, prepared.name, path.name, free, *own, looks=drawn)
    meshes = [
        f"collision mesh {mesh} of links {', '.join(links)}: {reason}"
        for (mesh, reason), links in prepared.unusable.items()
    ]
    return character_of(source, [*prepared.dropped, *meshes], contacts)


def prepare(path: Path, world: bool = False) -> Prepared:
    """Read and check the URDF at ``path``; of a ``world`` nobody asks what it weighs."""
    tree = xml_file.read(path)
    if tree.tag != "robot":
        raise RobotFileError(f"{path.name}: top element is <{tree.tag}>, must be <robot>")
    file = path.name
    unknown = check_elements(file, tree)
    elements.check_names(file, tree)
    prepared = Prepared(
        path, tree.get("name") or path.stem, tree, elements.find_root(file, tree), dropped=unknown
    )
    for link in tree.findall("link"):
        elements.check_shapes(file, link)
    for joint in tree.findall("joint"):
        elements.check_joint(file, joint)
        if joint.get("type") == "floating":
            _take_floating_joint(prepared, joint)
    prepared.inertials = elements.read_inertials(file, tree, prepared.dropped)
    if not world:
        elements.check_mass(file, tree, prepared.inertials)
    prepared.limits = elements.take_limits(file, tree, prepared.dropped)
    elements.drop_joint_features(file, tree, prepared.dropped)
    prepared.looks = looks.of_urdf(tree, lambda written: find_mesh(written, path))
    for child in list(tree):
        if child.tag not in ("link", "joint"):
            tree.remove(child)
    _collect_geometry(prepared)
    _rename_world(prepared)
    return prepared


def compile_prepared(prepared: Prepared) -> Any:
    """MuJoCo's model of a prepared URDF on a fixed base; a mesh that does not compile is dropped by
    name."""
    try:
        return make_spec(prepared).compile()
    except ValueError:
        for name, reason in _unreadable(prepared.meshes).items():
            _drop_mesh(prepared, name, reason)
    try:
        return make_spec(prepared).compile()
    except ValueError as error:
        raise uncompiled(prepared.path, error) from None


def make_spec(prepared: Prepared) -> Any:
    """The prepared URDF as an MjSpec: no mass from geoms, no fusing, no balancing of inertias."""
    mujoco = import_mujoco()
    spec = mujoco.MjSpec.from_string(xml_file.text_of(prepared.tree), assets=dict(prepared.meshes))
    spec.compiler.fusestatic = spec.compiler.discardvisual = spec.compiler.balanceinertia = False
    for geom in spec.geoms:
        geom.density = 0.0
    for mesh in spec.meshes:
        # a volume is not needed: open surfaces are common
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    for body in spec.bodies:
        inertial = prepared.inertials.get(body.name)
        if inertial is not None:
            _give_inertial(body, inertial)
    return spec


def _give_inertial(body: Any, inertial: Inertial) -> None:
    """Set an MjSpec body's mass and inertia; a ball's where MuJoCo would refuse the file's."""
    small, middle, large = np.linalg.eigvalsh(inertial.inertia)
    legal = inertial.mass > 0.0 and small > STAND_IN and small + middle >= large
    body.explicitinertial, body.mass, body.ipos = True, max(inertial.mass, STAND_IN), inertial.com
    body.iquat = [1.0, 0.0, 0.0, 0.0]
    if legal:
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertial.inertia
        body.fullinertia = [xx, yy, zz, xy, xz, yz]
    else:
        body.fullinertia = [math.nan, 0.0, 0.0, 0.0, 0.0, 0.0]
        body.inertia = np.full(3, max(middle, STAND_IN))


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
                key = (prepared.mesh_files[name], reason)
                prepared.unusable.setdefault(key, []).append(str(link.get("name")))


def _take_floating_joint(prepared: Prepared, joint: ElementTree.Element) -> None:
    """Make the child of a bare root's floating joint the root of the robot."""
    tree, file = prepared.tree, prepared.path.name
    parent, child = elements.ends(joint)
    link = next(link for link in tree.findall("link") if link.get("name") == parent)
    siblings = [other for other in tree.findall("joint") if elements.ends(other)[0] == parent]
    bare = link.find("inertial") is None and link.find("collision") is None
    if parent != prepared.root or siblings != [joint] or not bare:
        raise UnsupportedFeatureError(
            f"{file}: joint {joint.get('name')!r} is floating; a floating joint may only hang on a "
            "root link without mass, collision geometry and other joints"
        )
    prepared.root = child
    tree.remove(link)
    tree.remove(joint)
    if joint.find("origin") is not None:
        what = f"origin of the floating joint {joint.get('name')}"
        prepared.dropped.append(f"{what}: the base starts at the world's origin")


def _collect_geometry(prepared: Prepared) -> None:
    """Remove visuals; give every readable collision mesh a flat name, note the others."""
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
    """Read the mesh's file under a separate name; False when it cannot be used."""
    written = mesh.get("filename", "")
    found = find_mesh(written, prepared.path)
    suffix = Path(written).suffix.lower()
    if suffix not in READABLE_MESHES or found is None:
        known = suffix in READABLE_MESHES
        reason = "the file is missing" if known else f"octo reads {', '.join(READABLE_MESHES)}"
        prepared.unusable.setdefault((written, reason), []).append(link)
        return False
    key = (found, mesh.get("scale", ""))
    if key not in prepared.mesh_names:
        name = f"mesh_{len(prepared.meshes)}{suffix}"
        prepared.mesh_names[key] = name
        prepared.mesh_files[name] = written
        prepared.meshes[name] = found.read_bytes()
    mesh.set("filename", prepared.mesh_names[key])
    return True


def find_mesh(written: str, urdf: Path) -> Path | None:
    """The file that ``written`` in ``urdf`` means: package://, file:// or a path beside the URDF;
    None when missing."""
    here = urdf.resolve().parent
    scheme, separator, inside = written.partition("://")
    if scheme not in ("package", "model") or not separator:
        candidates = [here / written.removeprefix("file://")]
    else:
        rest = inside.partition("/")[2]
        folders = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
        candidates = [folder / inside for folder in (*here.parents, here, *folders)]
        # A package folder is often renamed when it is copied: the rest of the path still says where
        # the mesh is.
        candidates += [folder / rest for folder in (here, *here.parents[:3], *folders)]
    return next((candidate for candidate in candidates if is_file(candidate)), None)


def _rename_world(prepared: Prepared) -> None:
    """A link called "world" would become MuJoCo's world and lose its mass."""

    def renamed(link: str) -> str:
        return "world_link" if link == "world" else link

    for tag, key in (("link", "name"), ("parent", "link"), ("child", "link")):
        for element in prepared.tree.iter(tag):
            element.set(key, renamed(str(element.get(key))))
    prepared.inertials = {renamed(link): inertial for link, inertial in prepared.inertials.items()}
    prepared.looks = {renamed(link): found for link, found in prepared.looks.items()}
    prepared.root = renamed(prepared.root)
