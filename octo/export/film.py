"""A motion as a video: the scene of the stills, frame by frame, before a camera that travels."""

from __future__ import annotations

import contextlib
import importlib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from octo.errors import MissingExtraError, OutputError
from octo.export.moments import frame_times
from octo.export.raster import Pixels, draw
from octo.files import replacing
from octo.model.quantities import Array
from octo.model.skins import skins
from octo.picture import FORCE, SHADOW, Camera, Scene
from octo.result.even import resampled
from octo.result.solution import Solution
from octo.world.sampled import Heights

# pixels of a frame, and ffmpeg's words
KINDS: dict[str, tuple[tuple[int, int], dict[str, Any]]] = {
    ".mp4": ((1280, 720), {"codec": "libx264", "quality": 7, "macro_block_size": 16}),
    ".gif": (
        (640, 360),
        {
            "codec": "gif",
            "pix_fmt_out": "pal8",
            "quality": None,
            "macro_block_size": 1,
            "output_params": [
                "-filter_complex",
                "split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1:dither=none",
            ],
        },
    ),
}
FINER = 2  # pixels drawn for one that is shown, along both sides
CALM = 0.4  # s, over which the motion of the camera is smoothed
FINE = 8000  # triangles of a mesh of the robot's file, about
REACH = 2.6  # in parts of the character's size: the ground around its way
PIECE = 0.15  # of a shape that fades with the distance from the way, in the same parts
TALL = 0.8  # half of the picture's height, in the same parts
ON = 0.01  # how far a shadow is before the shape that it is on


def write_film(motion: Solution, target: Path, fps: float, visuals: bool) -> None:
    """Write ``target`` (.mp4, .gif), one frame at a time; raises as :func:`octo.export` does."""
    ffmpeg = _ffmpeg()
    extent, options = KINDS[target.suffix.lower()]
    count = len(frame_times(motion, fps))
    with replacing(target) as beside:
        film = Film(resampled(motion, 1.0 / fps, count - 1), fps, visuals, extent)
        writer = ffmpeg.write_frames(beside, extent, fps=fps, ffmpeg_log_level="quiet", **options)
        with contextlib.closing(writer):
            writer.send(None)
            for k in range(count):
                writer.send(film.frame(k).tobytes())
        written = ffmpeg.count_frames_and_secs(str(beside))[0] if beside.is_file() else 0
        if written != count:  # a full disk, which ffmpeg keeps to itself
            raise OutputError(
                f"{target} cannot be written: ffmpeg wrote {written} of {count} frames"
            )


def _ffmpeg() -> Any:
    """imageio's wrapper of ffmpeg, where there is one, with what draws."""
    try:
        importlib.import_module("PIL.Image")
        return importlib.import_module("imageio_ffmpeg")
    except ImportError:
        raise MissingExtraError("a video", "export") from None


