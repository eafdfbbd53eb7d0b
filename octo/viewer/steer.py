"""The page with which a character is steered through a motion graph."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.figure import ARROW, Surface, size, tile
from octo.model.kinematics import body_poses
from octo.model.quantities import Array
from octo.model.skins import Skin, skins
from octo.motion_graph.graph import MotionGraph
from octo.motion_graph.policy import Policy, policy
from octo.result.solution import Solution
from octo.viewer.ground import add_ground
from octo.viewer.page import GRAIN, document, head, legend
from octo.viewer.pieces import Piece, frame_seconds, pieces_of
from octo.viewer.scene import AWAY, FOOT, LOADED_FOOT, add_arrows, add_bodies, add_feet, set_camera

USUAL = {"walk": "ArrowUp", "back": "ArrowDown", "left": "ArrowLeft", "right": "ArrowRight"}
USUAL |= {"jump": " ", "stride_left": "ArrowLeft", "stride_right": "ArrowRight"}
KEYS = {"ArrowUp": "↑", "ArrowLeft": "←", "ArrowRight": "→", "ArrowDown": "↓", " ": "space"}
CARRIED = 2.0**-12  # parts of the weight, to which forces are rounded
MOST = 32767  # of an int16
PRINTS = 80  # marks of feet on the ground, the last ones
PRINT, FADED = (
    (24, 27, 33),
    (150, 153, 158),
)  # colours of the newest and the oldest, of linear light
LIFT = 3e-3  # m above the ground of a mark, beside a character of 1 m
COARSE = 1  # of the shapes: without a graphics card a triangle takes 4 to 9 µs
SKY = 1.6  # light from all around
TILES, PART = 8, 4  # of the plain ground: squares from its middle on, and in a part of a line
LINE = (168, 174, 182)  # colour of its lines in the middle
SCRIPTS = ("viser.js", "controls.js", "walker.js", "steer_stage.js", "steer.js")


def steering(server: Any, graph: MotionGraph, forces: bool, visuals: bool) -> str:
    """The text of the page; ``server``: of viser, whose scene is filled."""
    moves = policy(graph.network, list(graph.motions))
    pieces = pieces_of(graph, moves.edges)
    motion = graph.motions[moves.start[0]]
    robot = motion.character
    if robot is None:
        raise ProblemError("the motions of the graph have no character")
    ever = np.any([piece.force.any(axis=(0, 2)) for piece in pieces], axis=0)
    scene = _scene(server, robot, motion, ever, forces, visuals)
    data: dict[str, Any] = {"frame": frame_seconds(graph), **scene}
    data |= _ways(moves, pieces, list(graph.motions))
    data |= _numbers(pieces, data.pop("shown"), ever, motion.weight)
    data["arrowLength"] = ARROW * size(robot)  # m, of a force that is the weight
    text = str(server.get_scene_serializer().as_html())
    names = ", ".join(moves.motions)
    entries = legend(motion, forces, bool(scene["feet"]))
    lines = ["Choose what it does next: it answers at the next transition."]
    left_out = [name for name in graph.motions if name not in moves.motions]
    if left_out:
        lines.append(f"Left out, as no way leads there and back: {', '.join(left_out)}.")
    body = head(f"{motion.name}: {names}", lines, entries) + _panel()
    return document(text, f"{motion.name}: {names}", body, data, SCRIPTS)


def keys_of(names: Sequence[str]) -> list[str | None]:
    """A key for each motion: the one that its name suggests, else one that is free."""
    keys: dict[str, str] = {}
    for name, key in USUAL.items():
        if name in names and key not in keys.values():
            keys[name] = key
    free = [key for key in KEYS if key not in keys.values()]
    for name in names:
        if name not in keys and free:
            keys[name] = free.pop(0)
    return [keys.get(name) for name in names]


def _scene(
    server: Any,
    robot: Character,
    motion: Solution,
    ever: NDArray[np.bool_],
    forces: bool,
    visuals: bool,
) -> dict[str, Any]:
    """Fill the scene; the names of its nodes. ``ever``: contacts (c,) that carry at some time."""
    scale = size(robot)
    height = float(motion.ground["z"].flat[0]) if motion.ground else 0.0
    rest = motion.com[0] * (0.0, 0.0, 1.0)
    set_camera(server, rest, scale, 1.25 * scale)
    server.scene.add_frame("/world", show_axes=False)
    # in place of the light of a room, which takes a third of the time of a processor that draws
    server.scene.configure_environment_map(None)
    server.scene.add_light_hemisphere("/sky", ground_color=(190, 190, 200), intensity=SKY)
    (ground,) = add_ground(server, "/world/ground", motion, np.zeros(3), scale)
    looks = skins(robot, visuals, fineness=COARSE)
    bodies = add_bodies(server, "/world/robot", [body.name for body in robot.bodies], looks)
    feet = add_feet(server, bodies, robot, ever, COARSE)
    contacts = [robot.contacts[k] for k in robot.terrain_contacts]
    used = np.flatnonzero(ever)
    shown = sorted({robot.base_body, *bodies, *(contacts[c].body for c in used)})
    arrows = "/world/forces" if forces and len(used) else None
    if arrows is not None:
        away = np.array([(0.0, 0.0, AWAY), (0.0, 0.0, AWAY - 1.0)])
        add_arrows(server, arrows, np.repeat(away[None], len(used), axis=0), scale)
    _add_prints(server, "/world/prints", scale)
    plain = _add_plain(server, robot, looks, scale)
    return {
        "shown": shown,
        "bodies": [bodies.get(b) for b in shown],
        "base": shown.index(robot.base_body),
        "contacts": [
            {
                "body": shown.index(contacts[c].body),
                "position": contacts[c].position.tolist(),
                "radius": contacts[c].radius,
                "foot": feet.get(int(c)),
            }
            for c in used
        ],
        "feet": list(feet.values()),
        "arrows": arrows,
        "ground": {"name": ground.name, "height": height, "repeats": 5.0 * tile(scale)},
        "plain": plain,
        "prints": {"name": "/world/prints", "count": PRINTS, "apart": 0.04 * scale},
        "printColor": PRINT,
        "fadedColor": FADED,
        "foot": FOOT,
        "loadedFoot": LOADED_FOOT,
        "away": AWAY,
    }


def _add_prints(server: Any, name: str, scale: float) -> None:
    """Flat marks that the script lays on the ground; until then they are out of sight."""
    angle = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
    disc = _flat(0.03 * scale * np.stack([np.cos(angle), np.sin(angle)], axis=1), LIFT * scale)
    turns, places = (
        np.tile([1.0, 0.0, 0.0, 0.0], (PRINTS, 1)),
        np.tile([0.0, 0.0, AWAY], (PRINTS, 1)),
    )
    server.scene.add_batched_meshes_simple(
        name,
        disc.vertices,
        disc.faces,
        turns,
        places,
        batched_colors=np.tile(np.array(PRINT, dtype=np.uint8), (PRINTS, 1)),
        lod="off",
        cast_shadow=False,
    )


def _flat(points: Array, height: float) -> Surface:
    """The convex hull of points (k, 2) m, seen from above, so many m above the ground."""
    corners = points[ConvexHull(points).vertices]
    around = np.arange(1, len(corners) - 1)
    faces = np.stack([0 * around, around, around + 1], axis=1)
    return Surface(np.hstack([corners, np.full((len(corners), 1), height)]), faces)


def _add_plain(
    server: Any, robot: Character, looks: Sequence[Sequence[Skin]], scale: float
) -> dict[str, Any]:
    """What is shown of the ground where the usual look takes a computer without a graphics card
    too long: lines that fade, and a dark patch below the character in place of shadows."""
    edge = 2.0 * tile(scale)
    _add_lines(server, "/world/lines", edge)
    pose = robot.start_pose
    turns, places = body_poses(robot, pose)
    drawn = [
        skin.surface.vertices @ turns[b].T + places[b]
        for b, own in enumerate(looks)
        for skin in own
    ]
    first, base = robot.base_coordinate, places[robot.base_body, :2]
    c, s = np.cos(pose[first + 3]), np.sin(pose[first + 3])
    below = (np.concatenate(drawn)[:, :2] - base) @ np.array([[c, -s], [s, c]])
    patch = _flat(below, 0.5 * LIFT * scale)
    hidden: dict[str, Any] = {"cast_shadow": False, "receive_shadow": False, "visible": False}
    server.scene.add_mesh_simple(
        "/world/patch", patch.vertices, patch.faces, color=(0, 0, 0), opacity=0.2, **hidden
    )
    return {"lines": "/world/lines", "edge": edge, "patch": "/world/patch"}


def _add_lines(server: Any, name: str, edge: float) -> None:
    """Squares of ``edge`` m, of lines that fade with the distance from the middle. They are few:
    such a computer takes about 0.1 ms for each part of a line."""
    across, along = (edge * np.arange(-TILES, TILES + 1, each) for each in (1, PART))
    nodes = np.stack(np.meshgrid(across, along, [0.0], indexing="ij"), axis=-1)[:, :, 0]
    lines = np.stack([nodes[:, :-1], nodes[:, 1:]], axis=2).reshape(-1, 2, 3)
    lines = np.concatenate([lines, lines[..., [1, 0, 2]]])
    far = np.minimum(np.linalg.norm(lines, axis=-1) / along[-1], 1.0)[..., None]
    colors = ((1.0 - far) * np.array(LINE) + far * 255.0).astype(np.uint8)
    inside = far.min(axis=(1, 2)) < 1.0
    look: dict[str, Any] = {"thickness": 1.2, "thickness_units": "screen", "visible": False}
    server.scene.add_line_segments(name, lines[inside], colors[inside], **look)


def _ways(moves: Policy, pieces: Sequence[Piece], names: Sequence[str]) -> dict[str, Any]:
    """The motions that may be wanted, the ``names`` of all, and which piece follows which node."""
    nodes = sorted({node for edge in moves.edges for node in edge})
    index = {node: k for k, node in enumerate(nodes)}
    number = {(piece.start, piece.stop): k for k, piece in enumerate(pieces)}
    passed = [name for name in names if name not in moves.motions]
    of_motion = {name: k for k, name in enumerate([*moves.motions, *passed])}
    return {
        "motions": [
            {"name": name, "key": key, "word": KEYS.get(key or "")}
            for name, key in zip(moves.motions, keys_of(moves.motions), strict=True)
        ],
        "names": list(of_motion),
        "nodes": [[of_motion[name], step] for name, step in nodes],
        "start": index[moves.start],
        "next": [
            [number[node, moves.following[node][name]] for name in moves.motions] for node in nodes
        ],
        "pieces": [
            {
                "start": index[piece.start],
                "stop": index[piece.stop],
                "crosses": piece.crosses,
                "frames": len(piece.origin),
                "end": [piece.end.yaw, *piece.end.shift.tolist()],
            }
            for piece in pieces
        ],
    }


def _numbers(
    pieces: Sequence[Piece], shown: Sequence[int], ever: NDArray[np.bool_], weight: float
) -> dict[str, Any]:
    """All poses and forces, as int16: of each piece rows of rotations and origins, each but the
    first less the one before, then rows of forces."""
    bodies = list(shown)
    places = [piece.origin[:, bodies] for piece in pieces]
    shares = [piece.force[:, ever] / weight for piece in pieces]  # of the weight
    origin, force = _grain(places, GRAIN), _grain(shares, CARRIED)
    parts: list[NDArray[np.int16]] = []
    for piece, place, share in zip(pieces, places, shares, strict=True):
        turn = piece.rotation[:, bodies].reshape(len(place), -1)
        rows = np.hstack([turn / GRAIN, place.reshape(len(place), -1) / origin])
        rows = np.round(rows).astype(np.int64)
        parts.append(np.diff(rows, axis=0, prepend=0).astype(np.int16).ravel())
        parts.append(np.round(share / force).astype(np.int16).ravel())
    block = gzip.compress(np.concatenate(parts).astype("<i2").tobytes(), compresslevel=9, mtime=0)
    grains = {"rotation": GRAIN, "origin": origin, "force": force}
    return {"grains": grains, "numbers": base64.b64encode(block).decode()}


def _grain(values: Sequence[Array], finest: float) -> float:
    """The finest by which all values are an int16."""
    largest, grain = max(float(np.abs(own).max(initial=0.0)) for own in values), finest
    while largest > MOST * grain:
        grain *= 2.0
    return grain


def _panel() -> str:
    """What the script fills: a button for each motion, and what is going on."""
    return (
        '<section class="octo-panel octo-steer" aria-label="what it does">'
        '<div class="octo-motions" data-octo="motions" role="group" aria-label="motions"></div>'
        '<div class="octo-bar"><div class="octo-now"><b data-octo="now"></b>&ensp;'
        '<span data-octo="next"></span></div><div data-octo="switches"></div>'
        '<div data-octo="speeds"></div></div></section>'
        '<p class="octo-notice" data-octo="notice" role="alert"></p>'
    )
