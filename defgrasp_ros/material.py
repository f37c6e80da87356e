"""The material of the object: homogeneous, isotropic, linear elastic, with Coulomb friction on its surface."""

from __future__ import annotations

from dataclasses import dataclass

from defgrasp_ros.checks import require_in_range
from defgrasp_ros.errors import InvalidMaterialError


@dataclass(frozen=True)
class Material:
    """Elasticity, density and friction of the object.

    Args:
        youngs_modulus: Young's modulus E [Pa], in (0, 1e10]: the solver is made for soft and plastic, not for steel.
        poissons_ratio: Poisson's ratio nu [-], in [0, 0.49]; tetrahedra of order 1 lock close to 0.5.
        density: Mass density [kg/m^3], > 0.
        friction_coefficient: Coulomb friction mu [-] against pads and platform, > 0: the target force of a
            grasp, safety factor x m g / mu, does not exist without friction.

    Raises:
        InvalidMaterialError: If a value is outside its range, or not finite.
    """

    youngs_modulus: float = 2e5
    poissons_ratio: float = 0.3
    density: float = 1000.0
    friction_coefficient: float = 0.7

    def __post_init__(self) -> None:
        check = require_in_range
        error = InvalidMaterialError
        check(error, "material.youngs_modulus", self.youngs_modulus, 0.0, 1e10, low_open=True, unit="Pa")
        check(error, "material.poissons_ratio", self.poissons_ratio, 0.0, 0.49)
        check(error, "material.density", self.density, 0.0, 1e6, low_open=True, unit="kg/m^3")
        check(error, "material.friction_coefficient", self.friction_coefficient, 0.0, 10.0, low_open=True)

    @property
    def lame_parameters(self) -> tuple[float, float]:
        """First and second Lame parameter (lambda, mu = shear modulus) [Pa]."""
        e, nu = self.youngs_modulus, self.poissons_ratio
        return e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))
