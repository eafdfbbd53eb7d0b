"""A moving picture: one HTML file with a time line that any browser plays, also offline."""

from __future__ import annotations

import contextlib
import html
import io
import os
import socket
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from octo.errors import MissingExtraError, ModelError, OutputError, ShapeError
from octo.model.character import Character
from octo.model.figure import ball, size, surfaces
from octo.model.kinematics import body_poses, center_of_mass
from octo.model.quaternions import quaternions
from octo.solver.solution import Solution

Array = NDArray[np.float64]
RATE = 30.0  # frames a second
HOLD = 0.6  # s, that the last frame stays before the picture begins anew
GRAIN = 2.0**-13  # m and parts of a quaternion: poses are rounded to it, which compresses them to a third
CALM = 0.4  # s, over which the motion of the camera is smoothed
COLORS = ((66, 120, 178), (208, 112, 60), (96, 152, 92), (140, 106, 170))  # of the characters
FOOT, LOADED_FOOT, FORCE = (92, 97, 104), (245, 140, 40), (225, 70, 50)
AWAY = -1e3  # m, height at which an arrow without a force is out of sight


@dataclass(frozen=True)
class Actor:
    """One character with its motion at the frames of the picture.

    Attributes
    ----------
    rotation (frames, bodies, 4): quaternions, real part first; origin (frames, bodies, 3) m.
    com: (frames, 3) m. force, point: (frames, c, 3) N and m. loaded: (frames, c).
    """

    solution: Solution
    character: Character
    offset: Array  # (3,) m, where it stands beside the others
    rotation: Array
    origin: Array
    com: Array
    force: Array
    point: Array
    loaded: NDArray[np.bool_]

    @staticmethod
    def of(solution: Solution, times: Array, offset: Array) -> Actor:
        character = solution.character
        if character is None:
            raise ModelError("view needs a character: a motion of user-written dynamics has no bodies to draw")
        x = _between(solution.x[1:], times / solution.dt)
        rotation, origin = body_poses(character, x)
        turns = np.stack([quaternions(rotation[:, b]) for b in range(len(character.bodies))], axis=1)
        # Forces belong to x_1 … x_N, where they were computed: the picture shows the nearest.
        nearest = np.clip(np.round(times / solution.dt).astype(int) - 1, 0, max(solution.steps - 1, 0))
        force, point, loaded = (v[nearest] for v in (solution.contact_force, solution.contact_point, solution.loaded))
        com = center_of_mass(character, x) + offset
        return Actor(solution, character, offset, turns, origin + offset, com, force, point + offset, loaded)


def view(
    solution: Solution | Sequence[Solution],
    path: str | os.PathLike[str],
    *,
    follow: bool = True,
    forces: bool = True,
    apart: float | None = None,
) -> None:
    """Write the motion as one self-contained HTML file (1–2 MB) with a time line; nothing is loaded from the network.

    Parameters
    ----------
    solution: one, or several that are shown side by side in one scene (a plan and what a plant made of it).
    path: the file, written beside and then renamed.
    follow: the camera travels with the (first) character; a mouse still turns it.
    forces: draw the contact forces as arrows; the weight is as long as 0.8 of the character.
    apart: m, between neighbours of several; by default 1.5 times the larger one. 0 shows them in the same place.

    Raises
    ------
    MissingExtraError: viser, or what it needs, is not installed. ModelError: user-written dynamics have no bodies.
    ShapeError: no solution. OutputError: the file cannot be written.
    """
    try:
        import viser
    except ImportError:
        raise MissingExtraError("a moving picture", "view") from None
    solutions = [solution] if isinstance(solution, Solution) else list(solution)
    if not solutions:
        raise ShapeError("solution", (0,), "one Solution or more")
    end = max(s.steps * s.dt for s in solutions)
    times = np.append(np.arange(0.0, end - 0.5 / RATE, 1.0 / RATE), end)
    if apart is None:
        apart = 1.5 * max((size(s.character) for s in solutions if s.character is not None), default=0.0)
    actors = [Actor.of(s, times, np.array([0.0, -k * apart, 0.0])) for k, s in enumerate(solutions)]
    with _server(viser) as server:
        text = _record(server, actors, times, follow, forces)
    title = html.escape(", ".join(dict.fromkeys(s.name for s in solutions)))
    text = text.replace("<title>Viser</title>", f"<title>{title}: {end:g} s</title>", 1)
    _write(Path(path), text)


