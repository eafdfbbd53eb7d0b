"""A motion as animated glTF 2.0, in one binary file: bodies as nodes with meshes and key frames.

A node turns octo's axes, z up, into glTF's, y up; what it carries is in octo's axes. Blender turns
them back: there x, y and z are octo's.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.errors import MissingExtraError
from octo.export.moments import configurations, key_times, on_parents, parents_of
from octo.export.stage import stage
from octo.files import replacing
from octo.model.figure import Faces, Surface
from octo.model.quantities import Array
from octo.model.skins import SHARP, Skin, skins
from octo.picture import NEAR
from octo.result.trajectory import Trajectory
from octo.soft.body import Body
from octo.soft.skin import soft_skins

MOST = 20_000  # triangles of a mesh of the robot's file, about
ROUGH = 0.7  # of all materials; none is a metal
UPRIGHT = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # x, y, z, w: a quarter turn about x
MOVES = 1e-7  # m, and of a quaternion: by less nothing moves
LEAST = 1e-9  # kg^½ m, of a mode's swing


def write_gltf(motion: Trajectory, target: Path, fps: float, visuals: bool) -> None:
    """Write ``target`` (.glb); raises as :func:`octo.export` does."""
    with replacing(target) as beside:
        document = Document()
        if motion.soft is not None:
            looks, names = [soft_skins(motion.soft.body)], ["surface"]
        else:
            assert motion.character is not None
            looks = skins(motion.character, visuals, MOST)
            names = [body.name for body in motion.character.bodies]
        reach = [
            max((float(np.linalg.norm(s.surface.vertices, axis=1).max()) for s in parts), default=0)
            for parts in looks
        ]
        times = key_times(motion, fps, np.array(reach))
        x = configurations(motion, times)
        turn, place = on_parents(motion, x)
        turn = turn[..., [1, 2, 3, 0]]
        bend = None if motion.soft is None else Bend.of(motion.soft.body, x[:, 6:])
        meshes = [
            document.mesh(name, parts, bend) for name, parts in zip(names, looks, strict=True)
        ]
        parents = parents_of(motion)
        nodes = _add_bodies(document, names, parents, meshes, turn[0], place[0])
        still = [document.node(name, document.mesh(name, parts)) for name, parts in stage(motion)]
        roots = [nodes[b] for b in np.flatnonzero(parents < 0)]
        top = document.node(motion.name, None, roots + still, rotation=UPRIGHT)
        document.animate(times, nodes, turn, place, bend)
        document.save(beside, top)


def _add_bodies(
    document: Document,
    names: Sequence[str],
    parents: NDArray[np.intp],
    meshes: Sequence[int | None],
    turn: Array,
    place: Array,
) -> list[int]:
    """The nodes of the bodies, each one's children within it, as they are at the first moment."""
    nodes = [0] * len(meshes)
    children: list[list[int]] = [[] for _ in meshes]
    for b in reversed(range(len(meshes))):  # children come behind their parents
        pose = {"rotation": turn[b].tolist(), "translation": place[b].tolist()}
        nodes[b] = document.node(names[b], meshes[b], children[b], **pose)
        if parents[b] >= 0:
            children[parents[b]].insert(0, nodes[b])
    return nodes


@dataclass(frozen=True)
class Bend:
    """A soft body as its shape where all modes are least, and one morph target a mode, whose weight
    goes from 0 to 1: programs have sliders for no others.

    Attributes
    ----------
    points: (P, 3) m. targets: (r, P, 3) m. weights: (k, r).
    """

    points: Array
    targets: Array
    weights: Array

    @staticmethod
    def of(body: Body, z: Array) -> Bend:
        """At z (k, r) kg^½ m."""
        least, span = z.min(axis=0), np.maximum(np.ptp(z, axis=0), LEAST)
        targets = span[:, None, None] * body.modes.swapaxes(0, 1)
        return Bend(body.deformed(least), targets, (z - least) / span)


