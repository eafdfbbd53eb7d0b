"""The still scene of a moving picture, and where its nodes are at every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from octo.dynamics.crowd import singles_of
from octo.errors import ModelError
from octo.model.character import Character
from octo.model.figure import ARROW, ball, size
from octo.model.kinematics import axis_rotation, body_poses, center_of_mass
from octo.model.quantities import Array, interpolated
from octo.model.quaternions import quaternions
from octo.model.skins import Skin, skins
from octo.result.solution import Solution
from octo.soft.skin import shaded, soft_skins
from octo.viewer.ground import Ground, add_ground, is_level

Color = tuple[int, int, int]
RATE = 30.0  # frames a second, about: a frame is a whole number of steps of the first solution
CALM = 0.4  # s, over which the motion of the camera is smoothed
COLORS: tuple[Color, ...] = ((66, 120, 178), (208, 112, 60), (96, 152, 92), (140, 106, 170))
FOOT, LOADED_FOOT, FORCE = (92, 97, 104), (245, 140, 40), (225, 70, 50)
AWAY = -1e3  # m, height at which an arrow without a force is out of sight
SAME_HEADING = 1e-3  # rad
UP = np.array([0.0, 0.0, 1.0])


def frame_times(solutions: Sequence[Solution]) -> Array:
    """(frames,) s, nodes of the first solution, about RATE in a second, and the end of the
    longest."""
    end = max(s.steps * s.dt for s in solutions)
    frame = solutions[0].dt * max(1, round(1.0 / (RATE * solutions[0].dt)))
    return np.append(np.arange(0.0, end - 1e-3 * frame, frame), end)


@dataclass(frozen=True)
class Actor:
    """One character, or soft body, with its motion at the frames of the picture.

    Attributes
    ----------
    bodies: their names. scale: m, the size of all of it.
    rotation (frames, bodies, 4): quaternions, real part first; origin (frames, bodies, 3) m.
    com: (frames, 3) m. force, point: (frames, c, 3) N and m. loaded: (frames, c). touch: force on
        the sphere's body, and where, (frames, m, 3) each, of what touches what. bend: (frames, r)
        kg^½ m, of a soft body's modes.
    """

    solution: Solution
    bodies: tuple[str, ...]
    scale: float
    offset: Array  # (3,) m, where it stands beside the others
    rotation: Array
    origin: Array
    com: Array
    force: Array
    point: Array
    loaded: NDArray[np.bool_]
    touch: tuple[Array, Array]
    skins: list[list[Skin]]  # of each body
    bend: Array | None = None

    @staticmethod
    def of(solution: Solution, times: Array, offset: Array, visuals: bool = True) -> Actor:
        character, soft, scale = solution.character, solution.soft, solution.extent
        if scale is None:
            raise ModelError(
                "view needs a character: a motion of user-written dynamics has no bodies"
            )
        x = interpolated(solution.x[1:], times / solution.dt)
        if soft is not None:
            bodies: tuple[str, ...] = (soft.body.name,)
            drawn = [soft_skins(soft.body)]
            com = x[:, :3]
            turn, origin = soft.rotation(x)[:, None], com[:, None]
        else:
            assert character is not None
            bodies, drawn = tuple(body.name for body in character.bodies), skins(character, visuals)
            com = center_of_mass(character, x)
            turn, origin = body_poses(character, x)
        turns = [quaternions(turn[:, b]) for b in range(len(bodies))]
        # The forces of a step belong to the node that ends it.
        step = np.ceil(times / solution.dt - 1e-4).astype(int) - 1
        step = np.clip(step, 0, max(solution.steps - 1, 0))
        fields = (solution.contact_force, solution.contact_point, solution.loaded)
        force, point, loaded = (values[step] for values in fields)
        rotation = np.stack(turns, axis=1)
        push = np.where(solution.touched[..., None], solution.touch_force, 0.0)[step]
        touch = (push, solution.touch_point[step] + offset)
        at = (rotation, origin + offset, com + offset, force, point + offset, loaded, touch)
        bend = None if soft is None else x[:, 6:]
        return Actor(solution, bodies, scale, offset, *at, drawn, bend)


@dataclass(frozen=True)
class Nodes:
    """Names of the nodes of one character in the scene.

    ``bodies`` and ``feet`` map an index of the character to a name; ``arrows``: None without them.
    ``bent``: the parts of a soft body's surface, whose points move.
    """

    bodies: dict[int, str] = field(default_factory=dict)
    feet: dict[int, str] = field(default_factory=dict)
    arrows: str | None = None
    bent: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Cycle:
    """What a lap of a cycle adds: the point p goes to Rz(yaw) p + way."""

    yaw: float  # rad
    way: Array  # (3,) m

    @staticmethod
    def of(actor: Actor) -> Cycle:
        """From the first to the last state of a motion; nothing for a fixed base."""
        robot = actor.solution.character
        if robot is not None and robot.base == "fixed":
            return Cycle(0.0, np.zeros(3))
        yaw = actor.solution.yaw
        turn = float(yaw[-1] - yaw[0])
        lap = Cycle(turn if abs(turn) > SAME_HEADING else 0.0, np.zeros(3))
        return Cycle(lap.yaw, actor.com[-1] - lap.after(actor.com[0]))

    def after(self, points: Array) -> Array:
        """Points (..., 3) m, one lap later."""
        return np.asarray(points @ axis_rotation(UP, self.yaw).T + self.way)

    def before(self, points: Array) -> Array:
        return np.asarray((points - self.way) @ axis_rotation(UP, self.yaw))

    def on(self, grounds: Sequence[Ground]) -> Cycle | None:
        """None on a ground that a lap changes; on a level one without what the lap rises."""
        if not all(ground.plane and (ground.level or self.yaw == 0.0) for ground in grounds):
            return None
        level = all(ground.level for ground in grounds)
        return Cycle(self.yaw, self.way * (1.0, 1.0, 0.0) if level else self.way)


def build(
    server: Any, actors: Sequence[Actor], forces: bool
) -> tuple[list[Nodes], list[Ground], float]:
    """Fill the scene of a viser server; the names of its nodes and its scale (m)."""
    scale = max(actor.scale for actor in actors)
    _set_stage(server, actors)
    server.scene.add_frame("/world", show_axes=False)
    grounds: list[Ground] = []
    for k, actor in enumerate(actors):
        # One level ground is enough for all.
        other = actor.offset.any() and not is_level(actor.solution)
        if actor.solution.ground and (k == 0 or other):
            name = f"/world/ground_{k}"
            grounds += add_ground(server, name, actor.solution, actor.offset, scale)
    names = [f"/world/{k}_{_plain(actor.solution.name)}" for k, actor in enumerate(actors)]
    nodes = [
        _add_character(server, name, actor, color_of(k) if len(actors) > 1 else None, forces)
        for k, (name, actor) in enumerate(zip(names, actors, strict=True))
    ]
    return nodes, grounds, scale


def color_of(k: int) -> Color:
    """Of the k-th character."""
    return COLORS[k % len(COLORS)]


def _extent(actor: Actor) -> float:
    """m, the largest of the bodies at the first frame: without contacts more than ``size``."""
    turns = Rotation.from_quat(np.roll(actor.rotation[0], -1, axis=1)).as_matrix()
    points = [
        skin.surface.vertices @ turns[b].T + actor.origin[0, b]
        for b, own in enumerate(actor.skins)
        for skin in own
    ]
    return float(np.ptp(np.concatenate(points), axis=0).max()) if points else 0.0


def _set_stage(server: Any, actors: Sequence[Actor]) -> None:
    """The camera; light stays as viser has it."""
    scale = max(max(actor.scale, _extent(actor)) for actor in actors)
    firsts = [actor.com[0] - actor.com[0] * (1, 1, 0) + actor.offset for actor in actors]
    wide = scale + 0.4 * float(np.ptp([actor.offset[1] for actor in actors]))
    set_camera(server, np.mean(firsts, axis=0), scale, wide)


def set_camera(server: Any, middle: Array, scale: float, wide: float) -> None:
    """It looks a little below ``middle`` (3,) m, around which so many m are seen; ``scale`` (m) is
    the size of what stands there."""
    camera = server.initial_camera
    camera.fov = 0.6
    camera.look_at = tuple(middle - (0.0, 0.0, 0.12 * scale))
    camera.position = tuple(middle + wide * np.array([1.1, -2.5, 0.95]))
    server.scene.set_up_direction("+z")


def camera_path(
    actor: Actor, times: Array, follow: bool, scale: float, cycle: Cycle | None
) -> Array:
    """(frames, 3) m, horizontal way of the camera; over the shapes of a world it rises and falls
    too.

    It stays where it is for a character that hardly travels, unless a cycle would jump back.
    """
    climbs = cycle is None and actor.solution.world is not None
    way = (actor.com - actor.offset - (0.0, 0.0, actor.com[0, 2])) * (1.0, 1.0, float(climbs))
    travels = cycle is not None or float(np.ptp(way, axis=0).max()) >= scale
    if not follow or not travels or len(way) < 3:
        return np.repeat(way[:1], len(way), axis=0)
    count, offset = len(way), actor.offset * (1.0, 1.0, 0.0)
    if cycle is not None:  # smoothed together with the laps before and after it
        level = Cycle(cycle.yaw, cycle.way * (1.0, 1.0, 0.0))
        laps = [level.before(way[:-1] + offset), way + offset, level.after(way[1:] + offset)]
        way = np.concatenate(laps) - offset
    straight = np.linspace(way[0], way[-1], len(way))
    frames = CALM / float(times[1] - times[0])
    swing = gaussian_filter1d(way - straight, frames, axis=0, mode="nearest")
    start = 0 if cycle is None else count - 1
    return np.asarray((straight + swing)[start : start + count])


def _add_character(
    server: Any, name: str, actor: Actor, color: Color | None, forces: bool
) -> Nodes:
    """``color``: of all of it, None where it stands alone and has its own."""
    character, ever = actor.solution.character, np.asarray(actor.solution.loaded.any(axis=0))
    looks: Sequence[Sequence[Skin]] = actor.skins
    if color is not None and actor.bend is not None:  # it keeps its two shades
        looks, color = _in_shades_of(np.array(color) / 255.0, looks), None
    bodies = add_bodies(server, name, actor.bodies, looks, color)
    feet = {} if character is None else add_feet(server, bodies, character, ever)
    bent = [] if actor.bend is None or 0 not in bodies else parts_of(bodies[0], len(actor.skins[0]))
    if not forces or not (ever.any() or actor.touch[0].any()):
        return Nodes(bodies, feet, None, bent)
    add_arrows(server, f"{name}/forces", arrows_of(actor)[0], actor.scale)
    return Nodes(bodies, feet, f"{name}/forces", bent)


def _in_shades_of(color: Array, looks: Sequence[Sequence[Skin]]) -> list[list[Skin]]:
    """The skins of a soft body in another colour (3,), of numbers from 0 to 1."""
    return [
        [replace(skin, color=shaded(color, np.asarray(skin.color))) for skin in own]
        for own in looks
    ]


def add_bodies(
    server: Any,
    name: str,
    bodies: Sequence[str],
    looks: Sequence[Sequence[Skin]],
    color: Color | None = None,
) -> dict[int, str]:
    """Nodes below ``name`` of the bodies that are drawn; ``color``: of all of them."""
    nodes = {}
    for b, (body, own) in enumerate(zip(bodies, looks, strict=True)):
        if own:
            nodes[b] = f"{name}/{b}_{_plain(body)}"
        for skin, part in zip(own, parts_of(nodes.get(b, ""), len(own)), strict=True):
            tint = color or (COLORS[0] if skin.color is None else _shown(skin.color))
            server.scene.add_mesh_simple(
                part, skin.surface.vertices, skin.surface.faces, color=tint
            )
    return nodes


def parts_of(node: str, count: int) -> list[str]:
    """The nodes of a body's parts: the others move with the first."""
    return [node if k == 0 else f"{node}/part_{k}" for k in range(count)]