def _record(server: Any, actors: Sequence[Actor], times: Array, follow: bool, forces: bool) -> str:
    scale = max(size(actor.character) for actor in actors)
    _set_stage(server, actors, scale)
    world = server.scene.add_frame("/world", show_axes=False)
    for k, actor in enumerate(actors):
        level = not actor.solution.ground or float(np.ptp(actor.solution.ground["z"])) < 1e-6
        if k == 0 or (actor.offset.any() and not level):  # one level ground is enough for all
            _add_ground(server, f"/world/ground_{k}", actor, scale)
    players = [Player(server, f"/world/{k}_{actor.solution.name}", actor, COLORS[k % len(COLORS)], forces)
               for k, actor in enumerate(actors)]  # fmt: skip
    shift = _camera_path(actors[0], follow, scale)
    recorder = server.get_scene_serializer()
    for i, seconds in enumerate(np.diff(times, append=times[-1] + HOLD)):
        world.position = _rounded(-shift[i])
        for player in players:
            player.show(i)
        recorder.insert_sleep(float(seconds))
    return str(recorder.as_html())


def _set_stage(server: Any, actors: Sequence[Actor], scale: float) -> None:
    """The camera. Light stays as it is by default: a player sets it back to that, slowly, each time it begins anew."""
    middle = np.mean([actor.com[0] - actor.com[0] * (1, 1, 0) + actor.offset for actor in actors], axis=0)
    wide = scale + 0.4 * float(np.ptp([actor.offset[1] for actor in actors]))
    camera = server.initial_camera
    camera.fov = 0.6
    camera.look_at = tuple(middle - (0.0, 0.0, 0.12 * scale))
    camera.position = tuple(middle + wide * np.array([1.1, -2.5, 0.95]))
    server.scene.set_up_direction("+z")


def _camera_path(actor: Actor, follow: bool, scale: float) -> Array:
    """(frames, 3) m, horizontal way of the camera; it stays where it is for a character that hardly travels."""
    com = actor.com - actor.offset
    way = com * (1.0, 1.0, 0.0)
    if not follow or np.ptp(way, axis=0).max() < scale or len(way) < 3:
        return np.repeat(way[:1], len(way), axis=0)
    straight = np.linspace(way[0], way[-1], len(way))
    return np.asarray(straight + gaussian_filter1d(way - straight, CALM * RATE, axis=0, mode="nearest"))


class Player:
    """The nodes of one character in the scene."""

    def __init__(self, server: Any, name: str, actor: Actor, color: tuple[int, int, int], forces: bool):
        self.actor = actor
        self.bodies: list[tuple[int, Any]] = []
        self.feet: list[tuple[int, Any]] = []
        scene, scale, character = server.scene, size(actor.character), actor.character
        for b, (body, surface) in enumerate(zip(character.bodies, surfaces(character), strict=True)):
            if surface is not None:
                node = scene.add_mesh_simple(f"{name}/{b}_{_plain(body.name)}", surface.vertices, surface.faces, color=color)
                self.bodies.append((b, node))
        ever = np.asarray(actor.solution.loaded.any(axis=0))
        for c, k in enumerate(character.terrain_contacts):
            contact = character.contacts[k]
            parent = dict(self.bodies).get(contact.body)
            if ever[c] and parent is not None:
                surface = ball(contact.position, max(1.1 * contact.radius, 0.018 * scale))
                node = scene.add_mesh_simple(f"{parent.name}/{_plain(contact.name)}", surface.vertices, surface.faces, color=FOOT)
                self.feet.append((c, node))
        self.length = 0.8 * scale / actor.solution.weight if actor.solution.weight > 0.0 else 0.0  # m/N
        self.arrows: Any = None
        if forces and ever.any():
            radius = 0.01 * scale
            self.arrows = scene.add_arrows(
                f"{name}/forces", self._arrows(0), FORCE, shaft_radius=radius, head_radius=2.5 * radius, head_length=5 * radius
            )

    def _arrows(self, i: int) -> Array:
        """(c, 2, 3) m, start and end of each arrow; one that carries nothing is out of sight."""
        start = self.actor.point[i]
        arrows = np.stack([start, start + self.length * self.actor.force[i]], axis=1)
        arrows[np.flatnonzero(~self.actor.loaded[i])] = [(0.0, 0.0, AWAY), (0.0, 0.0, AWAY - 1.0)]
        return _rounded(arrows)

    def show(self, i: int) -> None:
        for b, node in self.bodies:
            node.wxyz = _rounded(self.actor.rotation[i, b])
            node.position = _rounded(self.actor.origin[i, b])
        for c, node in self.feet:
            color = LOADED_FOOT if self.actor.loaded[i, c] else FOOT
            if tuple(node.color) != color:
                node.color = color
        if self.arrows is not None:
            self.arrows.points = self._arrows(i).astype(np.float32)


