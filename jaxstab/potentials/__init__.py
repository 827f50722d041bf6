"""Interaction laws: scalar functions of the gap that return an energy per area.

Derivatives are taken by automatic differentiation only, so that a law is one formula. The argument
`surface_energy` of a law is the work of adhesion w: the energy per area that it takes to separate
the surfaces, twice the surface energy gamma of each if they are alike.
"""

from jaxstab.potentials.evaluation import (
    as_module,
    curvature,
    derivatives,
    energy_density,
    slope,
)
from jaxstab.potentials.laws import (
    Capillary,
    CutOff,
    Dugdale,
    Electrostatic,
    Exponential,
    Gaussian,
    LennardJones,
    NoAdhesion,
    Rational,
)
from jaxstab.potentials.sums import Law, Sum
from jaxstab.potentials.varying import Potential as Potential
from jaxstab.potentials.varying import Scaled as Scaled
from jaxstab.potentials.varying import Varying
from jaxstab.potentials.varying import Within as Within

__all__ = [
    "Capillary",
    "CutOff",
    "Dugdale",
    "Electrostatic",
    "Exponential",
    "Gaussian",
    "Law",
    "LennardJones",
    "NoAdhesion",
    "Rational",
    "Sum",
    "Varying",
    "as_module",
    "curvature",
    "derivatives",
    "energy_density",
    "slope",
]


def __dir__() -> list[str]:
    return __all__
