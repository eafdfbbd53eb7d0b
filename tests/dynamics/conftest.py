"""Characters and their dynamics, built once for all tests of the floor."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.model.character import Body, Character, ContactSphere, floating_base
from octo.model.gallery import CHARACTERS
from octo.model.terrain import Plane


@lru_cache
def _gallery(name: str) -> tuple[RobotDynamics, np.ndarray]:
    dynamics = RobotDynamics(CHARACTERS[name]())
    weight = dynamics.character.mass * 9.81
    return dynamics, dynamics.layout.pack(
        **{"contact.w_perp": weight / 1.6e-3, "contact.w_par": weight / 1.6e-4}
    )


@pytest.fixture
def gallery() -> Callable[[str], tuple[RobotDynamics, np.ndarray]]:
    """The dynamics of a character of the gallery, and p with contacts that sink 1 to 2 cm."""
    return _gallery


@lru_cache
def _block_character() -> Character:
    """A flat block of 2 kg on four spheres of 1 cm."""
    corners = [(0.2 * a, 0.1 * b, -0.02) for a in (1, -1) for b in (1, -1)]
    contacts = tuple(
        ContactSphere(f"corner_{k}", 0, np.array(c), 0.01) for k, c in enumerate(corners)
    )
    inertia = 2.0 / 12.0 * np.diag([0.2**2 + 0.06**2, 0.4**2 + 0.06**2, 0.4**2 + 0.2**2])
    return Character(
        "block", (Body("block", -1, floating_base(), mass=2.0, inertia=inertia),), contacts
    )


@pytest.fixture
def block() -> Character:
    return _block_character()


@lru_cache
def _block_dynamics(law: ContactLaw | None, slope: float) -> RobotDynamics:
    return RobotDynamics(_block_character(), law, Plane(slope=slope))


@pytest.fixture
def block_dynamics() -> Callable[..., RobotDynamics]:
    """The dynamics of the block under a contact law on a slope (rad)."""
    return _block_dynamics