def add_feet(
    server: Any,
    bodies: Mapping[int, str],
    character: Character,
    ever: NDArray[np.bool_],
    fineness: int = 2,
) -> dict[int, str]:
    """A ball at each contact (c,) with the ground that ``ever`` carries, below its body's node."""
    nodes, scale = {}, size(character)
    singles = singles_of(character)  # of the others the body's surface is drawn
    for c, k in enumerate(character.terrain_contacts):
        contact = character.contacts[k]
        if ever[c] and contact.body in bodies and k in singles:
            surface = ball(contact.position, max(1.1 * contact.radius, 0.018 * scale), fineness)
            nodes[c] = f"{bodies[contact.body]}/{_plain(contact.name)}"
            server.scene.add_mesh_simple(nodes[c], surface.vertices, surface.faces, color=FOOT)
    return nodes


def add_arrows(server: Any, name: str, points: Array, scale: float) -> None:
    """Arrows (k, 2, 3) m of forces, beside a character of size ``scale`` m."""
    radius = 0.01 * scale
    sizes = {"shaft_radius": radius, "head_radius": 2.5 * radius, "head_length": 5 * radius}
    server.scene.add_arrows(name, points, FORCE, **sizes)


def arrows_of(actor: Actor) -> Array:
    """(frames, c + 2 m, 2, 3) m, start and end of each arrow, of what touches what one on each
    body; without a force it is out of sight."""
    weight = actor.solution.weight
    length = ARROW * actor.scale / weight if weight > 0.0 else 0.0  # m/N
    push, where = actor.touch
    point = np.concatenate([actor.point, where, where], axis=1)
    force = np.concatenate([actor.force, push, -push], axis=1)
    shown = np.concatenate([actor.loaded, *2 * [push.any(axis=-1)]], axis=1)
    arrows = np.stack([point, point + length * force], axis=2)
    arrows[~shown] = [(0.0, 0.0, AWAY), (0.0, 0.0, AWAY - 1.0)]
    return np.asarray(arrows)


def _shown(color: Array) -> Color:
    """Of numbers from 0 to 1."""
    red, green, blue = (round(255.0 * float(value)) for value in color)
    return red, green, blue


def _plain(name: str) -> str:
    """The name without the slash that would begin a new level of the scene."""
    return name.replace("/", "_")
