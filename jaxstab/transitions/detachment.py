"""Thermal detachment: the life of a contact under tension, and the distribution of its pull-off.

A state is left at Kramers' rate k = nu exp(-B / kT) (H. A. Kramers, Physica 7, 284, 1940). Under a
tension that grows at a constant rate r the contact survives with the probability
S = exp(-int k dp0 / r) (E. Evans, K. Ritchie, Biophys. J. 72, 1541, 1997). Here the barrier B is
computed along the load, and the integral is evaluated, without a formula for either.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact, require_contact, require_elastic
from jaxstab.contact.resolution import FOR_JUMPS, warned_once
from jaxstab.core import display
from jaxstab.core.checks import (
    array,
    concrete,
    numbers,
    positive_parameter,
    positive_scalar,
    require,
    require_known,
)
from jaxstab.core.display import Outcome, several
from jaxstab.core.roots import bisect
from jaxstab.core.types import ArrayLike, Flag, Scalar
from jaxstab.core.units import ENERGY, FORCE, PRESSURE, TIME, Dimension
from jaxstab.equilibrium import Equilibrium, equilibrate
from jaxstab.equilibrium.equilibrium import State, single_start
from jaxstab.loading import follow, pull_off
from jaxstab.loads import Load, MeanPressure, require_loads
from jaxstab.states.columns import measured_columns
from jaxstab.transitions.barrier_curve import SAME_LOAD, BarrierCurve

# Barriers count where all higher ones add at most this to the probability of detachment.
_NEGLIGIBLE = 1e-4
# Barriers are computed to this part of the thermal energy.
_TOLERANCE = 0.02
# A state is at the load if its mean pressure is within this part of the pull-off: solvers round.
_AT_LOAD = 1e-4
_SHOWN = 0.05, 0.5, 0.95


class Detachment(Outcome):
    """When thermal motion detaches a contact under tension.

    Loads are mean pressures, negative in tension, as of `pull_off`; times the area they are forces.
    Of a batch of rates the distribution has their shape as leading axes.

    Attributes:
        mean_life: 1 / k at the load at which it is held [time].
        pull_off: the last state without thermal motion, with its load.
        loads: from the given load to that of the pull-off [pressure].
        barriers: B at each, the largest climb on the way to detached surfaces; zero at the
            pull-off [energy].
        errors: of the barriers between each load and the one before, estimated [energy].
        num_passes: at how many of the loads the pass was computed; the others are interpolated.
        is_direct: whether the state meets no other on the way to detached surfaces, at each load.
            Otherwise the climb may begin at a minimum that is met.
        thermal_energy: kT [energy].
        attempt_rate: nu [1/time].
        rate: r, how fast the tension grows [pressure/time]; None if it is held.

    Example:
        >>> load = js.MeanPressure(-0.15)
        >>> life = js.detachment(contact, load, thermal_energy=1e-4, attempt_rate=1e6)
        >>> f"{life.pull_off.mean_pressure:.4f}"
        '-0.1770'
    """

    mean_life: Annotated[Scalar, TIME]
    pull_off: Equilibrium
    loads: Annotated[Float[Array, " loads"], PRESSURE]
    barriers: Annotated[Float[Array, " loads"], ENERGY]
    errors: Annotated[Float[Array, " loads"], ENERGY]
    num_passes: Int[Array, ""]
    is_direct: Flag
    thermal_energy: Annotated[Scalar, ENERGY]
    attempt_rate: Annotated[Scalar, Dimension("1/time")]
    rate: Annotated[Float[Array, "*rates"], Dimension("pressure/time")] | None

    @property
    def median(self) -> Float[Array, "*rates"]:
        """The load before which half of the contacts have detached [pressure]."""
        return self.quantile(0.5)

    def quantile(self, probability: ArrayLike) -> Float[Array, "..."]:
        """Return the load before which a part of the contacts has detached [pressure].

        That is the pull-off for the part that survives until then.

        Arguments:
            probability: the part, one number or an array, whose axes follow those of the rates.

        Raises:
            ValueError: for a number outside of 0 to 1, and for a load that is held.
        """
        part = np.asarray(numbers(probability, "The probability"), float)
        require("The probability", part, (part >= 0) & (part <= 1), "give numbers from 0 to 1.")
        tension = self._tension(part)
        return array(-tension, self.loads.dtype)

    def quantile_error(self, probability: ArrayLike) -> Float[Array, "..."]:
        """Return the error of `quantile` by the errors of the barriers [pressure]."""
        part = np.asarray(numbers(probability, "The probability"), float)
        tension = self._tension(part)
        hazard = self._hazard()
        # A barrier lower by d raises the rate by d / kT of it.
        change = hazard.integral(tension, np.minimum(hazard.errors, 1))
        error = change * np.exp(hazard.heights_at(tension))
        is_inside = tension < hazard.tensions[-1]
        return array(np.where(is_inside, error, 0), self.loads.dtype)

    def survival(self, load: ArrayLike | Load) -> Float[Array, "..."]:
        """Return the part of the contacts that has not detached before a load.

        Arguments:
            load: mean pressures, below zero in tension, or a `MeanPressure` of them; their axes
                follow those of the rates.

        Raises:
            ValueError: for a load that is held.
        """
        if isinstance(load, MeanPressure):
            load = load.value
        tension = -np.asarray(numbers(load, "The load"), float)
        hazard = self._hazard()
        exponent = hazard.integral(tension) * self._trials(tension.ndim)
        alive = np.where(tension < hazard.tensions[-1], np.exp(-exponent), 0)
        return array(alive, self.loads.dtype)

    def _tension(self, part: np.ndarray) -> np.ndarray:
        """Return the tension before which a part has detached."""
        hazard = self._hazard()
        trials = self._trials(part.ndim)
        with np.errstate(divide="ignore"):
            needed = -np.log1p(-part) / trials
        first, last = hazard.tensions[[0, -1]]
        found = bisect(lambda tension: hazard.integral(tension) - needed, first, last)
        return np.where(hazard.integral(last) > needed, found, last)

    def _trials(self, ndim: int) -> np.ndarray:
        """Return nu / r, with axes for as many of an argument."""
        if self.rate is None:
            raise ValueError(
                "The load is held, and only under a growing tension the contact has a distribution "
                "of pull-offs: give `rate` to jaxstab.detachment."
            )
        rate = np.asarray(self.rate, float)
        return float(self.attempt_rate) / rate.reshape((*rate.shape, *[1] * ndim))

    def _hazard(self) -> "_Hazard":
        columns = (np.asarray(x, float) for x in (self.loads, self.barriers, self.errors))
        loads, barriers, errors = columns
        energy = float(self.thermal_energy)
        return _Hazard(-loads, barriers / energy, errors / energy)

    @display.readable
    def __repr__(self) -> str:
        units = self.pull_off.units
        first, last = (
            units.text(float(value), PRESSURE, 6)
            for value in (self.loads[0], self.pull_off.load.value)
        )
        lines = [
            f"Detachment: mean pressure {first}, pull-off without thermal motion at {last}",
            f"  mean life at {first}  {float(self.mean_life):.4g}",
            f"  barrier there  {units.text(float(self.barriers[0]), ENERGY)}, "
            f"{float(self.barriers[0] / self.thermal_energy):.4g} kT",
            f"  from {several(int(self.num_passes), 'computed barrier')}",
        ]
        if not self.is_direct:
            lines.append("  there are minima between the state and detached surfaces")
        if self.rate is None:
            return "\n".join(lines)
        quantiles = np.asarray(self.quantile(np.array(_SHOWN))).reshape(-1, len(_SHOWN))
        error = np.asarray(self.quantile_error(0.5)).ravel()
        named = {f"{100 * part:.0f} %": quantiles[:, i] for i, part in enumerate(_SHOWN)}
        columns = measured_columns(
            {"rate": np.ravel(self.rate)}, units, Dimension("pressure/time"), ".3g"
        )
        columns |= measured_columns(named, units, PRESSURE, ".5g")
        columns |= measured_columns({"error": error}, units, PRESSURE, ".0e")
        force = quantiles[:, 1] * float(self.pull_off.area)
        columns |= measured_columns({"median force": force}, units, FORCE, ".5g")
        return "\n".join([*lines, display.table(columns)])


def detachment(
    contact: Contact,
    load: Load,
    *,
    thermal_energy: ArrayLike,
    attempt_rate: ArrayLike,
    rate: ArrayLike | None = None,
    initial: State | None = None,
) -> Detachment:
    """Return how long a contact lives under tension, and at which load it detaches if that grows.

    Thermal motion leads over the barrier B to detached surfaces (`transition` to None) at Kramers'
    rate k = nu exp(-B / kT) (Kramers 1940). Under a held load the mean life is 1 / k. Under a load
    that grows from it at the rate r, the part S = exp(-int k dp0 / r) survives (Evans & Ritchie
    1997), which is integrated along the load. Barriers are computed at a few loads, and
    interpolated in the power in which they are smooth, with their exact slopes, until they are
    within 2 % of kT where they count.

    If other minima are met on the way, the climb from one of them to the pass out of it may be
    larger than the state's own, and takes longer: B is the largest. So it goes on through a jump of
    the state, before which the state's own barrier vanishes.

    The state is the one to which the contact comes by its load alone, through its jumps. Passes off
    its branch are not found: thermal motion may lead over lower ones to other states before
    (`easiest_exit`), and then this is not the life until detachment. In single precision passes
    close to the pull-off are lost to rounding: use float64. The function runs neither under
    `jax.jit` nor under `jax.vmap`.

    Arguments:
        contact: the contact problem.
        load: a single `MeanPressure` that pulls, or zero: the held load, from which it grows.
        thermal_energy: kT [energy]; 4.05e-21 J at 20 degrees Celsius.
        attempt_rate: nu, how often the state tries [1/time].
        rate: r, how fast the tension grows [pressure/time], the rate of the force over the area;
            one number or an array. By default the load is held.
        initial: a state in contact from which the contact is unloaded to this load, at its own
            mean pressure; by default the equilibrium at zero mean pressure.

    Raises:
        ValueError: for a load that presses, one beyond the pull-off, an array of loads, and numbers
            that are not positive.
        TypeError: for another kind of load, and under JAX transformations.
        SolverError: where the contact has no pull-off, or a pass is not found.

    Example:
        >>> load = js.MeanPressure(-0.15)
        >>> life = js.detachment(contact, load, thermal_energy=1e-4, attempt_rate=1e6)
        >>> f"{life.mean_life:.2e}"
        '2.47e-04'
    """
    require_contact(contact)
    require_elastic(contact, "detachment")
    require_loads(load, (), "detachment takes one load", "use a loop.")
    given = contact, load, thermal_energy, attempt_rate, rate, initial
    require_known(given, "detachment")
    _require_tension(load)
    energy = positive_scalar(thermal_energy, "The thermal energy")
    attempts = positive_scalar(attempt_rate, "The attempt rate")
    rates = None
    if rate is not None:
        rates = positive_parameter(rate, "The rate")
    with warned_once(contact, FOR_JUMPS):
        start = initial
        if start is None:
            start = equilibrate(contact, MeanPressure(0.0))
        pressure = single_start(start).mean_pressure
        limit = pull_off(contact, initial=start)
        first = -float(load.value)
        last = -float(limit.load.value)
        begin = -float(pressure)
        if abs(begin - first) <= _AT_LOAD * last:
            begin = first
        _require_between(load, first, begin, last)
        ends = MeanPressure(np.array([-begin, -(1 + SAME_LOAD) * last]))
        path = follow(contact, ends, initial=start, fields=True)
        curve = BarrierCurve(contact, path, limit)
        lowest = 0.0
        if rates is not None:
            trials = float(attempts) * (last - first) / float(concrete(rates).min())
            lowest = float(energy) * np.log(max(trials / _NEGLIGIBLE, np.e))
        curve.add_down_to(lowest, first)
        curve.refine(lowest, _TOLERANCE * float(energy))
    found = curve.barriers()
    dtype = contact.heights.dtype
    columns = 0 - found.tensions, found.barriers, found.errors
    loads, barriers, errors = (array(x, dtype) for x in columns)
    with np.errstate(over="ignore"):
        life = np.exp(found.barriers[0] / float(energy)) / float(attempts)
    return Detachment(
        mean_life=array(life, dtype),
        pull_off=limit.equilibrium,
        loads=loads,
        barriers=barriers,
        errors=errors,
        num_passes=array(found.passes),
        is_direct=array(found.is_direct),
        thermal_energy=energy,
        attempt_rate=attempts,
        rate=rates,
    )


@dataclass(frozen=True)
class _Hazard:
    """The rate exp(-B / kT) over the tension, with B linear between many.

    Attributes:
        tensions: -p0, rising.
        heights: B / kT at each.
        errors: of the heights between each and the one before.
    """

    tensions: np.ndarray
    heights: np.ndarray
    errors: np.ndarray

    def heights_at(self, tension: np.ndarray) -> np.ndarray:
        """Return B / kT at tensions."""
        return np.interp(tension, self.tensions, self.heights)

    def integral(self, tension: np.ndarray, weight: np.ndarray | float = 1.0) -> np.ndarray:
        """Return the integral of the rate from the first tension, weighted on each interval."""
        weight = np.broadcast_to(weight, self.tensions.shape)[1:]
        steps = weight * _mean_rate(self.heights[:-1], self.heights[1:]) * np.diff(self.tensions)
        whole = np.append(0.0, np.cumsum(steps))
        inside = np.clip(tension, self.tensions[0], self.tensions[-1])
        number = np.searchsorted(self.tensions[1:-1], inside, side="right")
        part = inside - self.tensions[number]
        mean = _mean_rate(self.heights[number], self.heights_at(inside))
        return whole[number] + weight[number] * mean * part


def _mean_rate(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the mean of exp(-B / kT) over an interval in which B / kT is linear."""
    rise = np.abs(one - other)
    share = np.where(rise > 0, -np.expm1(-rise) / np.where(rise > 0, rise, 1), 1)
    return np.exp(-np.minimum(one, other)) * share


def _require_tension(load: Load) -> None:
    """Raise an error unless a load is a dead one that does not press."""
    if not isinstance(load, MeanPressure):
        raise TypeError(
            f"The load is {load!r}, under which detached surfaces have an equilibrium: give a "
            "MeanPressure that pulls. Through a soft spring the tension grows at its stiffness "
            "times the speed of its far end."
        )
    cure = "give a tension, a number below zero, or zero: a pressure holds the surfaces together."
    require("The load", load.value, concrete(load.value) <= 0, cure)


def _require_between(load: Load, tension: float, first: float, last: float) -> None:
    """Raise `ValueError` unless a tension is between that of the start and the pull-off."""
    if tension >= last:
        raise ValueError(
            f"The load is {load!r}, and without thermal motion the contact detaches at "
            f"{-last:.6g}: give a smaller tension."
        )
    if tension < first:
        raise ValueError(
            f"The load is {load!r}, and the initial state is at {-first:.6g}: give one at a "
            "smaller tension, from which the contact is unloaded."
        )
