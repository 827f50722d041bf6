"""Time-temperature superposition: the shift factor of times over the temperature."""

from abc import abstractmethod
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxstab.core.checks import (
    concrete,
    nonnegative_parameter,
    numbers,
    parameter,
    positive_parameter,
    possible,
    require,
    require_finite,
    require_positive,
    scalar_parameter,
)
from jaxstab.core.compile import own_conventions
from jaxstab.core.display import inline
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import NUMBER, Dimension

_TEMPERATURE = Dimension("temperature")
# The molar gas constant, exact in the SI of 2019 [J/mol/K].
_GAS_CONSTANT = 8.31446261815324


class TemperatureShift(eqx.Module):
    """The shift factor a_T over the temperature: a time at T is a_T times the time at T0.

    Example:
        >>> isinstance(js.solids.Arrhenius(50e3, 298.0), js.solids.TemperatureShift)
        True
    """

    __repr__ = inline

    @abstractmethod
    def _logarithm(self, temperature: Array) -> tuple[Array, Bool[Array, "..."], str]:
        """Return ln a_T, where it is defined, and why it is not elsewhere."""

    @abstractmethod
    def _at_reference(self, temperature: Scalar) -> "TemperatureShift":
        """Return the same law with another reference temperature, where it is defined."""

    @own_conventions()
    def factor(self, temperature: ArrayLike) -> Float[Array, "..."]:
        """Return a_T at one temperature or several.

        Raises:
            ValueError: for a temperature at which the law is not defined.
        """
        logarithm, _ = self._shift_where_defined(temperature)
        return jnp.exp(logarithm)

    @own_conventions()
    def referred_to(self, temperature: ArrayLike) -> "TemperatureShift":
        """Return the same law with another reference temperature, and its constants there.

        Raises:
            ValueError: as `factor`.
        """
        _, at = self._shift_where_defined(scalar_parameter(temperature, "The temperature"))
        return self._at_reference(at)

    def _shift_where_defined(self, temperature: ArrayLike) -> tuple[Array, Array]:
        """Return ln a_T and the temperatures, NaN under JAX where it is not defined."""
        given = jnp.asarray(numbers(temperature, "The temperature"))
        logarithm, is_possible, cure = self._logarithm(given)
        require("The temperature", concrete(temperature), concrete(is_possible), cure)
        return possible(logarithm, is_possible), possible(given, is_possible)


class WilliamsLandelFerry(TemperatureShift):
    """The shift factor log10 a_T = -C1 (T - T0) / (C2 + T - T0).

    M. L. Williams, R. F. Landel and J. D. Ferry, J. Am. Chem. Soc. 77, 3701 (1955). The law
    describes amorphous polymers from their glass transition to some 100 K above. All temperatures
    are in kelvin or all in degrees Celsius: their differences count.

    Arguments:
        c1: C1.
        c2: C2 [temperature].
        reference_temperature: T0 [temperature].

    Attributes:
        covariance: of ln C1 and ln C2, if a fit to measured data found them; else None.

    Raises:
        ValueError: if C1 is negative, C2 not positive, or T0 not finite.

    Example:
        >>> shift = js.solids.WilliamsLandelFerry(c1=17.4, c2=51.6, reference_temperature=298.0)
        >>> f"{shift.factor(308.0):.2e}"
        '1.50e-03'
    """

    c1: Annotated[Scalar, NUMBER]
    c2: Annotated[Scalar, _TEMPERATURE]
    reference_temperature: Annotated[Scalar, _TEMPERATURE]
    covariance: Annotated[Float[Array, " two two"] | None, NUMBER] = eqx.field(repr=False)

    def __init__(self, c1: ArrayLike, c2: ArrayLike, reference_temperature: ArrayLike):
        self.c1 = nonnegative_parameter(scalar_parameter(c1, "The constant C1"), "The constant C1")
        self.c2 = positive_parameter(scalar_parameter(c2, "The constant C2"), "The constant C2")
        self.reference_temperature = _reference(reference_temperature)
        self.covariance = None

    def with_covariance(self, covariance: ArrayLike | None) -> "WilliamsLandelFerry":
        """Return the law with the covariance of ln C1 and ln C2."""
        if covariance is not None:
            covariance = parameter(covariance, "The covariance")
        return eqx.tree_at(
            lambda law: law.covariance, self, covariance, is_leaf=lambda x: x is None
        )

    @property
    def errors(self) -> tuple[Scalar, Scalar] | None:
        """Standard errors of C1 and C2 [-, temperature], if a fit found them; else None.

        Over a narrow range of temperatures they are large, though a_T in that range is not.
        """
        if self.covariance is None:
            return None
        relative = jnp.sqrt(jnp.diagonal(self.covariance))
        return self.c1 * relative[0], self.c2 * relative[1]

    def _logarithm(self, temperature: Array) -> tuple[Array, Bool[Array, "..."], str]:
        above = temperature - self.reference_temperature
        limit = concrete(self.reference_temperature - self.c2)
        cure = f"the law diverges at {limit}: give one above, best among the measured ones."
        is_possible = self.c2 + above > 0
        distance = jnp.where(is_possible, self.c2 + above, 1)
        return -np.log(10.0) * self.c1 * above / distance, is_possible, cure

    def _at_reference(self, temperature: Scalar) -> "WilliamsLandelFerry":
        c2 = self.c2 + (temperature - self.reference_temperature)
        moved = WilliamsLandelFerry(self.c1 * self.c2 / c2, c2, temperature)
        if self.covariance is None:
            return moved
        part = self.c2 / c2
        # ln C1 + ln C2 - ln(C2 + T - T0), and ln(C2 + T - T0).
        rows = [jnp.ones_like(part), 1 - part], [jnp.zeros_like(part), part]
        change = jnp.stack([jnp.stack(row) for row in rows])
        return moved.with_covariance(change @ self.covariance @ change.T)


