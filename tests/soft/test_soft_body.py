"""A reduced soft body: its surface, its rigid entries, what is kept, what is warned of."""

from __future__ import annotations

import dataclasses
import functools
import logging
from pathlib import Path

import numpy as np
import pytest

from octo import soft
from octo.errors import MissingExtraError, ProblemError, ShapeError, UsageError, ValueRangeError
from octo.soft import build

pytest.importorskip("skfem")


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OCTO_CACHE", str(tmp_path / "cache"))


def enclosed(body: soft.Body) -> float:
    """m³ within the triangles of the surface."""
    a, b, c = body.points[body.faces.T]
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize("name", ["ball", "beam"])
def test_the_defaults_have_16_coordinates_and_500_points(name: str) -> None:
    made = getattr(soft, name)()
    assert made.name == name
    assert made.modes.shape == (len(made.points), 10, 3) and len(made.points) >= 500
    assert made.inertia.shape == (34, 34) and made.stiffness.shape == (10, 10)
    assert made.cautions == ()
    sides = np.sort(made.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()  # closed
    assert len(made.points) - len(sides) // 2 + len(made.faces) == 2  # Euler
    assert enclosed(made) == pytest.approx(made.mass / made.density, rel=0.02)
    np.testing.assert_allclose(made.frequencies, np.sqrt(np.diag(made.stiffness)) / (2 * np.pi))


def test_rigid_entries_of_a_box() -> None:
    made = soft.beam(0.6, 0.2, 0.1, modes=6, divisions=(3, 1, 1), density=300.0)
    mass = 300.0 * 0.6 * 0.2 * 0.1
    assert made.mass == pytest.approx(mass, rel=1e-13)
    expected = mass / 12.0 * np.diag([0.36, 0.04, 0.01])
    np.testing.assert_allclose(made.inertia[:3, :3], expected, atol=1e-13)
    assert np.abs(made.inertia[-1, :3]).max() < 1e-14  # the origin is the centre of mass


def test_rigid_entries_of_a_ball() -> None:
    made = soft.ball(0.2, modes=1, divisions=5)
    assert made.mass == pytest.approx(250.0 * 4.0 / 3.0 * np.pi * 0.2**3, rel=1e-3)
    expected = made.mass * 0.04 / 5.0 * np.eye(3)
    np.testing.assert_allclose(made.inertia[:3, :3], expected, atol=1e-3 * expected[0, 0])
    np.testing.assert_allclose(np.linalg.norm(made.points, axis=1), 0.2, rtol=1e-12)


def test_modes_move_neither_the_centre_of_mass_nor_turn_the_body() -> None:
    made, r = soft.ball(divisions=2, modes=7), 7
    assert np.abs(made.inertia[-1, 3:-1]).max() < 1e-12  # ∫ρ φ
    moment = made.inertia[:3, 3:-1].reshape(3, r, 3)  # ∫ρ X φᵀ
    assert np.abs(moment - moment.transpose(2, 1, 0)).max() < 1e-12  # ∫ρ X × φ
    own = np.einsum("iaja->ij", made.inertia[3:-1, 3:-1].reshape(r, 3, r, 3))
    np.testing.assert_allclose(own, np.eye(r), atol=1e-12)


def test_points_of_the_surface_are_nodes_moved_by_the_modes() -> None:
    mesh = soft.beam_mesh(0.6, 0.1, 0.1, (3, 1, 1))
    made = soft.Body.from_mesh(mesh, 3, young=1e5, poisson=0.3, density=250.0)
    model = soft.Model(mesh, 1e5, 0.3, 250.0)
    values, shapes = model.modes(3)
    used, faces = mesh.surface
    np.testing.assert_allclose(np.diag(made.stiffness), values, rtol=1e-12)
    np.testing.assert_allclose(made.points, model.nodes[used] - model.center, atol=1e-15)
    np.testing.assert_array_equal(made.faces, faces)
    z = np.array([0.02, -0.01, 0.03])
    moved = model.nodes - model.center + np.einsum("nrk,r->nk", shapes, z)
    np.testing.assert_allclose(made.deformed(z), moved[used], atol=1e-14)
    with pytest.raises(ShapeError, match="z has shape"):
        made.deformed([0.0])


def test_the_origin_of_the_mesh_does_not_matter() -> None:
    mesh = soft.beam_mesh(0.6, 0.1, 0.1, (3, 1, 1))
    there = soft.Body.from_mesh((mesh.nodes + [1.0, 2.0, 3.0], mesh.cells), 4)
    here = soft.Body.from_mesh(mesh, 4)
    np.testing.assert_allclose(there.points, here.points, atol=1e-12)
    np.testing.assert_allclose(there.inertia, here.inertia, atol=1e-8)
    np.testing.assert_allclose(there.frequencies, here.frequencies, rtol=1e-9)


def test_frequencies_go_with_material_and_size() -> None:
    """ω ∝ √(E/ρ)/L."""
    usual = soft.ball(0.2, 3, divisions=2)
    other = soft.ball(0.4, 3, divisions=2, young=4e4, density=500.0)
    np.testing.assert_allclose(other.frequencies, usual.frequencies / np.sqrt(2.0), rtol=1e-9)


# -- the cache -------------------------------------------------------------------------------------


@pytest.mark.usefixtures("empty_cache")
def test_a_body_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    first = soft.ball(divisions=2, modes=3)

    def refuse(*_: object) -> None:
        raise AssertionError("made again")

    with monkeypatch.context() as patched:
        patched.setattr(build, "Model", refuse)
        again = soft.ball(divisions=2, modes=3, damping=(1.0, 0.0))
        for field in ("points", "modes", "inertia", "stiffness", "faces"):
            np.testing.assert_array_equal(getattr(again, field), getattr(first, field))
        assert again.damping == (1.0, 0.0)
        for changed in ({"young": 2e4}, {"poisson": 0.3}, {"density": 300.0}, {"radius": 0.21}):
            with pytest.raises(AssertionError, match="made again"):
                soft.ball(divisions=2, modes=3, **changed)  # type: ignore[arg-type]


def test_arrays_of_a_body_cannot_be_changed() -> None:
    made = soft.ball(divisions=2, modes=3)
    with pytest.raises(ValueError, match="read-only"):
        made.points[0] = 0.0


# -- bad input -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("young", -1.0, "young is -1.0 Pa, must be positive"),
        ("young", 1e-3, "young is 0.001 Pa, must be from 1 to 1e+12 Pa: foam has 1e4"),
        ("young", 1e13, "young is 1e+13 Pa, must be from 1 to 1e"),
        ("poisson", 0.5, "poisson is 0.5, must be from -0.9 to 0.49: 0.5 would be incompressible"),
        ("poisson", -1.0, "poisson is -1, must be from -0.9"),
        ("density", 1.0, "density is 1 kg/m³, must be from 5 to 30000 kg/m³: water has 1000"),
        ("density", float("nan"), "density is nan kg/m³, must be positive"),
        ("damping", (-1.0, 0.0), "damping is (-1, 0), must be two numbers of at least 0"),
        ("modes", 0, "modes is 0, must be a whole number of at least 1"),
        ("modes", 2.5, "modes is 2.5, must be a whole number"),
        ("modes", 501, "modes is 501, must be at most 500"),
        ("radius", 0.0, "radius is 0.0 m, must be positive"),
        ("divisions", 0, "divisions is 0, must be a whole number of at least 1"),
    ],
)
def test_values_out_of_range(field: str, value: object, words: str) -> None:
    with pytest.raises(ValueRangeError) as caught:
        soft.ball(**{field: value})  # type: ignore[arg-type]
    assert str(caught.value).startswith(words)