class Document:
    """A glTF file as it grows: nodes, meshes, materials, and one block of numbers.

    Raises
    ------
    MissingExtraError: pygltflib or trimesh is not installed.
    """

    def __init__(self) -> None:
        try:
            self.lib: Any = importlib.import_module("pygltflib")
            self.trimesh: Any = importlib.import_module("trimesh")
        except ImportError:
            raise MissingExtraError("a .glb file", "export") from None
        self.file = self.lib.GLTF2(asset=self.lib.Asset(version="2.0", generator="octo"))
        self.block = bytearray()
        self.materials: dict[tuple[float, ...], int] = {}

    def node(
        self, name: str, mesh: int | None, children: Sequence[int] = (), **pose: list[float]
    ) -> int:
        node = self.lib.Node(name=name, mesh=mesh, children=list(children), **pose)
        return self._kept(self.file.nodes, node)

    def mesh(self, name: str, parts: Sequence[Skin], bend: Bend | None = None) -> int | None:
        """One mesh of several surfaces, each with its material; None where there are none."""
        if not parts:
            return None
        if bend is None:
            mesh = self.lib.Mesh(primitives=[self._primitive(part) for part in parts])
        else:
            weights = bend.weights[0].tolist()
            mesh = self.lib.Mesh(primitives=self._bent(parts, bend), weights=weights)
        mesh.name = name
        return self._kept(self.file.meshes, mesh)

    def animate(
        self,
        times: Array,
        nodes: Sequence[int],
        turn: Array,
        place: Array,
        bend: Bend | None = None,
    ) -> None:
        """Key frames at ``times`` (k,) s of rotations (k, nodes, 4) and translations (k, nodes,
        3): of what moves; and of the first node's morph targets."""
        motion = self.lib.Animation(name="motion")
        moments = self.numbers(times, bounds=True)
        tracks = [
            (node, path, values)
            for k, node in enumerate(nodes)
            for path, values in (("rotation", turn[:, k]), ("translation", place[:, k]))
        ]
        if bend is not None:
            tracks.append((nodes[0], "weights", bend.weights))
        for node, path, values in tracks:
            if np.ptp(values, axis=0).max() >= MOVES:
                output = self.numbers(values.ravel() if path == "weights" else values)
                sampler = self.lib.AnimationSampler(input=moments, output=output)
                goal = self.lib.AnimationChannelTarget(node=node, path=path)
                number = self._kept(motion.samplers, sampler)
                motion.channels.append(self.lib.AnimationChannel(sampler=number, target=goal))
        if motion.channels:
            self.file.animations.append(motion)

    def numbers(self, values: NDArray[Any], target: int | None = None, bounds: bool = False) -> int:
        """An accessor of ``values`` (k,) or (k, n) in single precision, indices as they are."""
        floats = values.dtype.kind == "f"
        block = values.astype("<f4" if floats else "<u4")
        kinds = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
        view = self.lib.BufferView(
            buffer=0, byteOffset=len(self.block), byteLength=block.nbytes, target=target
        )
        self.block += block.tobytes()
        flat = block.reshape(len(block), -1)
        least, most = (flat.min(axis=0).tolist(), flat.max(axis=0).tolist()) if bounds else ([], [])
        accessor = self.lib.Accessor(
            bufferView=self._kept(self.file.bufferViews, view),
            componentType=self.lib.FLOAT if floats else self.lib.UNSIGNED_INT,
            count=len(block),
            type=kinds[flat.shape[1]],
            min=least,
            max=most,
        )
        return self._kept(self.file.accessors, accessor)

    def save(self, path: Path, root: int) -> None:
        self.file.scenes.append(self.lib.Scene(nodes=[root]))
        self.file.scene = 0
        self.file.buffers.append(self.lib.Buffer(byteLength=len(self.block)))
        self.file.set_binary_blob(bytes(self.block))
        self.file.save_binary(str(path))

    def _primitive(self, part: Skin) -> Any:
        vertices, normals, faces = self._shaded(part.surface)
        attributes = self.lib.Attributes(
            POSITION=self.numbers(vertices, self.lib.ARRAY_BUFFER, bounds=True),
            NORMAL=self.numbers(normals, self.lib.ARRAY_BUFFER),
        )
        return self.lib.Primitive(
            attributes=attributes,
            indices=self.numbers(faces.ravel(), self.lib.ELEMENT_ARRAY_BUFFER),
            material=self._material(NEAR if part.color is None else part.color),
        )

    def _bent(self, parts: Sequence[Skin], bend: Bend) -> list[Any]:
        """Primitives of one set of points, with the normals of the shape at rest."""
        corners = np.concatenate([part.surface.faces for part in parts])
        whole = self.trimesh.Trimesh(parts[0].surface.vertices, corners, process=False)
        attributes = self.lib.Attributes(
            POSITION=self.numbers(bend.points, self.lib.ARRAY_BUFFER, bounds=True),
            NORMAL=self.numbers(np.array(whole.vertex_normals), self.lib.ARRAY_BUFFER),
        )
        targets = [
            {"POSITION": self.numbers(one, self.lib.ARRAY_BUFFER, bounds=True)}
            for one in bend.targets
        ]
        return [
            self.lib.Primitive(
                attributes=attributes,
                indices=self.numbers(part.surface.faces.ravel(), self.lib.ELEMENT_ARRAY_BUFFER),
                material=self._material(NEAR if part.color is None else part.color),
                targets=targets,
            )
            for part in parts
        ]

    def _shaded(self, surface: Surface) -> tuple[Array, Array, Faces]:
        """Vertices (v, 3) m, normals (v, 3) and faces (f, 3): smooth but where it is sharp."""
        part = self.trimesh.Trimesh(surface.vertices, surface.faces, process=False)
        part.update_faces(part.nondegenerate_faces())
        part.remove_unreferenced_vertices()
        part = self.trimesh.graph.smooth_shade(part, angle=SHARP)
        normals = np.array(part.vertex_normals)
        normals[~(np.linalg.norm(normals, axis=1) > 0.5)] = (0.0, 0.0, 1.0)  # of a fold
        return np.asarray(part.vertices), normals, np.asarray(part.faces)

    def _material(self, color: Array) -> int:
        """Of a colour (3,) as screens have it; glTF's are linear in the light."""
        key = tuple(round(float(value), 6) for value in color)
        if key not in self.materials:
            light = [
                value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4
                for value in key
            ]
            look = {"metallicFactor": 0.0, "roughnessFactor": ROUGH}
            surface = self.lib.PbrMetallicRoughness(baseColorFactor=[*light, 1.0], **look)
            material = self.lib.Material(pbrMetallicRoughness=surface, doubleSided=True)
            self.materials[key] = self._kept(self.file.materials, material)
        return self.materials[key]

    @staticmethod
    def _kept(entries: list[Any], entry: Any) -> int:
        """Its number among the entries."""
        entries.append(entry)
        return len(entries) - 1
