"""Ready-made laws: modules that map one gap to an energy per area."""

from collections.abc import Callable
from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.core.checks import (
    concrete,
    nonnegative_parameter,
    parameter,
    positive_parameter,
    possible,
    require,
    require_one_of,
)
from jaxstab.core.compile import own_conventions
from jaxstab.core.display import inline
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import LENGTH, NUMBER, PRESSURES, SURFACE_ENERGY, Dimension
from jaxstab.potentials.sums import Law

# Of SI, exact [J/(mol K)].
_GAS_CONSTANT = 8.31446261815324


class _RangedLaw(Law):
    """A law with a work of adhesion [energy/area] and a range [length]."""

    surface_energy: Annotated[Scalar, SURFACE_ENERGY]
    length: Annotated[Scalar, LENGTH]

    __repr__ = inline

    def __init__(self, surface_energy: ArrayLike, length: ArrayLike):
        self.surface_energy = nonnegative_parameter(surface_energy, "The surface energy")
        self.length = positive_parameter(length, "The length of the potential")

    def _gap_over_length(self, gap: Scalar) -> Scalar:
        # A product, since a quotient over a field takes longer than the rest of the law.
        return gap * (1 / self.length)


class Exponential(_RangedLaw):
    """f(g) = -w exp(-g / rho) (Rey & Bleyer, eq. 45).

    Arguments:
        surface_energy: w, the work of adhesion [energy/area].
        length: rho, the range [length].

    Raises:
        ValueError: if w is negative or rho is not positive.

    Example:
        >>> f"{js.potentials.Exponential(surface_energy=0.03, length=0.06)(0.06):.5f}"
        '-0.01104'
    """

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy * jnp.exp(-self._gap_over_length(gap))


class Gaussian(_RangedLaw):
    """f(g) = -w exp(-g^2 / (2 rho^2)) (Rey & Bleyer, eq. 46).

    Arguments:
        surface_energy: w, the work of adhesion [energy/area].
        length: rho, the range [length].

    Raises:
        ValueError: if w is negative or rho is not positive.

    Example:
        >>> f"{js.potentials.Gaussian(surface_energy=0.03, length=0.06)(0.06):.5f}"
        '-0.01820'
    """

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy * jnp.exp(-(self._gap_over_length(gap) ** 2) / 2)


class Rational(_RangedLaw):
    """f(g) = -w / (1 + g^2 / rho^2) (Rey & Bleyer, eq. 47), a long-range law.

    Arguments:
        surface_energy: w, the work of adhesion [energy/area].
        length: rho, the range [length].

    Raises:
        ValueError: if w is negative or rho is not positive.

    Example:
        >>> f"{js.potentials.Rational(surface_energy=0.03, length=0.06)(0.06):.3f}"
        '-0.015'
    """

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy / (1 + self._gap_over_length(gap) ** 2)


class Dugdale(_RangedLaw):
    """f' = sigma / (1 + exp((g - rho) / s)): the attraction sigma up to a gap rho, then none.

    The edge of Dugdale's step is smoothed over s; sigma is such that f(0) = -w. Its wall is contact
    itself.

    Arguments:
        surface_energy: w, the work of adhesion [energy/area].
        length: rho, the range [length].
        smoothing: s / rho, over which the attraction falls from 73 to 27 % of sigma.

    Raises:
        ValueError: if w is negative, or rho or the smoothing is not positive.

    Example:
        >>> strip = js.potentials.Dugdale(surface_energy=0.03, length=0.06)
        >>> [f"{x:.3f}" for x in js.potentials.slope(strip, np.array([0.02, 0.2]))]
        ['0.499', '0.000']
    """

    smoothing: Annotated[Scalar, NUMBER]

    def __init__(self, surface_energy: ArrayLike, length: ArrayLike, smoothing: ArrayLike = 0.1):
        super().__init__(surface_energy, length)
        self.smoothing = positive_parameter(smoothing, "The smoothing of the potential")

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy * _remaining_work(self._gap_over_length(gap), self.smoothing)


def _remaining_work(reduced: Scalar, smoothing: Scalar) -> Scalar:
    """Return the remaining work of a constant attraction, from a gap over its range on."""
    edge = 1 / smoothing
    return jax.nn.softplus(edge * (1 - reduced)) / jax.nn.softplus(edge)


