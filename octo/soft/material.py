"""What a soft body is made of, checked."""

from __future__ import annotations

from dataclasses import dataclass

from octo.checks import number, positive
from octo.errors import ValueRangeError

YOUNG = 1.0, 1e12  # Pa, from below the softest gels to diamond
# where the elements hold: at 0.5 nothing changes its volume, and the stiffness has no limit
POISSON = -0.9, 0.49
DENSITY = 5.0, 3e4  # kg/m³, from foams to the heaviest metals


@dataclass(frozen=True)
class Material:
    """Isotropic and linear.

    Parameters
    ----------
    young: Pa, Young's modulus, 1 to 1e12.
    poisson: Poisson's ratio, −0.9 to 0.49.
    density: kg/m³, 5 to 30000.

    Raises
    ------
    ValueRangeError: one of them is outside.
    """

    young: float
    poisson: float
    density: float

    def __post_init__(self) -> None:
        young = positive("young", self.young, "Pa")
        poisson = number("poisson", self.poisson)
        density = positive("density", self.density, "kg/m³")
        if not YOUNG[0] <= young <= YOUNG[1]:
            range_of = f"from {YOUNG[0]:g} to {YOUNG[1]:g} Pa: foam has 1e4, rubber 1e6"
            raise ValueRangeError(f"young is {young:g} Pa, must be {range_of}")
        if not POISSON[0] <= poisson <= POISSON[1]:
            raise ValueRangeError(
                f"poisson is {poisson:g}, must be from {POISSON[0]:g} to {POISSON[1]:g}: 0.5 would "
                "be incompressible, which these elements are not made for"
            )
        if not DENSITY[0] <= density <= DENSITY[1]:
            range_of = f"from {DENSITY[0]:g} to {DENSITY[1]:g} kg/m³: water has 1000"
            raise ValueRangeError(f"density is {density:g} kg/m³, must be {range_of}")
        for name, value in (("young", young), ("poisson", poisson), ("density", density)):
            object.__setattr__(self, name, value)

    @property
    def lame(self) -> tuple[float, float]:
        """Lamé's λ and μ (Pa)."""
        young, poisson = self.young, self.poisson
        shear = young / (2.0 * (1.0 + poisson))
        return 2.0 * shear * poisson / (1.0 - 2.0 * poisson), shear
