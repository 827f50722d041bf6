"""Interaction laws: scalar functions of the gap that return an energy per area.

Derivatives are taken by automatic differentiation only, so that a law is one formula.
"""

from jaxstab.potentials.composed import Potential as Potential
from jaxstab.potentials.composed import (
    Scaled,
    Varying,
    Within,
    everywhere,
    varying_fields,
    with_fields,
)
from jaxstab.potentials.evaluation import (
    as_module,
    curvature,
    derivatives,
    energy_density,
    slope,
)
from jaxstab.potentials.laws import (
    Dugdale,
    Exponential,
    Gaussian,
    LennardJones,
    NoAdhesion,
    Rational,
)

__all__ = [
    "Dugdale",
    "Exponential",
    "Gaussian",
    "LennardJones",
    "NoAdhesion",
    "Rational",
    "Scaled",
    "Varying",
    "Within",
    "as_module",
    "curvature",
    "derivatives",
    "energy_density",
    "everywhere",
    "slope",
    "varying_fields",
    "with_fields",
]
