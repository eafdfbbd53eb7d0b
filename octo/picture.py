"""Still pictures of a motion, drawn with matplotlib by the painter's algorithm."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from octo.checks import STILLS, Array, ending, flag, numbers, whole
from octo.dynamics.crowd import singles_of
from octo.errors import ModelError, ValueRangeError
from octo.model.figure import ARROW, Surface, ball, tile
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.skins import Skin, skins
from octo.result.even import even
from octo.result.solution import Solution
from octo.saved import Motion, motion_of
from octo.soft.skin import posed, shaded
from octo.world.cut import halved, near
from octo.world.drawn import Drawn, creases, drawn
from octo.world.primitives import Ground
from octo.world.sampled import Heights
from octo.world.world import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from octo.figure import Figure

# rad, between the direction of travel and the width of the picture: seen a little from the front
TURN = 0.42
ELEVATION = 0.34  # rad, of the camera over the horizon
# colours of the first and of the last moment
FAR, NEAR = np.array([0.62, 0.72, 0.84]), np.array([0.13, 0.35, 0.62])
FOOT, LOADED_FOOT = np.array([0.35, 0.37, 0.40]), np.array([0.95, 0.52, 0.12])
TILES = (np.array([0.955, 0.955, 0.95]), np.array([0.90, 0.905, 0.91]))
SHADOW = np.array([0.78, 0.79, 0.80])
TRIANGLES = 2000  # of a mesh of the robot's file, about
AROUND = 1.15  # of a foot's radius: it shows outside of the foot that the file draws
# edge of a painted triangle, in parts of the size: far to near is not defined for long ones
LONGEST = 0.12
STONE = np.array([0.86, 0.84, 0.80])  # colour of the shapes of a world
# in parts of the character's size: of the ground around its way, and of a world's shapes
REACH, WIDE = 1.1, 1.6
FINE, STEP = 0.06, 0.1  # of a triangle of a shape, and how far a shadow may go down a step
SOLID = 0.89  # of a colour, below which a shape is not faded
IN_PLACE: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0}  # of arrows
FORCE = np.array([0.88, 0.27, 0.20])  # colour of the forces between bodies
CREASE, LINE = np.array([0.45, 0.44, 0.42]), 0.04  # colour of an edge, and how far it is nearer


@dataclass(frozen=True)
class Camera:
    """Parallel projection: ``axes`` (3, 3) are the directions right, up and into the picture, in
    the world."""

    axes: Array

    @staticmethod
    def beside(heading: float) -> Camera:
        """For a character that travels in the horizontal direction ``heading`` (rad): from left to
        right."""
        a = heading + TURN
        right, ahead = np.array([np.cos(a), np.sin(a), 0.0]), np.array([-np.sin(a), np.cos(a), 0.0])
        up = np.sin(ELEVATION) * ahead + np.cos(ELEVATION) * np.array([0.0, 0.0, 1.0])
        return Camera(np.stack([right, up, np.cross(up, right)]))

    def flat(self, points: Array) -> Array:
        """(..., 2) m in the picture of points (..., 3) m."""
        return np.asarray(points @ self.axes[:2].T)

    def depth(self, points: Array) -> Array:
        return np.asarray(points @ self.axes[2])


def filmstrip(
    solution: Motion,
    path: str | os.PathLike[str] | None = None,
    moments: int = 6,
    between: tuple[float, float] | None = None,
    *,
    visuals: bool = True,
) -> Figure:
    """The character at ``moments`` times spread evenly over ``between`` (start, end in s; default:
    all), in one picture.

    Feet are orange while they carry load; footprints and the path of the centre of mass are marked.
    Forces between bodies are arrows, one on each body; the weight is as long as 0.8 of the
    character. A character that hardly travels is drawn beside itself, moment by moment; among
    objects or the shapes of a world each moment has a picture of its own, of the same place.
    ``visuals``: a robot looks as its file says, False: as the shapes that octo computes with.

    Raises
    ------
    MissingExtraError: matplotlib is not installed. ModelError: the dynamics are the user's own,
        there is no character.
    ValueRangeError: ``moments`` or ``between`` is not possible. OutputError: the file's ending is
        not .png, .pdf or .svg.
    """
    if path is not None:
        path = ending("path", path, STILLS)
    from octo.figure import table

    solution = even(motion_of(solution))
    if solution.extent is None:
        raise ModelError("filmstrip needs a character: this motion is one of user-written dynamics")
    frames = _chosen(solution, whole("moments", moments), between)
    path_of_com = solution.com[frames[0] : frames[-1] + 1]
    travel = path_of_com[-1, :2] - path_of_com[0, :2]
    room = (0.8 if solution.soft is None else 1.1) * solution.extent
    moving = np.linalg.norm(travel) > room
    camera = Camera.beside(float(np.arctan2(*travel[::-1]) if moving else solution.yaw[0]))
    each = travel @ camera.axes[0, :2] / max(len(frames) - 1, 1)
    # (3,) m, to the right from moment to moment
    shift = max(0.0, 1.1 * room - each) * camera.axes[0]
    scene = Scene(camera, Heights.of(solution.ground), solution.extent, solution.world)
    scene.visuals, pictures = flag("visuals", visuals), 1
    among = scene.obstacles or (solution.character is not None and solution.character.objects)
    if shift.any() and among:  # which a character beside itself would not be among
        pictures, shift = len(frames), np.zeros(3)
    apart = np.linspace(0.0, len(frames) - 1.0, len(path_of_com))[:, None] * shift
    scene.ground_under(path_of_com + apart)
    if not shift.any():
        steps = slice(max(frames[0] - 1, 0), max(frames[-1], 1))
        scene.prints = solution.contact_point[steps][solution.loaded[steps]]
    scenes = [scene.empty() for _ in range(pictures)]
    for number, frame in enumerate(frames):
        share = number / max(len(frames) - 1, 1)
        scenes[number % pictures].character(solution, int(frame), share, number * shift)
    figure, places = table(pictures, *_bounds([np.stack(own.window()) for own in scenes]))
    for own, axes in zip(scenes, places, strict=True):
        own.paint(axes, None if shift.any() else path_of_com)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure


class Scene:
    """Polygons with colours, collected and then painted from far to near."""

    def __init__(
        self, camera: Camera, heights: Heights | None, scale: float, world: World | None = None
    ):
        self.camera, self.terrain, self.scale, self.world = camera, heights, scale, world
        light = -0.45 * camera.axes[0] - 0.55 * camera.axes[2] + np.array([0.0, 0.0, 0.9])
        self.light = light / np.linalg.norm(light)
        # m, of the ground around the way, and of a triangle of a shape
        self.reach, self.fine = (REACH if world is None else WIDE) * scale, FINE * scale
        self.bodies: list[tuple[Array, Array]] = []  # (f, 3, 3) m and (f, 3) colours
        self.shapes: list[tuple[Array, Array]] = []  # of the world: the same
        self.floors: list[Drawn] = []  # its planes
        self.shadows: list[Array] = []
        self.tiles: list[tuple[Array, Array]] = []  # (4, 3) m, (3,) colour
        self.prints = np.zeros((0, 3))
        # start and way (k, 3) m of forces
        self.arrows: list[tuple[Array, Array]] = [(np.zeros((0, 3)), np.zeros((0, 3)))]
        # characters look as their files say; not in their colours, but in those of a moment
        self.visuals, self.colored = True, False
        self.skins: list[list[Skin]] | None = None  # of the character, once it is drawn

    def empty(self) -> Scene:
        """The same ground, footprints and light, without characters."""
        other = copy(self)
        other.bodies, other.shadows, other.arrows = [], [], self.arrows[:1]
        return other

    @property
    def obstacles(self) -> bool:
        """Whether the world is more than planes."""
        shapes = () if self.world is None else self.world.shapes
        return not all(isinstance(shape, Ground) for shape in shapes)

    def character(self, solution: Solution, frame: int, share: float, shift: Array) -> None:
        """The character, or soft body, at node ``frame``; ``share`` of the way from the first to
        the last moment colours it."""
        x = solution.x[frame + 1]
        color = (1 - share) * FAR + share * NEAR
        if solution.soft is not None:
            for surface, shade in posed(solution.soft, x):
                tint = shade if self.colored else shaded(color, shade)
                self._add(surface, np.eye(3), shift, tint)
            return
        character = solution.character
        assert character is not None
        rotation, origin = body_poses(character, x)
        if self.skins is None:
            self.skins = skins(character, self.visuals, TRIANGLES)
        for own, R, t in zip(self.skins, rotation, origin, strict=True):
            for skin in own:
                own_color = skin.color if self.colored else None
                self._add(skin.surface, R, t + shift, color if own_color is None else own_color)
        centers, loaded = sphere_centers(character, x), solution.loaded
        singles = singles_of(character)
        dressed = {look.body for look in character.looks if self.visuals}
        for c, k in enumerate(character.terrain_contacts):
            if k not in singles:  # a vertex of the surface that is drawn
                continue
            contact = character.contacts[k]
            over = AROUND if contact.body in dressed else 1.0
            radius = over * max(1.12 * contact.radius, 0.02 * self.scale)
            if loaded[:, c].any():
                color = LOADED_FOOT if loaded[max(frame - 1, 0), c] else FOOT
                self._add(ball(np.zeros(3), radius), np.eye(3), centers[k] + shift, color)
        if frame > 0:  # the forces of a step belong to the node that ends it
            on = solution.touched[frame - 1]
            length = ARROW * self.scale / solution.weight  # m/N
            where, push = solution.touch_point[frame - 1, on], solution.touch_force[frame - 1, on]
            self.arrows += [(where + shift, sign * length * push) for sign in (1.0, -1.0)]

    def _add(self, surface: Surface, rotation: Array, origin: Array, color: Array) -> None:
        corners = (surface.vertices @ rotation.T + origin)[surface.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
        if self.terrain is not None:
            shadow = corners[normal[:, 2] > 0.0].copy()
            shadow[..., 2] = self.terrain.height(shadow)
            # none on what is steep, where it would be a curtain, or above
            if self.world is not None:
                above = (shadow[..., 2] > corners[normal[:, 2] > 0.0][..., 2]).any(axis=1)
                steep = (self.terrain.drop(shadow) > STEP * self.scale).any(axis=1)
                shadow = shadow[~(above | steep)]
            self.shadows.append(shadow)
        front = normal @ self.camera.axes[2] < 0.0
        corners, normal = halved(corners[front], normal[front], LONGEST * self.scale)
        bright = 0.50 + 0.55 * np.maximum(normal @ self.light, 0.0)
        halfway = self.light - self.camera.axes[2]
        shine = 0.25 * np.maximum(normal @ (halfway / np.linalg.norm(halfway)), 0.0) ** 30
        self.bodies.append((corners, np.clip(bright[:, None] * color + shine[:, None], 0.0, 1.0)))

    def ground_under(self, path: Array) -> None:
        """Checkered tiles that fade away from ``path`` (k, 3), or the shapes of a world."""
        if self.terrain is None:
            return
        thinned = path[:: max(1, len(path) // 200), :2]
        if self.world is None:
            self.tiles = self._tiles(self.terrain.height, thinned)
            return
        around = np.stack([thinned.min(axis=0) - self.reach, thinned.max(axis=0) + self.reach])
        every = drawn(self.world.shapes, around)
        self.floors = [one for one in every if one.plane is not None and one.plane[2] > 0.0]
        for floor in self.floors:
            for corners, color in self._tiles(floor.height, thinned):
                self._add_part(corners[[[0, 1, 2], [0, 2, 3]]], np.stack([color, color]), thinned)
        for surface in (one for one in every if one not in self.floors):
            self._add_shape(surface.vertices[surface.faces], thinned)
            self._add_creases(*creases(surface.vertices, surface.faces), thinned)

    def _fade(self, places: Array, path: Array) -> Array:
        """(k,) 1 where places (k, 2) are near the path (p, 2), 0 where they are out of reach."""
        away = cKDTree(path).query(places)[0] / self.reach
        return np.asarray(np.clip(1.35 * (1.0 - away), 0.0, 1.0))

    def _tiles(self, height: Callable[[Array], Array], path: Array) -> list[tuple[Array, Array]]:
        """Corners (4, 3) m and colours (3,) of the tiles of a ground in reach."""
        edge = tile(self.scale)
        first = np.floor((path.min(axis=0) - self.reach) / edge).astype(int)
        last = np.ceil((path.max(axis=0) + self.reach) / edge).astype(int)
        square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
        made = []
        for i in range(first[0], last[0]):
            for j in range(first[1], last[1]):
                corners = edge * (square + (i, j))
                fade = self._fade(corners.mean(axis=0)[None], path)[0]
                if fade > 0.0:
                    points = np.column_stack([corners, height(corners)])
                    made.append((points, 1.0 - fade * (1.0 - TILES[(i + j) % 2])))
        return made

    def _add_shape(self, corners: Array, path: Array) -> None:
        """Triangles (f, 3, 3) m of a shape of the world, those in sight."""
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
        front = normal @ self.camera.axes[2] < 0.0
        bright = 0.72 + 0.28 * np.maximum(normal @ self.light, 0.0)
        self._add_part(corners[front], bright[front, None] * STONE, path, faded=False)

    def _add_part(self, corners: Array, colors: Array, path: Array, faded: bool = True) -> None:
        """Triangles (f, 3, 3) m in colours (f, 3), cut fine; ``faded``: they are already."""
        corners, colors = near(corners, colors, path, self.reach, self.fine)
        fade = np.ones(len(corners)) if faded else self._fade(corners.mean(axis=1)[:, :2], path)
        for floor in () if faded else self.floors:  # what is buried is not seen from above
            level = floor.height(corners[..., :2].reshape(-1, 2)).reshape(-1, 3)
            fade[(corners[..., 2] <= level).all(axis=1)] = 0.0
        self.shapes.append(
            (corners[fade > 0.0], (1.0 - fade[:, None] * (1.0 - colors))[fade > 0.0])
        )

    def _add_creases(self, ends: Array, normals: Array, path: Array) -> None:
        """Edges (k, 2, 3) m of a shape as lines, where one of their faces (k, 2, 3) is in sight."""
        seen = ((normals @ self.camera.axes[2]) < 0.0).any(axis=1)
        lines = ends[seen][:, [0, 1, 1]] - LINE * self.scale * self.camera.axes[2]
        self._add_part(lines, np.broadcast_to(CREASE, (len(lines), 3)), path, faded=False)

    def window(self) -> tuple[Array, Array]:
        """Lower left and upper right corner (2,) m of the picture."""
        flat = self.camera.flat
        bodies = flat(np.concatenate([corners for corners, _ in self.bodies])).reshape(-1, 2)
        ground = [flat(points).reshape(-1, 2) for points, _ in (*self.tiles, *self.shapes)]
        low, high = _bounds([bodies, *ground])
        body_low, body_high = _bounds([bodies])
        margin = 0.22 * self.scale
        low = np.maximum(low, body_low - (margin, 1.6 * margin))
        high = np.minimum(high, body_high + (margin, margin))
        tops = [flat(part[tint.max(axis=1) < SOLID]).reshape(-1, 2) for part, tint in self.shapes]
        top = max((float(points[:, 1].max()) for points in tops if len(points)), default=low[1])
        high[1] = np.clip(top, body_high[1], body_high[1] + self.scale) + 0.5 * margin
        return low, high

    def paint(self, axes: Axes, path: Array | None) -> None:
        """Ground, footprints, shadows, then bodies; a hilly ground is sorted with the bodies."""
        from matplotlib.collections import PolyCollection

        flat, depth = self.camera.flat, self.camera.depth
        corners, colors = (np.concatenate(part) for part in zip(*self.bodies, strict=True))

        def paint(polygons: Sequence[Array] | Array, colors: Any, order: int) -> None:
            look = {"facecolors": colors, "edgecolors": colors, "linewidths": 0.35}
            axes.add_collection(PolyCollection(polygons, zorder=order, **look))

        if self.tiles:
            far_first = sorted(self.tiles, key=lambda tile: -float(depth(tile[0].mean(axis=0))))
            paint([flat(points) for points, _ in far_first], [color for _, color in far_first], 1)
        prints = flat(self.prints)
        dots = {"ms": 2.5, "mew": 0.0, "color": LOADED_FOOT, "alpha": 0.2, "zorder": 3}
        axes.plot(prints[:, 0], prints[:, 1], "o", **dots)
        away = depth(corners.mean(axis=1))
        if self.shadows and self.world is None:
            paint(flat(np.concatenate(self.shadows)), SHADOW, 2)
        elif self.shapes:  # a little farther than what stands on them, and than its shadow
            shadows = np.concatenate([*self.shadows, np.zeros((0, 3, 3))])
            parts, tints = (np.concatenate(part) for part in zip(*self.shapes, strict=True))
            corners = np.concatenate([parts, shadows, corners])
            colors = np.concatenate([tints, np.broadcast_to(SHADOW, (len(shadows), 3)), colors])
            lower, shade = depth(parts.mean(axis=1)), depth(shadows.mean(axis=1))
            away = np.concatenate([lower + 1.5 * self.fine, shade + 0.5 * self.fine, away])
        order = np.argsort(-away, kind="stable")
        paint(flat(corners[order]), colors[order], 5)
        starts, ways = (flat(np.concatenate(part)) for part in zip(*self.arrows, strict=True))
        if len(starts):
            axes.quiver(*starts.T, *ways.T, color=FORCE, width=0.0025, zorder=7, **IN_PLACE)
        if path is not None:
            line = flat(path)
            over = 6 if self.shapes else 4
            axes.plot(line[:, 0], line[:, 1], color="black", lw=1.0, alpha=0.6, zorder=over)


def _chosen(
    solution: Solution, moments: int, between: tuple[float, float] | None
) -> NDArray[np.intp]:
    """Nodes at ``moments`` even times."""
    end = solution.steps * solution.dt
    start, stop = (0.0, end) if between is None else numbers("between", between, (2,)).tolist()
    if not 0.0 <= start <= stop <= end + 1e-9:
        allowed = f"two times from 0 to {end:g} s, in order"
        raise ValueRangeError(f"between is {between}, must be {allowed}")
    return np.unique(np.round(np.linspace(start, stop, moments) / solution.dt).astype(np.intp))


def _bounds(parts: Sequence[Array]) -> tuple[Array, Array]:
    points = np.concatenate(parts)
    return points.min(axis=0), points.max(axis=0)
