"""A reduced soft body: its surface, its modes and its inertia, made once and kept by content."""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from octo.checks import Array, numbers, one_of, whole
from octo.errors import ProblemError, ShapeError, ValueRangeError, said
from octo.model.quantities import GRAVITY
from octo.soft import stvk as law_of
from octo.soft.build import ELASTICITY, kept, solid_of
from octo.soft.material import Material
from octo.world.shape import fixed
from octo.world.spline import Indices

LOG = logging.getLogger("octo")
MODES = 10
YOUNG, POISSON, DENSITY = 1e5, 0.4, 500.0  # Pa, -, kg/m³: soft rubber foam
DAMPING = 0.0, 0.002  # 1/s and s: 5 % of the critical one at 8 Hz
STEP, STEPS = 0.025, 4  # s, of a plan; the fewest of them that show a swing
FAR = 0.05  # of its size: where linear elasticity ends
MOST = 500  # modes


@dataclass(frozen=True, eq=False)
class Body:
    """A soft body that moves by a few of its modes: P(X) = R (X + Φ(X) z) + t.

    ``Body.from_mesh``, ``octo.soft.ball`` and ``octo.soft.beam`` make one.

    Parameters
    ----------
    name: what messages and pictures call it.
    points: (P, 3) m, on the surface, at rest, from the centre of mass.
    faces: (F, 3) triangles of the points, wound with the outside out.
    modes: (P, r, 3) kg^-½, what r modes move the points by. Over the volume ∫ρ φ_i·φ_j is 1 for
        i = j and 0 otherwise.
    inertia: (3r + 4, 3r + 4) ∫ρ Y Yᵀ, of Y = (X, φ_1, …, φ_r, 1), exact for the elements.
    stiffness: (r, r) rad²/s², Λ: the elastic energy is ½ zᵀΛz.
    damping: (alpha, beta) 1/s and s, Rayleigh's: of z it is alpha + beta·Λ.
    young, poisson, density: Pa, –, kg/m³; of what it was made.
    elements, nodes: how many the full model has.
    stvk: (m, m), m = r + r (r + 1)/2, or None: linear elasticity. The elastic energy of St.
        Venant–Kirchhoff is ½ wᵀ(·)w, w = (z, z_i z_j in rows of the upper triangle).

    Raises
    ------
    ShapeError: arrays that do not fit together. ValueRangeError: negative damping.
    """

    name: str
    points: Array
    faces: Indices
    modes: Array
    inertia: Array
    stiffness: Array
    damping: tuple[float, float]
    young: float
    poisson: float
    density: float
    elements: int
    nodes: int
    stvk: Array | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ProblemError(f"name of a soft body is {said(self.name)}, must be a text")
        if np.ndim(self.modes) != 3:
            raise ShapeError(f"modes of {self.name}", np.shape(self.modes), "(P, r, 3)")
        count, r, _ = np.shape(self.modes)
        size = 3 * r + 4
        shapes: dict[str, tuple[int, ...]] = {"points": (count, 3), "modes": (count, r, 3)}
        shapes |= {"inertia": (size, size), "stiffness": (r, r)}
        if self.stvk is not None:
            shapes["stvk"] = (r + r * (r + 1) // 2,) * 2
        for name, shape in shapes.items():
            value = numbers(f"{name} of {self.name}", getattr(self, name), shape)
            object.__setattr__(self, name, fixed(value))
        object.__setattr__(self, "faces", fixed(np.asarray(self.faces, dtype=np.int64)))
        object.__setattr__(self, "damping", _damping(self.damping))

    @classmethod
    def from_mesh(
        cls,
        mesh: Any,
        modes: int = MODES,
        *,
        young: float = YOUNG,
        poisson: float = POISSON,
        density: float = DENSITY,
        damping: ArrayLike = DAMPING,
        elasticity: str = "linear",
        scale: float | None = None,
        edge: float | None = None,
        name: str | None = None,
    ) -> Body:
        """The body of a mesh, from octo's cache where it was made before.

        A body that is too stiff for a step of 25 ms, or so soft that it gives by more than 5 % of
        its size under its own weight, is warned of.

        Parameters
        ----------
        mesh: a file's path (.msh, .vtk and what else meshio reads; .stl, .obj, .ply and .glb, whose
            closed surface TetGen fills), (points, tetrahedra), or an ``octo.soft.Tetrahedra``.
        modes: how many of the lowest ones.
        young: Pa, Young's modulus. poisson: Poisson's ratio, −0.9 to 0.49.
        density: kg/m³.
        damping: (alpha, beta) 1/s and s, Rayleigh's; one of frequency f has the share
            alpha/(4πf) + πf·beta of the critical damping.
        elasticity: "linear", or "stvk", St. Venant–Kirchhoff's, which gets stiffer as it bends.
        scale: metres of what a file or points are in: 0.001 for millimetres.
        edge: m, of the elements that a surface is filled with; a sixth of its longest edge
            without one.
        name: the file's without one.

        Raises
        ------
        ModelError: a mesh that is open, inverted, flat or more than one piece. ValueRangeError: a
            material, a size or a number of modes out of range. RobotFileError: a file that cannot
            be read. MissingExtraError: the extra ``soft``, or ``mesher`` for a surface, is not
            installed.
        """
        material = Material(young, poisson, density)
        rayleigh = _damping(damping)
        count = whole("modes", modes, 1, law_of.MOST if elasticity == "stvk" else MOST)
        law = one_of("elasticity", elasticity, ELASTICITY)
        solid = solid_of(mesh, scale, edge, name)
        made: dict[str, Any] = kept(solid, material, count, law)
        body = cls(
            solid.name,
            faces=solid.surface[1],
            stiffness=np.diag(made.pop("values")),
            damping=rayleigh,
            elements=len(solid.cells),
            nodes=len(solid.nodes),
            **made,
            **asdict(material),
        )
        for line in body.cautions:
            LOG.warning("%s", line)
        return body

    @property
    def mass(self) -> float:
        """kg."""
        return float(self.inertia[-1, -1])

    @property
    def frequencies(self) -> Array:
        """(r,) Hz."""
        return np.asarray(np.sqrt(np.diag(self.stiffness)) / (2.0 * np.pi))

    @property
    def damping_ratios(self) -> Array:
        """(r,) of the critical damping."""
        omega = np.sqrt(np.diag(self.stiffness))
        return np.asarray(0.5 * (self.damping[0] / omega + self.damping[1] * omega))

    @property
    def size(self) -> Array:
        """(3,) m, of a box around it at rest."""
        return np.asarray(np.ptp(self.points, axis=0))

    @property
    def sag(self) -> float:
        """m, about how far it gives under its own weight: g/ω² of its lowest mode."""
        return float(GRAVITY / self.stiffness[0, 0])

    @property
    def cautions(self) -> tuple[str, ...]:
        """What is wrong with its stiffness for a plan, a sentence each; none as a rule."""
        lowest, largest = float(self.frequencies[0]), float(self.size.max())
        highest = 1.0 / (STEPS * STEP)
        found = []
        if lowest > highest:
            young = self.young * (highest / lowest) ** 2
            found.append(
                f"{self.name} is stiff: its lowest mode has {lowest:.3g} Hz, and a step of "
                f"{1e3 * STEP:g} ms shows {highest:g} Hz at most; take a shorter step, or young up "
                f"to {young:.2g} Pa"
            )
        if self.sag > FAR * largest:
            young = self.young * self.sag / (FAR * largest)
            found.append(
                f"{self.name} is soft: its lowest mode has {lowest:.3g} Hz, and it gives by about "
                f"{1e3 * self.sag:.3g} mm under its own weight, {100.0 * self.sag / largest:.0f} % "
                f"of its size; linear elasticity holds to {100.0 * FAR:g} %, from young = "
                f"{young:.2g} Pa on"
            )
        return tuple(found)

    def moved(self, z: Array) -> Array:
        """(…, P, 3) m, what z (…, r) moves the points by."""
        return np.asarray(np.einsum("prk,...r->...pk", self.modes, z))

    def deformed(self, z: ArrayLike) -> Array:
        """The points (P, 3) m in the body's frame, at z.

        Parameters
        ----------
        z: (r,) kg^½ m, of the modes.
        """
        own = numbers("z", z, (self.modes.shape[1],))
        return np.asarray(self.points + self.moved(own))

    def energy(self, z: ArrayLike) -> float:
        """The elastic energy (J) at z.

        Parameters
        ----------
        z: (r,) kg^½ m, of the modes.
        """
        own = numbers("z", z, (self.modes.shape[1],))
        if self.stvk is None:
            return float(0.5 * own @ self.stiffness @ own)
        return law_of.energy(self.stvk, own)

    def elastic_force(self, z: ArrayLike) -> Array:
        """What the elastic energy grows by with each coordinate (r,) at z, N kg^-½.

        Parameters
        ----------
        z: (r,) kg^½ m, of the modes.
        """
        own = numbers("z", z, (self.modes.shape[1],))
        return np.asarray(
            self.stiffness @ own if self.stvk is None else law_of.force(self.stvk, own)
        )

    def elastic_tangent(self, z: ArrayLike) -> Array:
        """What the elastic force grows by with each coordinate (r, r) at z, rad²/s².

        Parameters
        ----------
        z: (r,) kg^½ m, of the modes.
        """
        own = numbers("z", z, (self.modes.shape[1],))
        return self.stiffness if self.stvk is None else law_of.tangent(self.stvk, own)


def _damping(value: ArrayLike) -> tuple[float, float]:
    alpha, beta = (float(entry) for entry in numbers("damping", value, (2,)))
    if alpha < 0.0 or beta < 0.0:
        raise ValueRangeError(
            f"damping is ({alpha:g}, {beta:g}), must be two numbers of at least 0: 1/s of the mass "
            "and s of the stiffness"
        )
    return alpha, beta