class Arrhenius(TemperatureShift):
    """The shift factor ln a_T = (E_a / R) (1 / T - 1 / T0), R the molar gas constant.

    It describes polymers below their glass transition, and melts far above it.

    Arguments:
        activation_energy: E_a [J/mol].
        reference_temperature: T0 [K]. All temperatures are in kelvin.

    Raises:
        ValueError: if the energy is negative, or T0 not positive.

    Example:
        >>> shift = js.solids.Arrhenius(activation_energy=50e3, reference_temperature=298.0)
        >>> f"{shift.factor(308.0):.3f}"
        '0.519'
    """

    activation_energy: Annotated[Scalar, NUMBER]
    reference_temperature: Annotated[Scalar, _TEMPERATURE]

    def __init__(self, activation_energy: ArrayLike, reference_temperature: ArrayLike):
        name = "The activation energy"
        self.activation_energy = nonnegative_parameter(
            scalar_parameter(activation_energy, name), name
        )
        reference = _reference(reference_temperature)
        self.reference_temperature = positive_parameter(reference, "The reference temperature")

    def _logarithm(self, temperature: Array) -> tuple[Array, Bool[Array, "..."], str]:
        is_possible = temperature > 0
        inverse = 1 / jnp.where(is_possible, temperature, 1) - 1 / self.reference_temperature
        cure = "give it in kelvin, above zero."
        return self.activation_energy / _GAS_CONSTANT * inverse, is_possible, cure

    def _at_reference(self, temperature: Scalar) -> "Arrhenius":
        return Arrhenius(self.activation_energy, temperature)


class ShiftTable(TemperatureShift):
    """Measured shift factors: log a_T is linear between the temperatures of a table.

    Arguments:
        temperatures: two or more, in increasing order [temperature].
        factors: a_T at each. They are divided by the one at the reference temperature.
        reference_temperature: T0, in the range of the table [temperature].

    Raises:
        ValueError: for arrays of different or other shapes, temperatures that do not increase,
            factors that are not positive, and a reference out of the range.

    Example:
        >>> shift = js.solids.ShiftTable([280.0, 300.0, 320.0], [10.0, 1.0, 0.1], 300.0)
        >>> f"{shift.factor(310.0):.3f}"
        '0.316'
    """

    temperatures: Annotated[Float[Array, " entries"], _TEMPERATURE]
    logarithms: Annotated[Float[Array, " entries"], NUMBER]
    reference_temperature: Annotated[Scalar, _TEMPERATURE]

    def __init__(
        self, temperatures: ArrayLike, factors: ArrayLike, reference_temperature: ArrayLike
    ):
        self.temperatures = parameter(temperatures, "The temperatures")
        factors = parameter(factors, "The shift factors")
        if self.temperatures.shape != factors.shape or factors.ndim != 1 or factors.size < 2:
            raise ValueError(
                f"The temperatures have shape {self.temperatures.shape}, the shift factors "
                f"{factors.shape}: give one factor for each of two or more temperatures."
            )
        require_finite("The temperatures", concrete(self.temperatures))
        order = concrete(self.temperatures)
        cure = "the temperatures of a table must increase."
        require("A temperature after the first", order[1:], order[1:] > order[:-1], cure)
        require_positive("A shift factor", factors)
        require_finite("The shift factors", concrete(factors))
        self.logarithms = jnp.log(factors)
        self.reference_temperature = _reference(reference_temperature)
        self._shift_where_defined(self.reference_temperature)

    def _logarithm(self, temperature: Array) -> tuple[Array, Bool[Array, "..."], str]:
        low, high = self.temperatures[0], self.temperatures[-1]
        cure = f"the table is from {concrete(low)} to {concrete(high)}: give one between."
        places = jnp.stack(jnp.broadcast_arrays(temperature, self.reference_temperature))
        at, reference = jnp.interp(places, self.temperatures, self.logarithms)
        return at - reference, (temperature >= low) & (temperature <= high), cure

    def _at_reference(self, temperature: Scalar) -> "ShiftTable":
        return ShiftTable(self.temperatures, jnp.exp(self.logarithms), temperature)


def _reference(temperature: ArrayLike) -> Scalar:
    """Return a checked reference temperature."""
    name = "The reference temperature"
    reference = parameter(scalar_parameter(temperature, name))
    require_finite(name, concrete(reference))
    return reference
