"""The constants of isotropic elasticity, with their checks."""

from jaxstab.core.checks import concrete, possible, require, require_positive, scalar_parameter
from jaxstab.core.types import ArrayLike, Scalar


def elastic_constants(
    youngs_modulus: ArrayLike, poisson_ratio: ArrayLike, where: str = ""
) -> tuple[Scalar, Scalar]:
    """Return E and nu as arrays, checked; `where` ends their names in errors."""
    modulus_name = f"Young's modulus{where}"
    ratio_name = f"Poisson's ratio{where}"
    modulus = scalar_parameter(youngs_modulus, modulus_name)
    ratio = scalar_parameter(poisson_ratio, ratio_name)
    require_positive(modulus_name, modulus)
    nu = concrete(ratio)
    require(ratio_name, nu, (nu > -1) & (nu <= 0.5), "it must lie in (-1, 0.5].")
    return modulus, ratio


def possible_ratio(poisson_ratio: Scalar) -> Scalar:
    """Return nu; NaN where it is traced and outside (-1, 0.5]."""
    return possible(poisson_ratio, (poisson_ratio > -1) & (poisson_ratio <= 0.5))


def contact_modulus(youngs_modulus: Scalar, poisson_ratio: Scalar) -> Scalar:
    """Return E* = E / (1 - nu^2) [pressure]."""
    return youngs_modulus / (1 - possible_ratio(poisson_ratio) ** 2)


def shear_modulus(youngs_modulus: Scalar, poisson_ratio: Scalar) -> Scalar:
    """Return G = E / (2 (1 + nu)) [pressure]."""
    return youngs_modulus / (2 * (1 + possible_ratio(poisson_ratio)))