def test_more_modes_than_a_mesh_has() -> None:
    with pytest.raises(ValueRangeError, match="modes is 76, must be at most 69: mesh 'ball' has"):
        soft.ball(divisions=1, modes=76)


def test_divisions_of_a_beam_are_three() -> None:
    with pytest.raises(ShapeError, match="divisions has shape"):
        soft.beam(divisions=(2, 2))  # type: ignore[arg-type]
    with pytest.raises(ValueRangeError, match=r"divisions is \(2, 1.5, 1\), must be whole numbers"):
        soft.beam(divisions=(2, 1.5, 1))  # type: ignore[arg-type]


def test_other_things_are_no_mesh() -> None:
    with pytest.raises(ProblemError, match="mesh is 3, must be a file's path"):
        soft.Body.from_mesh(3)
    with pytest.raises(UsageError, match="a Tetrahedra has its own"):
        soft.Body.from_mesh(soft.ball_mesh(0.2, 1), scale=0.001)
    with pytest.raises(ProblemError, match="mesh of a soft model must be a Tetrahedra"):
        soft.Model("ball", 1e5, 0.3, 500.0)  # type: ignore[arg-type]


def test_arrays_of_a_body_must_fit_together() -> None:
    made = soft.ball(divisions=2, modes=3)
    with pytest.raises(ShapeError, match=r"inertia of ball has shape \(3, 3\), expected \(13"):
        dataclasses.replace(made, inertia=np.eye(3))


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "skfem", None)
    with pytest.raises(MissingExtraError, match=r"soft ball or beam needs the extra 'soft': pip"):
        soft.ball()


# -- too soft, too stiff ---------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "divisions"), [("ball", 3), ("beam", (8, 2, 2))])
def test_ten_times_too_soft_or_stiff_is_one_line(
    name: str, divisions: object, caplog: pytest.LogCaptureFixture
) -> None:
    make = functools.partial(getattr(soft, name), divisions=divisions)
    young = make().young
    with caplog.at_level(logging.WARNING, "octo"):
        stiff, floppy = make(young=10.0 * young), make(young=0.1 * young)
    first, second = (record.getMessage() for record in caplog.records)
    assert f"is stiff: its lowest mode has {stiff.frequencies[0]:.3g} Hz, and a step of 25" in first
    assert f"gives by about {1e3 * floppy.sag:.3g} mm under its own weight" in second
    assert "\n" not in first + second


def test_what_a_caution_advises_is_enough() -> None:
    stiff = soft.ball(divisions=2, modes=1, young=1e6)
    young = float(stiff.cautions[0].rpartition("up to ")[2].removesuffix(" Pa"))
    assert not soft.ball(divisions=2, modes=1, young=0.95 * young).cautions
    floppy = soft.ball(divisions=2, modes=1, young=500.0)
    young = float(floppy.cautions[0].partition("young = ")[2].partition(" Pa")[0])
    assert not soft.ball(divisions=2, modes=1, young=1.05 * young).cautions
