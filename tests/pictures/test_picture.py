"""What a character looks like, and stills of its motion."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import motions
import numpy as np
import pytest
from matplotlib.image import imread
from scipy.spatial import ConvexHull

from octo.errors import ModelError, ValueRangeError
from octo.model.character import Body, Character, ContactSphere, Joint, floating_base
from octo.model.figure import Solid, Surface, hull, size, surfaces
from octo.model.gallery import CHARACTERS
from octo.model.gallery.parts import capsule
from octo.picture import LOADED_FOOT, NEAR, filmstrip


def volume(surface: Surface) -> float:
    """m³, by the divergence theorem: positive only where the triangles look outward."""
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def test_a_hull_is_closed_and_looks_outward() -> None:
    solid = Solid(
        np.array([[0.0, 0.0, -0.1], [0.0, 0.0, 0.1], [0.2, 0.0, 0.0]]), np.array([0.05, 0.05, 0.02])
    )
    surface = hull(solid)
    edges = np.concatenate(
        [surface.faces[:, [0, 1]], surface.faces[:, [1, 2]], surface.faces[:, [2, 0]]]
    )
    forward = {tuple(edge) for edge in edges}
    assert len(forward) == len(edges) and forward == {(b, a) for a, b in forward}
    assert volume(surface) == pytest.approx(ConvexHull(surface.vertices).volume, rel=1e-9)


def test_a_link_without_spheres_is_the_capsule_of_its_inertia() -> None:
    start, end, radius = (0.0, 0.0, 0.1), (0.1, 0.0, -0.2), 0.03
    mass, com, inertia = capsule(start, end, radius)
    character = Character(
        "stick", (Body("link", -1, floating_base(), mass=mass, com=com, inertia=inertia),)
    )
    (surface,) = surfaces(character, fineness=3)
    assert surface is not None
    assert volume(surface) == pytest.approx(mass, rel=0.02)
    along = surface.vertices - np.array(start)
    axis = (np.array(end) - start) / np.linalg.norm(np.array(end) - start)
    away = np.linalg.norm(along - np.outer(np.clip(along @ axis, 0.0, np.sqrt(0.1)), axis), axis=1)
    assert away.max() <= radius * (1 + 1e-9) and away.min() > 0.98 * radius


def massless() -> Character:
    """A plate, a massless link and a tip: what robot files contain."""
    plate = Body("plate", -1, floating_base(), mass=1.0, inertia=np.diag([0.002, 0.002, 0.004]))
    turn = Joint("turn", "hinge", np.array([0.0, 0.0, 1.0]))
    slide = Joint("slide", "slide", np.array([1.0, 0.0, 0.0]))
    link = Body("link", 0, (turn,), position=np.array([0.1, 0.0, 0.0]))
    tip = Body("tip", 1, (slide,), position=np.array([0.3, 0.0, 0.0]), mass=0.1)
    contacts = (
        ContactSphere("point", 2, np.zeros(3), 0.0),
        ContactSphere("foot", 2, np.array([0.05, 0.0, 0.0]), 0.02),
    )
    return Character("massless", (plate, link, tip), contacts)


@pytest.mark.parametrize("make", [*CHARACTERS.values(), massless], ids=[*CHARACTERS, "massless"])
def test_every_body_is_drawn_in_proportion(make) -> None:  # noqa: ANN001
    character = make()
    for surface, body in zip(surfaces(character), character.bodies, strict=True):
        assert surface is not None and np.isfinite(surface.vertices).all(), body.name
        assert np.abs(surface.vertices).max() < size(character), body.name
        assert volume(surface) > 0.0


def near(image: np.ndarray, color: np.ndarray, within: float = 0.12) -> float:
    """Share of pixels of about that colour, up to brightness."""
    pixels = image[..., :3].reshape(-1, 3)
    direction = pixels / np.maximum(np.linalg.norm(pixels, axis=1, keepdims=True), 1e-9)
    return float(
        np.mean(np.linalg.norm(direction - color / np.linalg.norm(color), axis=1) < within)
    )


@pytest.mark.parametrize("hills", [0.0, 0.05])
@pytest.mark.parametrize("name", ["mammal", "humanoid"])
def test_a_filmstrip_shows_bodies_and_feet(name: str, hills: float, tmp_path: Path) -> None:
    path = tmp_path / "strip.png"
    filmstrip(motions.wandering(CHARACTERS[name](), steps=60, hills=hills), path, moments=3)
    image = imread(path)
    assert image.shape[1] > image.shape[0]
    assert near(image, NEAR) > 0.02 and near(image, LOADED_FOOT, 0.2) > 0.0005


def test_moments_of_a_character_that_stays_are_side_by_side(tmp_path: Path) -> None:
    solution = motions.wandering(CHARACTERS["mammal"]())
    still = dataclasses.replace(solution, x=np.repeat(solution.x[:1], len(solution.x), axis=0))
    figure = filmstrip(still, moments=5, between=(0.2, 0.8))
    assert figure.get_figwidth() > 2.0 * figure.get_figheight()


def test_one_step_and_one_moment(tmp_path: Path) -> None:
    filmstrip(motions.wandering(CHARACTERS["chain"](), steps=1), tmp_path / "one.png", moments=1)


def test_what_is_refused() -> None:
    with pytest.raises(ModelError, match="user-written"):
        filmstrip(motions.custom())
    solution = motions.wandering(CHARACTERS["chain"]())
    with pytest.raises(ValueRangeError, match="moments is 0"):
        filmstrip(solution, moments=0)
    with pytest.raises(ValueRangeError, match="from 0 to 1 s"):
        filmstrip(solution, between=(0.5, 2.0))