class LennardJones(_RangedLaw):
    """f(g) = w / 2 ((z0 / g)^9 - 3 (z0 / g)^3): the 9-3 law between a solid and a wall.

    It has its minimum -w at z0 and repels below, so that no gap closes.

    Arguments:
        surface_energy: w, the work of adhesion [energy/area].
        length: z0, the gap at the minimum [length].

    Raises:
        ValueError: if w or z0 is not positive.

    Example:
        >>> wall = js.potentials.LennardJones(surface_energy=0.03, length=0.06)
        >>> f"{wall(0.06):.3f}"
        '-0.030'
    """

    def __init__(self, surface_energy: ArrayLike, length: ArrayLike):
        energy = positive_parameter(surface_energy, "The surface energy of a law with a core")
        super().__init__(energy, length)

    @classmethod
    @own_conventions()
    def from_hamaker(cls, constant: ArrayLike, equilibrium_distance: ArrayLike) -> "LennardJones":
        """Return the law with the work of adhesion of a Hamaker constant, w = A / (12 pi z0^2).

        It is the van der Waals energy of two half spaces at the distance z0, which is 0.165 nm for
        many solids and liquids (J. N. Israelachvili, Intermolecular and Surface Forces, 2011,
        chapter 13). At long range this law falls as z0^3 / g^3, of a solid and a layer of atoms,
        and not as that energy, A / (12 pi g^2).

        Arguments:
            constant: A, of the two solids across the medium between them [energy].
            equilibrium_distance: z0, the gap at the minimum [length].

        Raises:
            ValueError: if A is not positive, as across a medium in which solids repel each other,
                or z0 is not positive.
        """
        energy = positive_parameter(constant, "The Hamaker constant")
        distance = positive_parameter(equilibrium_distance, "The equilibrium distance")
        # One factor after the other: the square of a distance in metres is small.
        return cls(energy / distance / distance / (12 * np.pi), distance)

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        attraction = 1 / self._gap_over_length(gap) ** 3
        # This form is infinite at zero gap, others are undefined.
        return self.surface_energy / 2 * attraction * (attraction**2 - 3)


class NoAdhesion(Law):
    """f(g) = 0: contact without adhesion.

    Example:
        >>> f"{js.potentials.NoAdhesion()(0.1):.1f}"
        '0.0'
    """

    def __call__(self, gap: Scalar) -> Scalar:
        """Return zero energy per area at any gap [length]."""
        return jnp.zeros_like(gap)


class Electrostatic(Law):
    """f(g) = -eps V^2 / (2 (g + d)): two electrodes at a fixed voltage, a dielectric between them.

    The dielectric keeps the energy finite where the surfaces touch. With d = 0 the law needs a sum
    with a law that has a core, as `LennardJones`.

    Arguments:
        voltage: V [voltage].
        permittivity: eps, of the medium in the gap [energy/(voltage^2 length)]; 8.854e-12 in SI
            units for the vacuum.
        dielectric: d, the thickness of the dielectrics on both electrodes over their relative
            permittivity [length].

    Raises:
        ValueError: if V is not finite, eps not positive, or d negative.

    Example:
        >>> electrodes = js.potentials.Electrostatic(voltage=2.0, permittivity=1.0, dielectric=0.5)
        >>> f"{electrodes(0.5):.1f}"
        '-2.0'
    """

    voltage: Annotated[Scalar, Dimension("voltage")]
    permittivity: Annotated[Scalar, Dimension("energy/(voltage^2 length)")]
    dielectric: Annotated[Scalar, LENGTH]

    __repr__ = inline

    def __init__(self, voltage: ArrayLike, permittivity: ArrayLike, dielectric: ArrayLike = 0.0):
        self.voltage = parameter(voltage)
        self.permittivity = positive_parameter(permittivity, "The permittivity")
        self.dielectric = nonnegative_parameter(dielectric, "The dielectric")
        potential = concrete(self.voltage)
        require("The voltage", potential, abs(potential) < np.inf, "it must be finite.")

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length], the voltage source's work included."""
        distance = gap + self.dielectric
        # In this unit derivatives take no powers of the distance, which would underflow.
        unit = jax.lax.stop_gradient(jnp.where(distance > 0, distance, 1))
        return -self.permittivity / 2 * self.voltage**2 / unit / (distance * (1 / unit))