class Film:
    """Pictures of a motion that has one step a frame."""

    def __init__(self, motion: Solution, fps: float, visuals: bool, extent: tuple[int, int]):
        self.image: Any = importlib.import_module("PIL.Image")
        self.pen: Any = importlib.import_module("PIL.ImageDraw")
        character, scale = motion.character, motion.extent
        assert scale is not None
        self.motion, self.extent = motion, (FINER * extent[0], FINER * extent[1])
        self.depth = np.empty(self.extent[::-1])  # of what is drawn so far
        com = motion.com
        travel = com[-1, :2] - com[0, :2]
        moves = float(np.linalg.norm(travel)) > 0.5 * scale
        heading = float(np.arctan2(*travel[::-1]) if moves else motion.yaw[0])
        self.scene = Scene(Camera.beside(heading), Heights.of(motion.ground), scale, motion.world)
        self.scene.visuals, self.scene.colored, self.scene.reach = visuals, True, REACH * scale
        self.scene.fine = PIECE * scale
        if character is not None:
            self.scene.skins = skins(character, visuals, FINE)
        self.scene.ground_under(com)
        self.look = self.scene.camera.flat(_followed(com, fps, moves, motion.world is not None))
        rise = 0.0 if motion.world is not None else 0.5 * float(np.ptp(com[:, 2]))
        self.grain = 0.5 * self.extent[1] / (TALL * scale + rise)  # pixels in a metre
        tiles = sorted(self.scene.tiles, key=lambda tile: -float(self._away(tile[0].mean(axis=0))))
        self.tiles = np.array([tile for tile, _ in tiles]).reshape(-1, 4, 3)
        self.tints = np.array([color for _, color in tiles]).reshape(-1, 3)
        still = [np.zeros((0, 3, 3)), *(part for part, _ in self.scene.shapes)]
        self.shapes = np.concatenate(still)
        self.stone = np.concatenate([np.zeros((0, 3)), *(tint for _, tint in self.scene.shapes)])

    def frame(self, k: int) -> Pixels:
        """(height, width, 3) at step ``k``."""
        scene = self.scene.empty()
        scene.character(self.motion, k, 1.0, np.zeros(3))
        picture = self.image.new("RGB", self.extent, "white")
        pen = self.pen.Draw(picture)
        self._polygons(pen, k, self.tiles, self.tints)
        shadows = np.concatenate([np.zeros((0, 3, 3)), *scene.shadows])
        bodies = [(np.zeros((0, 3, 3)), np.zeros((0, 3))), *scene.bodies]
        corners, colors = (np.concatenate(part) for part in zip(*bodies, strict=True))
        away = self._away(corners)
        if scene.world is None:
            self._polygons(pen, k, shadows, np.broadcast_to(SHADOW, (len(shadows), 3)))
        else:
            grey = np.broadcast_to(SHADOW, (len(shadows), 3))
            depths = [self._away(self.shapes), self._away(shadows) - ON * scene.scale, away]
            away = np.concatenate(depths)
            corners = np.concatenate([self.shapes, shadows, corners])
            colors = np.concatenate([self.stone, grey, colors])
        drawn: Pixels = np.array(picture)
        self.depth.fill(np.inf)
        draw(drawn, self.depth, self._pixels(corners, k), away, colors, 0.8 * FINER)
        picture = self.image.fromarray(drawn)
        self._arrows(self.pen.Draw(picture), k, scene)
        return np.asarray(picture.reduce(FINER))

    def _away(self, points: Array) -> Array:
        return self.scene.camera.depth(points)

    def _pixels(self, points: Array, k: int) -> Array:
        """(..., 2) right and down, of points (..., 3) m at step ``k``."""
        flat = (self.scene.camera.flat(points) - self.look[k]) * (self.grain, -self.grain)
        return np.asarray(flat + 0.5 * np.array(self.extent))

    def _polygons(self, pen: Any, k: int, corners: Array, colors: Array) -> None:
        """Those in sight, the first ones behind."""
        flat = self._pixels(corners, k)
        seen = ((flat.max(axis=1) > 0.0) & (flat.min(axis=1) < self.extent)).all(axis=1)
        tints = np.round(255.0 * np.clip(colors[seen], 0.0, 1.0)).astype(int)
        for places, tint in zip(flat[seen].tolist(), tints.tolist(), strict=True):
            pen.polygon([tuple(place) for place in places], fill=tuple(tint))

    def _arrows(self, pen: Any, k: int, scene: Scene) -> None:
        """Forces between bodies, in front of all."""
        starts, ways = (np.concatenate(part) for part in zip(*scene.arrows, strict=True))
        red, thick = tuple(np.round(255.0 * FORCE).astype(int).tolist()), 2 * FINER
        for start, end in zip(self._pixels(starts, k), self._pixels(starts + ways, k), strict=True):
            way = end - start
            along = way / max(float(np.linalg.norm(way)), 1e-9)
            head = (
                end - 5 * thick * along + 2 * thick * np.outer((1.0, -1.0), along[::-1] * (-1, 1))
            )
            pen.line([tuple(start), tuple(end - 4 * thick * along)], fill=red, width=thick)
            pen.polygon([tuple(point) for point in (end, *head)], fill=red)


def _followed(com: Array, fps: float, moves: bool, climbs: bool) -> Array:
    """(frames, 3) m, what the camera looks at: the smoothed way of the centre of mass (frames, 3),
    level but over the shapes of a world."""
    if not moves or len(com) < 3:
        middle = 0.5 * (com.min(axis=0) + com.max(axis=0))
        return np.broadcast_to(middle, com.shape)
    straight = np.linspace(com[0], com[-1], len(com))
    way = straight + gaussian_filter1d(com - straight, CALM * fps, axis=0, mode="nearest")
    if not climbs:
        way[:, 2] = 0.5 * (com[:, 2].min() + com[:, 2].max())
    return np.asarray(way)
