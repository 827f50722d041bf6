"""Linear viscoelastic solids: a Prony series on an elastic solid."""

from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.core.checks import (
    concrete,
    parameter,
    possible,
    require,
    require_known,
    require_positive,
    scalar_parameter,
)
from jaxstab.core.compile import own_conventions
from jaxstab.core.types import ArrayLike, Flag, Scalar
from jaxstab.core.units import NUMBER, TIME
from jaxstab.solids.half_space import HalfSpace
from jaxstab.solids.layered import Layer
from jaxstab.solids.master_curve import fit_series
from jaxstab.solids.prony_fit import relaxation_of
from jaxstab.solids.relaxation_data import CREEP, OSCILLATION, RELAXATION, Kind, read_data
from jaxstab.solids.solid import Solid
from jaxstab.solids.temperature_shift import TemperatureShift


def _of_relaxed(name: str) -> Any:
    """Return a property that forwards to the relaxed solid."""
    return property(lambda self: getattr(self.solid, name), doc=f"`{name}` of the relaxed solid.")


class Viscoelastic(Solid):
    """A solid whose stress relaxes, all waves alike: K(t) = K (1 + sum r_k exp(-t / t_k)).

    K is the stiffness of the relaxed solid, r_k = E_k / E_relaxed, t_k the relaxation times: a
    generalised Maxwell (Wiechert) solid of constant Poisson's ratio. Functions without time,
    such as `equilibrate` and `follow`, use the relaxed solid; `jaxstab.evolve` follows it in time.

    Arguments:
        solid: the relaxed solid, with the long-time modulus.
        ratios: r_k >= 0, one for each relaxation time.
        times: t_k > 0, in increasing order [time].
        shift: of the times over the temperature, for `at_temperature`; None if it is not known.

    Attributes:
        fit_error: the error of a fit to measured data, if one made the solid; else None.
        relaxed_error: how far the relaxed modulus of the fit may be off, relative to itself; else
            None.

    Raises:
        TypeError: for a solid that is not elastic.
        ValueError: for ratios and times of different numbers or none, a negative ratio, and times
            that are not positive or not in increasing order.

    Example:
        >>> rubber = js.Viscoelastic(solid, ratios=(1.0, 0.5), times=(0.1, 2.0))
        >>> f"{rubber.glassy.max_stiffness / rubber.relaxed.max_stiffness:.1f}"
        '2.5'
    """

    solid: Solid
    ratios: Annotated[Float[Array, " terms"], NUMBER]
    times: Annotated[Float[Array, " terms"], TIME]
    fit_error: Annotated[Scalar | None, NUMBER] = None
    relaxed_error: Annotated[Scalar | None, NUMBER] = None
    shift: TemperatureShift | None = None

    def __init__(
        self,
        solid: Solid,
        ratios: ArrayLike,
        times: ArrayLike,
        shift: TemperatureShift | None = None,
    ):
        _require_elastic("The relaxed solid", solid)
        self.solid = solid
        self.shift = shift
        self.fit_error = None
        self.relaxed_error = None
        self.ratios = jnp.atleast_1d(parameter(ratios, "The ratios"))
        self.times = jnp.atleast_1d(parameter(times, "The relaxation times"))
        if self.ratios.ndim != 1 or self.ratios.shape != self.times.shape or not self.ratios.size:
            raise ValueError(
                f"The ratios have shape {self.ratios.shape}, the relaxation times "
                f"{self.times.shape}: give one ratio for each of one or more times."
            )
        given = concrete(self.ratios)
        order = concrete(self.times)
        is_ratio = (given >= 0) & (given < np.inf)
        require("A ratio of moduli", given, is_ratio, "it must be finite and not negative.")
        require_positive("A relaxation time", self.times)
        is_sorted = order[1:] > order[:-1]
        require("The relaxation time", order, is_sorted.all(), "sort them, each once.")
        self.ratios = possible(self.ratios, is_ratio)
        self.times = possible(self.times, (order > 0).all() & is_sorted.all())

    @classmethod
    def from_moduli(cls, glassy: Solid, fractions: ArrayLike, times: ArrayLike) -> "Viscoelastic":
        """Return the solid of an instantaneous modulus and a normalised Prony series.

        E(t) = E_0 (1 - sum g_k (1 - exp(-t / t_k))), as finite-element programs take it.

        Arguments:
            glassy: the solid with the instantaneous modulus E_0.
            fractions: g_k, whose sum is below one.
            times: t_k, in increasing order [time].

        Raises:
            TypeError: for a solid that is not elastic.
            ValueError: if the fractions add up to one or more: nothing would be left at long times.
        """
        _require_elastic("The glassy solid", glassy)
        given = jnp.atleast_1d(parameter(fractions, "The fractions"))
        left = 1 - jnp.sum(given)
        cure = "it is negative or zero: the fractions must add up to less than one."
        require("The relaxed part of the modulus", concrete(left), concrete(left) > 0, cure)
        left = possible(left, concrete(left) > 0)
        if isinstance(glassy, HalfSpace | Layer):
            # Its moduli are still known, as a conductance needs.
            modulus = left * glassy.youngs_modulus
            relaxed = eqx.tree_at(lambda solid: solid.youngs_modulus, glassy, modulus)
        else:
            relaxed = glassy.scaled(left)
        return cls(relaxed, given / left, times)

    @classmethod
    def from_storage_and_loss(
        cls,
        solid: Solid,
        frequencies: ArrayLike,
        storage: ArrayLike,
        loss: ArrayLike,
        temperatures: ArrayLike | None = None,
        *,
        reference_temperature: ArrayLike | None = None,
        shift: TemperatureShift | None = None,
    ) -> "Viscoelastic":
        """Fit a Prony series with non-negative moduli to a measured storage and loss modulus.

        Least squares of (E - E_measured) / |E_measured|, E = E' + i E'', over all frequencies, with
        E(w) = E_relaxed + sum E_k i w t_k / (1 + i w t_k) and E_relaxed, E_k >= 0 (SciPy's `nnls`;
        M. Baumgaertel and H. H. Winter, Rheol. Acta 28, 511 (1989), for the fit of moduli relative
        to the measured ones). Candidates are ten times t_k for each factor of ten, from 1 / w of
        the highest frequency to 1 / w of the lowest; those without a modulus are left out.
        `fit_error` of the result is the largest |E - E_measured| / |E_measured| in the band.

        Outside of the band the series is an extrapolation. Its relaxed modulus is that of the
        lowest frequencies, and may be the one of any series with times up to ten times the longest
        that fits the data as well, to two errors of their noise: the largest distance to it,
        relative, is `relaxed_error`. A liquid, which has none, is fitted with a relaxed modulus of
        a hundredth of the smallest measured one, so that its slowest terms flow.

        With temperatures the times are those at the reference temperature, and `shift` is the law
        of Williams, Landel and Ferry with which one series fits the data at all temperatures best,
        E(w, T) = E(a_T w, T0) (time-temperature superposition), unless one is given. Moduli
        themselves are taken to change with the frequency alone. `shift.errors` are the standard
        errors of C1 and C2.

        Frequencies that repeat at a temperature are averaged. Values that are negative by up to a
        tenth of the largest are noise, and left out with those that are no larger.

        Arguments:
            solid: gives the kind of solid and Poisson's ratio; its Young's modulus becomes the
                relaxed one.
            frequencies: w, angular, in any order [1/time].
            storage: E' at each frequency, of Young's modulus [pressure]. Shear moduli are to be
                multiplied by 2 (1 + nu).
            loss: E'' at each frequency [pressure].
            temperatures: T at which each was measured, three different ones or more unless a
                shift is given, in kelvin or in degrees Celsius; by default all are measured at one.
            reference_temperature: T0, by default the one of a given shift, otherwise the middle one
                of the different temperatures.
            shift: a known shift factor of times over the temperature, as a
                `jaxstab.solids.Arrhenius` or a `jaxstab.solids.ShiftTable`.

        Warns:
            RelaxationWarning: of values that are averaged or left out, of data without a plateau at
                the lowest frequencies, of constants C1 and C2 that the temperatures do not
                determine, and of curves that they do not join to 0.3 decades.

        Raises:
            TypeError: for a solid without a single Young's modulus, and under a JAX transformation:
                the number of terms depends on the data.
            ValueError: for arrays of other or different shapes, numbers that are not finite,
                frequencies that are not positive, storage and loss moduli that are negative but for
                noise, and data without any loss; for one or two temperatures, neighbouring ones at
                which no storage modulus is the same, and moduli that do not fall on heating.
        """
        law = temperatures, reference_temperature, shift
        return cls._fit(OSCILLATION, solid, frequencies, (storage, loss), *law)

    @classmethod
    def from_relaxation(
        cls,
        solid: Solid,
        times: ArrayLike,
        moduli: ArrayLike,
        temperatures: ArrayLike | None = None,
        *,
        reference_temperature: ArrayLike | None = None,
        shift: TemperatureShift | None = None,
    ) -> "Viscoelastic":
        """Fit a Prony series with non-negative moduli to a measured relaxation modulus.

        E(t) = E_relaxed + sum E_k exp(-t / t_k) is the stress at a time after a step of the strain,
        over that strain. Fit, errors, liquids, noise and temperatures are as in
        `from_storage_and_loss`, with candidates for t_k from the shortest time of the data to the
        longest. Values at the time 0 are left out.

        Arguments:
            solid: as in `from_storage_and_loss`.
            times: t after the step, in any order [time].
            moduli: E at each time, of Young's modulus [pressure].
            temperatures, reference_temperature, shift: as in `from_storage_and_loss`.

        Warns, raises:
            As `from_storage_and_loss`.
        """
        law = temperatures, reference_temperature, shift
        return cls._fit(RELAXATION, solid, times, (moduli,), *law)

    @classmethod
    def from_creep(
        cls,
        solid: Solid,
        times: ArrayLike,
        compliances: ArrayLike,
        temperatures: ArrayLike | None = None,
        *,
        reference_temperature: ArrayLike | None = None,
        shift: TemperatureShift | None = None,
    ) -> "Viscoelastic":
        """Fit a Prony series to a measured creep compliance.

        J(t) = J_0 + sum J_k (1 - exp(-t / tau_k)) is the strain at a time after a step of the
        stress, over that stress. It is fitted with J_0, J_k >= 0 as a modulus is in
        `from_storage_and_loss`, with candidates for the retardation times tau_k from the shortest
        time of the data to the longest. The Prony series with this creep follows exactly: it has as
        many terms, and the relaxed modulus 1 / (J_0 + sum J_k). `fit_error` is the error of J. The
        compliance of a liquid goes on to rise steadily: a term of a hundred times the longest time.

        Arguments:
            solid: as in `from_storage_and_loss`.
            times: t after the step, in any order [time].
            compliances: J at each time, of Young's modulus [1/pressure].
            temperatures, reference_temperature, shift: as in `from_storage_and_loss`.

        Warns, raises:
            As `from_storage_and_loss`; the fit must have a compliance at once.
        """
        law = temperatures, reference_temperature, shift
        return cls._fit(CREEP, solid, times, (compliances,), *law)

    @classmethod
    def _fit(
        cls,
        kind: Kind,
        solid: Solid,
        arguments: ArrayLike,
        values: tuple[ArrayLike, ...],
        temperatures: ArrayLike | None,
        reference: ArrayLike | None,
        shift: TemperatureShift | None,
    ) -> "Viscoelastic":
        """Return the solid with the series that fits measured data best."""
        _require_elastic("The solid", solid)
        if not hasattr(solid, "youngs_modulus"):
            raise TypeError(
                f"The solid is a {type(solid).__name__}, without one Young's modulus to replace: "
                "give a HalfSpace, a FreeHalfSpace or a Layer."
            )
        given = arguments, values, temperatures, reference, shift
        require_known(given, "The fit of a Prony series")
        series = fit_series(read_data(kind, arguments, values, temperatures), reference, shift)
        relaxed, moduli, times = relaxation_of(kind, series)
        relaxed_solid = eqx.tree_at(lambda solid: solid.youngs_modulus, solid, parameter(relaxed))
        found = cls(relaxed_solid, moduli / relaxed, times, series.shift)
        return eqx.tree_at(
            lambda solid: (solid.fit_error, solid.relaxed_error),
            found,
            (parameter(series.error), parameter(series.relaxed_error)),
            is_leaf=lambda x: x is None,
        )

    def at_temperature(self, temperature: ArrayLike) -> "Viscoelastic":
        """Return the solid at another temperature, with its times multiplied by a_T of `shift`.

        Arguments:
            temperature: T, in the unit of the reference temperature of `shift`.

        Raises:
            ValueError: without a `shift`, and for a temperature at which it is not defined.
        """
        if self.shift is None:
            raise ValueError(
                "The solid has no shift of its times over the temperature: give it as `shift`, as "
                "a jaxstab.solids.WilliamsLandelFerry, or fit the solid to data at three or more."
            )
        times = self.times * self.shift.factor(temperature)
        shift = self.shift.referred_to(temperature)
        return eqx.tree_at(lambda solid: (solid.times, solid.shift), self, (times, shift))

    @classmethod
    def power_law(
        cls,
        solid: Solid,
        ratio: ArrayLike,
        exponent: ArrayLike,
        time: ArrayLike,
        *,
        decades: float = 8.0,
        terms_per_decade: int = 2,
    ) -> tuple["Viscoelastic", Scalar]:
        """Return a modified power law as a Prony series, and the error of the series.

        E(t) = E_relaxed (1 + r (1 + t / t_0)^-n) (Williams, 1964), a rubber with a broad band of
        relaxation times. The series is the trapezoidal rule for its spectrum, of Gamma's integral
        (1 + x)^-n = int u^(n - 1) exp(-u (1 + x)) du / Gamma(n), with u = t_0 / t_k.

        Arguments:
            solid: the relaxed solid.
            ratio: r, so that E_glassy = (1 + r) E_relaxed.
            exponent: n > 0.
            time: t_0 > 0 [time].
            decades: the range of times from t_0 on in which the series holds.
            terms_per_decade: the number of terms for each factor of ten.

        Returns:
            The solid, and the largest error of E(t) / E_glassy over the range.
        """
        ratio = scalar_parameter(ratio, "The ratio")
        n = scalar_parameter(exponent, "The exponent")
        t_0 = scalar_parameter(time, "The time")
        require_positive("The exponent", n)
        require_positive("The time", t_0)
        require_positive("The number of decades", parameter(decades))
        require_positive("The number of terms per decade", parameter(terms_per_decade))
        step = np.log(10) / terms_per_decade
        # Times range from below t_0, where exp(-u) cuts the spectrum off, to beyond `decades`.
        logs = np.arange(-np.log(40), (decades + 1) * np.log(10), step)
        u = np.exp(-logs)
        weights = jnp.exp(n * jnp.log(u) - u)
        # Longer times relax beyond the range; weights add up to the law's value at t = 0.
        weights = weights / jnp.sum(weights)
        found = cls(solid, ratio * weights, t_0 * np.exp(logs))
        x = np.concatenate([[0.0], np.logspace(-2, decades, 40 * int(decades + 2))])
        series = jnp.exp(-np.outer(x, u)) @ weights
        return found, jnp.max(jnp.abs(series - (1 + x) ** -n)) * ratio / (1 + ratio)

    @property
    def relaxed(self) -> Solid:
        """The elastic solid after all times."""
        return self.solid

    @property
    def glassy(self) -> Solid:
        """The elastic solid at once: K (1 + sum r_k)."""
        return self.step(0.0)

    def step(self, dt: ArrayLike) -> Solid:
        """Return the elastic solid of a time step: K (1 + sum r_k b_k), with b_k of `ramp`."""
        require("A time step", concrete(dt), concrete(dt) >= 0, "it must not be negative.")
        return self.solid.scaled(self.stiffening(dt))

    @property
    @own_conventions()
    def springs(self) -> tuple[Array, Array]:
        """r_k and t_k of all springs in parallel, first of the relaxed one: 1 and infinity."""
        ratios = jnp.pad(self.ratios, (1, 0), constant_values=1)
        return ratios, jnp.pad(self.times, (1, 0), constant_values=jnp.inf)

    def stiffening(self, dt: ArrayLike) -> Scalar:
        """Return the sum of r_k b_k: the stiffness that a time step meets, over the relaxed one."""
        ratios, times = self.springs
        return jnp.sum(ratios * ramp(jnp.asarray(dt) / times))

    @own_conventions()
    def storage_and_loss(self, frequency: ArrayLike) -> tuple[Array, Array]:
        """Return the storage and the loss modulus at an angular frequency, over the relaxed one.

        E'/E = 1 + sum r_k (w t_k)^2 / (1 + (w t_k)^2), E''/E = sum r_k w t_k / (1 + (w t_k)^2).

        Arguments:
            frequency: w [1/time], one or an array.
        """
        turns = jnp.asarray(frequency)[..., None] * self.times
        # The square of w t_k may overflow.
        length = jnp.hypot(1, turns)
        part = self.ratios * (turns / length)
        return 1 + jnp.sum(part * (turns / length), axis=-1), jnp.sum(part / length, axis=-1)

    def scaled(self, factor: Scalar) -> "Viscoelastic":
        """Return this solid with its stiffness times a factor."""
        return eqx.tree_at(lambda s: s.solid, self, self.solid.scaled(factor))

    @property
    def padded(self) -> "Viscoelastic":
        """The solid on the grid of the computation."""
        padded = self.solid.padded
        if padded is self.solid:
            return self
        return eqx.tree_at(lambda s: s.solid, self, padded)

    @property
    def prepared(self) -> "Viscoelastic":
        """This solid with all stiffnesses computed that do not change."""
        return eqx.tree_at(lambda s: s.solid, self, self.solid.prepared)

    @property
    def is_valid(self) -> Flag:
        """Whether the relaxed solid and the series are valid."""
        is_series = jnp.all((self.ratios >= 0) & jnp.isfinite(self.ratios) & (self.times > 0))
        return self.solid.is_valid & is_series

    # Functions without time use the relaxed solid.
    grid = _of_relaxed("grid")
    is_window = _of_relaxed("is_window")
    is_padded = _of_relaxed("is_padded")
    punch = _of_relaxed("punch")  # pyright: ignore
    area = _of_relaxed("area")  # pyright: ignore
    mean_over_grid = _of_relaxed("mean_over_grid")
    max_stiffness = _of_relaxed("max_stiffness")
    min_stiffness = _of_relaxed("min_stiffness")
    uniform_stiffness = _of_relaxed("uniform_stiffness")  # pyright: ignore
    apply = _of_relaxed("apply")
    precondition = _of_relaxed("precondition")
    surface = _of_relaxed("surface")
    conforming = _of_relaxed("conforming")
    conforming_energy = _of_relaxed("conforming_energy")
    displacement = _of_relaxed("displacement")
    with_uniform_stiffness = _of_relaxed("with_uniform_stiffness")
    coarser = _of_relaxed("coarser")
    stiffness_deficit = _of_relaxed("stiffness_deficit")


def _require_elastic(name: str, solid: object) -> None:
    if not isinstance(solid, Solid) or isinstance(solid, Viscoelastic):
        raise TypeError(
            f"{name} is a {type(solid).__name__}: give an elastic solid, as HalfSpace(grid, ...)."
        )


def ramp(x: Array) -> Array:
    """Return (1 - exp(-x)) / x, 1 at x = 0: with x = dt / t_k the part of a ramp that remains."""
    return jnp.where(x > 0, -jnp.expm1(-x) / jnp.where(x > 0, x, 1), 1)
