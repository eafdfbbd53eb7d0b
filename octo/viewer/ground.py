"""The ground of a moving picture: a plane, heights, or the shapes of a world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from octo.model.figure import tile
from octo.model.quantities import Array
from octo.result.solution import Solution
from octo.world.drawn import Drawn, creases, drawn

GRID: dict[str, Any] = {"cell_color": (205, 208, 212), "section_color": (160, 166, 174)}
GRID |= {"plane_color": (238, 240, 243), "plane_opacity": 1.0, "shadow_opacity": 0.35}
STONE, CREASE = (176, 170, 158), (104, 100, 94)  # colours of the shapes of a world, of their edges
LEVEL = 1e-6  # m, that a level ground may rise


@dataclass(frozen=True)
class Ground:
    """A node that the motion does not move; a ``plane`` looks the same from everywhere on it."""

    name: str
    position: Array  # (3,) m
    wxyz: Array  # (4,)
    plane: bool
    level: bool


def is_level(solution: Solution) -> bool:
    """Whether one ground does for this motion and for others beside it."""
    if solution.world is not None:
        return False
    return not solution.ground or float(np.ptp(solution.ground["z"])) < LEVEL


def add_ground(
    server: Any, name: str, solution: Solution, offset: Array, scale: float
) -> list[Ground]:
    """Fill the scene with the ground of a motion that is shown ``offset`` (3,) m beside its place;
    ``scale`` (m) is the size of its character."""
    if solution.world is not None:
        x, y = solution.ground["x"], solution.ground["y"]
        around = np.array([(x[0], y[0]), (x[-1], y[-1])])
        parts = enumerate(drawn(solution.world.shapes, around))
        return [_add_shape(server, f"{name}/{k}", one, offset, scale) for k, one in parts]
    x, y, z = (solution.ground[axis] for axis in "xyz")
    rise = [float(np.mean(np.diff(z, axis=axis))) for axis in (0, 1)]
    slope = [rise[0] / (x[1] - x[0]), rise[1] / (y[1] - y[0])]
    plane = z[0, 0] + slope[0] * (x[:, None] - x[0]) + slope[1] * (y - y[0])
    if np.abs(z - plane).max() < LEVEL:
        height = z[0, 0] - slope[0] * x[0] - slope[1] * y[0]
        return [_add_plane(server, name, np.array([*slope, height]), offset, scale)]
    return [_add_heights(server, name, (x, y, z), offset, scale)]


def _add_plane(server: Any, name: str, rise: Array, offset: Array, scale: float) -> Ground:
    """An endless grid, of the slopes along x and y and the height (m) at the origin."""
    cell, (along, across, height) = tile(scale), rise
    wxyz = _turn_to(np.array([-along, -across, 1.0]))
    position = offset + (0.0, 0.0, height)
    cells = {"infinite_grid": True, "cell_size": cell, "section_size": 5 * cell}
    fade = {"fade_distance": 24.0 * scale, "fade_strength": 1.6}
    server.scene.add_grid(name, **GRID, **cells, **fade, wxyz=wxyz, position=position)
    level = bool(np.abs(rise[:2]).max() < LEVEL)
    return Ground(name, position, wxyz, plane=True, level=level)


def _add_heights(
    server: Any, name: str, heights: tuple[Array, Array, Array], offset: Array, scale: float
) -> Ground:
    """A mesh with lines."""
    x, y, z = heights
    corners = np.stack([*np.broadcast_arrays(x[:, None], y), z], axis=-1)
    index = np.arange(z.size).reshape(z.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = [np.stack(corner, axis=-1).reshape(-1, 3) for corner in ((a, b, c), (a, c, d))]
    points = corners.reshape(-1, 3) + offset
    look = {"color": (226, 229, 233), "side": "double", "cast_shadow": False}
    server.scene.add_mesh_simple(name, points, np.concatenate(triangles), **look)
    along = np.stack([corners[:-1], corners[1:]], axis=2).reshape(-1, 2, 3)
    across = np.stack([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 2, 3)
    raised = np.concatenate([along, across]) + offset + (0.0, 0.0, 2e-3 * scale)
    server.scene.add_line_segments(
        f"{name}_lines", raised, colors=(190, 194, 200), thickness=1.0, thickness_units="screen"
    )
    return _still(name)


def _add_shape(server: Any, name: str, shape: Drawn, offset: Array, scale: float) -> Ground:
    """A shape of a world; a plane that can be walked on is an endless grid."""
    if shape.plane is not None and shape.plane[2] > 0.0:
        x, y, z, d = shape.plane
        return _add_plane(server, name, np.array([-x / z, -y / z, d / z]), offset, scale)
    look = {"color": STONE, "flat_shading": not shape.smooth}
    server.scene.add_mesh_simple(name, shape.vertices + offset, shape.faces, **look)
    edges, normals = creases(shape.vertices, shape.faces)
    if len(edges):
        raised = edges + offset + 1e-3 * scale * normals.sum(axis=1)[:, None]
        lines = {"colors": CREASE, "thickness": 1.5, "thickness_units": "screen"}
        server.scene.add_line_segments(f"{name}_edges", raised, **lines)
    return _still(name)


def _still(name: str) -> Ground:
    """A ground that is where it is."""
    return Ground(name, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), plane=False, level=False)


def _turn_to(normal: Array) -> Array:
    """Quaternion that turns the z axis to ``normal`` (3,) about a horizontal axis."""
    n = normal / np.linalg.norm(normal)
    turn = np.array([1.0 + n[2], -n[1], n[0], 0.0])
    return np.asarray(turn / np.linalg.norm(turn))