class Capillary(Law):
    """f' = gamma / r up to a gap 2 r cos(theta), then none: menisci at a fixed humidity.

    The attraction is the Laplace pressure of the liquid, over gaps that its meniscus of radius r
    can bridge. Its work is f(0) = -2 gamma cos(theta). The edge is smoothed as in `Dugdale`.

    Arguments:
        tension: gamma, the surface tension of the liquid [energy/area].
        angle: theta, its contact angle, in radians.
        radius: r, of the meniscus (Kelvin's) [length].
        smoothing: the length over which the attraction falls from 73 to 27 %, over the range.

    Raises:
        ValueError: if gamma is negative, theta not from 0 to below pi / 2, or r or the smoothing is
            not positive.

    Example:
        >>> menisci = js.potentials.Capillary(tension=0.072, angle=0.0, radius=1.0)
        >>> [f"{x:.3f}" for x in js.potentials.slope(menisci, np.array([0.5, 4.0]))]
        ['0.072', '0.000']
    """

    tension: Annotated[Scalar, SURFACE_ENERGY]
    angle: Annotated[Scalar, NUMBER]
    radius: Annotated[Scalar, LENGTH]
    smoothing: Annotated[Scalar, NUMBER]

    __repr__ = inline

    def __init__(
        self,
        tension: ArrayLike,
        angle: ArrayLike,
        radius: ArrayLike,
        smoothing: ArrayLike = 0.1,
    ):
        self.tension = nonnegative_parameter(tension, "The surface tension")
        self.radius = positive_parameter(radius, "The radius of the meniscus")
        self.smoothing = positive_parameter(smoothing, "The smoothing of the potential")
        given = parameter(angle, "The contact angle")
        known = concrete(given)
        wets = (known >= 0) & (known < np.pi / 2)
        cure = "give radians, from 0 to below pi / 2. A liquid of a larger angle does not attract."
        require("The contact angle", known, wets, cure)
        self.angle = possible(given, wets)

    @classmethod
    @own_conventions()
    def at_humidity(
        cls,
        relative_humidity: ArrayLike,
        surface_tension: ArrayLike,
        angle: ArrayLike = 0.0,
        *,
        temperature: ArrayLike = 293.15,
        molar_volume: ArrayLike = 18.05e-6,
        pressure_unit: str = "Pa",
        smoothing: ArrayLike = 0.1,
    ) -> "Capillary":
        """Return the law of menisci in equilibrium with a vapour, r = gamma V / (R T |ln H|).

        This is Kelvin's radius of a meniscus that is curved in one plane, as between surfaces that
        are far wider than their gap: a pressure gamma / r = (R T / V) |ln H| below that of the
        vapour. For water gamma V / (R T) is 0.54 nm at 20 degrees Celsius, so that r is 0.78 nm at
        a humidity of 50 %. Kelvin's equation describes radii down to 4 nm, and condensation also
        below (Q. Yang et al., Nature 588, 250, 2020).

        Arguments:
            relative_humidity: H, the pressure of the vapour over that at saturation, from 0 to 1.
            surface_tension: gamma [energy/area], of water 0.0727 J/m^2 at 20 degrees Celsius
                (IAPWS R1-76, 2014).
            angle: theta, the contact angle, in radians.
            temperature: T [K].
            molar_volume: V of the liquid, by default of water [m^3/mol].
            pressure_unit: the unit of pressure, as in `Contact`; gamma is in it times the unit of
                length. So in MPa and µm the number is that in Pa and m.
            smoothing: as in the law itself.

        Raises:
            ValueError: if H is not between 0 and 1, T or V not positive, the unit unknown, or for
                an argument that the law refuses.
        """
        given = parameter(relative_humidity, "The relative humidity")
        humidity = concrete(given)
        is_vapour = (humidity > 0) & (humidity < 1)
        cure = "give a number between 0 and 1, as 0.5 for 50 %. Saturated vapour floods the gap."
        require("The relative humidity", humidity, is_vapour, cure)
        require_one_of("the unit of pressure", pressure_unit, PRESSURES)
        thermal = _GAS_CONSTANT * positive_parameter(temperature, "The temperature")
        volume = positive_parameter(molar_volume, "The molar volume")
        tension = positive_parameter(surface_tension, "The surface tension")
        suction = thermal / volume / 10.0 ** PRESSURES[pressure_unit]
        logarithm = -jnp.log(possible(given, is_vapour))
        return cls(tension, angle, tension / (suction * logarithm), smoothing)

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        slope = jnp.cos(self.angle)
        reduced = gap * (1 / (2 * self.radius * slope))
        return -2 * self.tension * slope * _remaining_work(reduced, self.smoothing)


class CutOff(Law):
    """S(g) f(g): another law brought smoothly to zero, with S = 1 - 10 x^3 + 15 x^4 - 6 x^5.

    Here x = 2 g / r - 1 runs from 0 to 1 between half of the radius r and the radius. Below, the
    law is as it was, its work of adhesion included; beyond the radius it is zero and is not
    evaluated. Value, slope and curvature are continuous. This is the quintic switching function of
    molecular dynamics (van der Spoel & van Maaren, J. Chem. Theory Comput. 2, 1, 2006).

    Arguments:
        law: f, any law or function of the gap, smooth up to the radius.
        radius: r, the gap beyond which nothing acts [length].

    Raises:
        ValueError: if the law is no function, or r is not positive.

    Example:
        >>> short = js.potentials.CutOff(law, radius=0.3)
        >>> [f"{x:.4f}" for x in js.potentials.energy_density(short, np.array([0.0, 0.3]))]
        ['-0.0300', '-0.0000']
    """

    law: Callable[[Scalar], Scalar]
    radius: Annotated[Scalar, LENGTH]

    __repr__ = inline

    def __init__(self, law: Callable[[Scalar], Scalar], radius: ArrayLike):
        # A class of laws is callable too.
        if not callable(law) or isinstance(law, type):
            raise ValueError(f"The law is {law!r}: give a function of the gap.")
        self.law = law
        self.radius = positive_parameter(radius, "The radius of the cut-off")

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        x = jnp.clip(2 * gap / self.radius - 1, 0, 1)
        switch = 1 - x**3 * (10 - 15 * x + 6 * x**2)
        return switch * self.law(jnp.minimum(gap, self.radius))
