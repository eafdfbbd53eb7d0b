"""Videos: how many frames, how long each, what they show; and the triangles that they are made
of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio_ffmpeg
import moving
import numpy as np
import pytest
from PIL import Image

import octo
from octo.errors import OutputError
from octo.export.film import Film
from octo.export.raster import draw
from octo.picture import FORCE, NEAR, STONE
from octo.result.even import resampled

SMALL = (160, 96)


def film(motion: Any, frames: int = 2) -> Film:
    fps = (frames - 1) / motion.times[-1]
    return Film(resampled(motion, 1.0 / fps, frames - 1), fps, True, SMALL)


def share(picture: np.ndarray, color: np.ndarray) -> float:
    """Of pixels of about that colour, up to brightness."""
    pixels = picture.reshape(-1, 3) / np.maximum(np.linalg.norm(picture, axis=-1).reshape(-1, 1), 1)
    return float(np.mean(np.linalg.norm(pixels - color / np.linalg.norm(color), axis=1) < 0.12))


def test_an_mp4_has_every_frame(tmp_path: Path) -> None:
    motion = moving.moving(octo.gallery.chain(), steps=16)
    octo.export(motion, tmp_path / "m.mp4", fps=2.5)
    assert [path.name for path in tmp_path.iterdir()] == ["m.mp4"]
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "m.mp4"))
    about = next(reader)
    assert about["source_size"] == (1280, 720) and about["fps"] == 2.5
    pictures = [np.frombuffer(frame, np.uint8).reshape(720, 1280, 3) for frame in reader]
    assert len(pictures) == 2
    assert all(share(picture.astype(float), NEAR) > 0.01 for picture in pictures)
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 50


def test_a_gif_keeps_the_time(tmp_path: Path) -> None:
    octo.export(moving.moving(octo.gallery.chain(), 8, dt=0.0125), tmp_path / "m.gif")
    with Image.open(tmp_path / "m.gif") as gif:
        assert gif.size == (640, 360) and gif.n_frames == 4
        shown = []
        for k in range(gif.n_frames):
            gif.seek(k)
            shown.append(gif.info["duration"])
    assert sum(shown[:3]) == 100  # ms: a frame of 1/30 s is shown 30 or 40


def test_the_camera_travels_with_the_character() -> None:
    motion = moving.moving(octo.gallery.mammal(), steps=20)
    motion.x[:, 0] += np.linspace(0.0, 6.0, 22)
    made = film(motion, 3)
    places = []
    for k in range(3):
        blue = made.frame(k).astype(float)
        mask = (blue[..., 2] > 1.4 * blue[..., 0]) & (blue[..., 2] > 40)
        assert mask.mean() > 0.02
        places.append(np.argwhere(mask).mean(axis=0))
    assert np.ptp(places, axis=0).max() < 25  # pixels, of a way of many pictures
    assert np.ptp(made.look, axis=0)[0] > 5.0  # m


def test_objects_forces_and_the_shapes_of_a_world() -> None:
    scene = film(moving.moving(moving.pushing(), steps=8))
    assert share(scene.frame(1).astype(float), FORCE) > 0.001
    step = octo.shapes.Box((0.6, 2.0, 0.3), position=(0.5, 0.0, 0.0))
    fields = {"world": octo.World([octo.shapes.Ground(), step])}
    over = film(moving.moving(octo.gallery.chain(), 8, **fields)).frame(1).astype(float)
    plain = film(moving.moving(octo.gallery.chain(), 8)).frame(1).astype(float)
    dark = [np.mean(np.abs(p - 255 * STONE * 0.8).max(axis=-1) < 25) for p in (over, plain)]
    assert dark[0] > dark[1] + 0.02


def test_the_nearest_triangle_is_seen() -> None:
    image, depth = np.zeros((40, 60, 3), np.uint8), np.full((40, 60), np.inf)
    square = np.array([[(5, 5), (55, 5), (5, 35)], [(55, 5), (55, 35), (5, 35)]], dtype=float)
    near = np.array([[1.0, 3.0, 1.0], [3.0, 3.0, 1.0]])  # nearer on the left
    red, blue = np.tile([1.0, 0.0, 0.0], (2, 1)), np.tile([0.0, 0.0, 1.0], (2, 1))
    order = [(near, red), (np.full((2, 3), 2.0), blue)]
    for away, color in order:
        draw(image, depth, square, away, color, 1.0)
    again = np.zeros_like(image)
    corners, away = np.concatenate([square, square]), np.concatenate([order[1][0], order[0][0]])
    draw(again, np.full((40, 60), np.inf), corners, away, np.concatenate([blue, red]), 1.0)
    np.testing.assert_array_equal(image, again)  # in any order
    assert (image[5:35, 5:30] == (255, 0, 0)).all() and (image[5:35, 30:55] == (0, 0, 255)).all()
    assert not image[:5].any() and not image[35:].any() and not image[:, 55:].any()
    line = np.array([[(0.0, 20.0), (60.0, 20.0), (60.0, 20.0)]])
    draw(image, depth, line, np.zeros((1, 3)), np.ones((1, 3)), 1.0)
    assert (image[19:21] == 255).all() and (image[[17, 22], 20] == (255, 0, 0)).all()


def test_a_video_that_ffmpeg_cuts_short_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a full disk, of which ffmpeg says nothing."""
    monkeypatch.setattr(imageio_ffmpeg, "count_frames_and_secs", lambda path: (1, 0.1))
    with pytest.raises(OutputError, match=r"ffmpeg wrote 1 of 2 frames"):
        octo.export(moving.moving(octo.gallery.chain(), 2), tmp_path / "m.gif", fps=20.0)
    assert not list(tmp_path.iterdir())
