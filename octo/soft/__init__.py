"""Soft bodies (§3.3): of any tetrahedral mesh a few modes, a surface and an exact inertia; and how
they move."""

from octo.soft.body import Body
from octo.soft.coordinates import Coordinates
from octo.soft.dynamics import SoftDynamics
from octo.soft.gallery import ball, beam
from octo.soft.model import Model
from octo.soft.read import load_mesh
from octo.soft.shapes import ball_mesh, beam_mesh
from octo.soft.tetrahedra import Tetrahedra

__all__ = [
    "Body",
    "Coordinates",
    "Model",
    "SoftDynamics",
    "Tetrahedra",
    "ball",
    "ball_mesh",
    "beam",
    "beam_mesh",
    "load_mesh",
]