def _add_ground(server: Any, name: str, actor: Actor, scale: float) -> None:
    ground = actor.solution.ground
    if not ground:
        return
    x, y, z = ground["x"], ground["y"], ground["z"]
    cell = min((0.05, 0.1, 0.2, 0.25, 0.5, 1.0, 2.0), key=lambda edge: abs(np.log(edge / (0.4 * scale))))
    slope = [float(np.mean(np.diff(z, axis=0))) / (x[1] - x[0]), float(np.mean(np.diff(z, axis=1))) / (y[1] - y[0])]
    plane = z[0, 0] + slope[0] * (x[:, None] - x[0]) + slope[1] * (y - y[0])
    if np.abs(z - plane).max() < 1e-6:
        height = z[0, 0] - slope[0] * x[0] - slope[1] * y[0]
        normal = np.array([-slope[0], -slope[1], 1.0])
        server.scene.add_grid(
            name, infinite_grid=True, cell_size=cell, section_size=5 * cell, cell_color=(205, 208, 212),
            section_color=(160, 166, 174), plane_color=(238, 240, 243), plane_opacity=1.0, shadow_opacity=0.35,
            fade_distance=24.0 * scale, fade_strength=1.6, wxyz=_turn_to(normal), position=actor.offset + (0.0, 0.0, height),
        )  # fmt: skip
        return
    corners = np.stack([*np.broadcast_arrays(x[:, None], y), z], axis=-1)
    index = np.arange(z.size).reshape(z.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)])
    points = corners.reshape(-1, 3) + actor.offset
    server.scene.add_mesh_simple(name, points, faces, color=(226, 229, 233), side="double", cast_shadow=False)
    lines = np.concatenate([np.stack([corners[:-1], corners[1:]], axis=2).reshape(-1, 2, 3),
                            np.stack([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 2, 3)])  # fmt: skip
    raised = lines + actor.offset + (0.0, 0.0, 2e-3 * scale)
    server.scene.add_line_segments(f"{name}_lines", raised, colors=(190, 194, 200), thickness=1.0, thickness_units="screen")


def _turn_to(normal: Array) -> Array:
    """Quaternion that turns the z axis to ``normal`` (3,) about a horizontal axis."""
    n = normal / np.linalg.norm(normal)
    turn = np.array([1.0 + n[2], -n[1], n[0], 0.0])
    return np.asarray(turn / np.linalg.norm(turn))


def _between(values: Array, place: Array) -> Array:
    """Rows of ``values`` at the fractional indices ``place``, linearly; the last one afterwards."""
    index = np.clip(place.astype(int), 0, len(values) - 2)
    share = np.clip(place - index, 0.0, 1.0).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1.0 - share) * values[index] + share * values[index + 1])


def _rounded(values: Array) -> Array:
    return np.asarray(np.round(values / GRAIN) * GRAIN)


def _plain(name: str) -> str:
    """The name without the slash that would begin a new level of the scene."""
    return name.replace("/", "_")


@contextlib.contextmanager
def _server(viser: Any) -> Iterator[Any]:
    """A viser server on a free local port: it is what collects a scene; nobody connects to it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        except ImportError as error:  # viser imports some of what it needs only now
            raise MissingExtraError(f"a moving picture ({error})", "view") from error
    try:
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _write(target: Path, text: str) -> None:
    scratch = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        scratch.write_text(text, encoding="utf-8")
        os.replace(scratch, target)
    except OSError as error:
        with contextlib.suppress(OSError):
            scratch.unlink()
        raise OutputError(f"{target} cannot be written: {error.strerror or error}") from error
