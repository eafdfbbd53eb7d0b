"""A ball and a beam, ready to use."""

from __future__ import annotations

from numpy.typing import ArrayLike

from octo.soft.body import DAMPING, MODES, Body
from octo.soft.shapes import ball_mesh, beam_mesh


def ball(
    radius: float = 0.2,
    modes: int = MODES,
    *,
    young: float = 1e4,
    poisson: float = 0.4,
    density: float = 250.0,
    damping: ArrayLike = DAMPING,
    elasticity: str = "linear",
    divisions: int = 6,
) -> Body:
    """A ball of soft foam: 8.4 kg, ten modes of 7.5 to 8 Hz, 578 points on its surface.

    Parameters
    ----------
    radius: m.
    modes, young, poisson, density, damping, elasticity: as of ``Body.from_mesh``.
    divisions: elements along a radius: 8·divisions³ in all, 16·divisions² + 2 points.

    Raises
    ------
    ValueRangeError: a number out of range. MissingExtraError: the extra ``soft`` is not installed.
    """
    return Body.from_mesh(
        ball_mesh(radius, divisions),
        modes,
        young=young,
        poisson=poisson,
        density=density,
        damping=damping,
        elasticity=elasticity,
    )


def beam(
    length: float = 0.6,
    width: float = 0.1,
    height: float = 0.1,
    modes: int = MODES,
    *,
    young: float = 1e5,
    poisson: float = 0.4,
    density: float = 250.0,
    damping: ArrayLike = DAMPING,
    elasticity: str = "linear",
    divisions: tuple[int, int, int] = (16, 2, 2),
) -> Body:
    """A beam of foam along x: 1.5 kg, ten modes, 546 points on its surface.

    Parameters
    ----------
    length, width, height: m, along x, y and z.
    modes, young, poisson, density, damping, elasticity: as of ``Body.from_mesh``.
    divisions: (3,) blocks along them, of six elements each.

    Raises
    ------
    ValueRangeError: a number out of range. MissingExtraError: the extra ``soft`` is not installed.
    """
    return Body.from_mesh(
        beam_mesh(length, width, height, divisions),
        modes,
        young=young,
        poisson=poisson,
        density=density,
        damping=damping,
        elasticity=elasticity,
    )
