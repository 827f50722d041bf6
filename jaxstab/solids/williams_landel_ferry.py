"""Time-temperature superposition by the law of Williams, Landel and Ferry."""

from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core.checks import (
    concrete,
    nonnegative_parameter,
    numbers,
    parameter,
    positive_parameter,
    possible,
    require,
    require_finite,
    scalar_parameter,
)
from jaxstab.core.compile import own_conventions
from jaxstab.core.display import inline
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import NUMBER, Dimension

_TEMPERATURE = Dimension("temperature")


class WilliamsLandelFerry(eqx.Module):
    """The shift factor a_T of times over the temperature, log10 a_T = -C1 (T - T0) / (C2 + T - T0).

    A relaxation time at T is a_T times the one at the reference temperature T0 (M. L. Williams,
    R. F. Landel and J. D. Ferry, J. Am. Chem. Soc. 77, 3701, 1955). The law describes amorphous
    polymers from their glass transition to some 100 K above. All temperatures are in kelvin or all
    in degrees Celsius: their differences count.

    Arguments:
        c1: C1.
        c2: C2 [temperature].
        reference_temperature: T0 [temperature].

    Raises:
        ValueError: if C1 is negative, C2 not positive, or T0 not finite.
    """

    c1: Annotated[Scalar, NUMBER]
    c2: Annotated[Scalar, _TEMPERATURE]
    reference_temperature: Annotated[Scalar, _TEMPERATURE]

    __repr__ = inline

    def __init__(self, c1: ArrayLike, c2: ArrayLike, reference_temperature: ArrayLike):
        self.c1 = nonnegative_parameter(scalar_parameter(c1, "The constant C1"), "The constant C1")
        self.c2 = positive_parameter(scalar_parameter(c2, "The constant C2"), "The constant C2")
        name = "The reference temperature"
        self.reference_temperature = parameter(scalar_parameter(reference_temperature, name))
        require_finite(name, concrete(self.reference_temperature))

    @own_conventions()
    def factor(self, temperature: ArrayLike) -> Float[Array, "..."]:
        """Return a_T at one temperature or several.

        Raises:
            ValueError: for a temperature at or below T0 - C2, where the law diverges.
        """
        above = self._above(temperature)
        return jnp.exp(-np.log(10.0) * self.c1 * above / (self.c2 + above))

    @own_conventions()
    def referred_to(self, temperature: ArrayLike) -> "WilliamsLandelFerry":
        """Return the same law with another reference temperature, and its constants there.

        Raises:
            ValueError: as `factor`.
        """
        above = self._above(scalar_parameter(temperature, "The temperature"))
        c2 = self.c2 + above
        return WilliamsLandelFerry(self.c1 * self.c2 / c2, c2, self.reference_temperature + above)

    def _above(self, temperature: ArrayLike) -> Float[Array, "..."]:
        """Return how far temperatures are above the reference."""
        above = jnp.asarray(numbers(temperature, "The temperature")) - self.reference_temperature
        is_possible = self.c2 + above > 0
        limit = concrete(self.reference_temperature - self.c2)
        cure = f"the law diverges at {limit}: give one above, best among the measured ones."
        require("The temperature", concrete(temperature), concrete(is_possible), cure)
        return possible(above, is_possible)
