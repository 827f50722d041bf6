"""Quantities at a range of the adhesion that the grid does not resolve, from longer ranges.

At a fixed work of adhesion a quantity Q tends to a limit as the range r of the law shrinks, as
Q0 + a r^q. The power q is about 2 close to the limit, where r is much shorter than what surrounds a
contact, and falls at longer ranges. So it is found for the three shortest of a few ranges and for
the three longest, and its change is continued.
"""

from collections.abc import Callable, Sequence
from typing import Annotated, Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxstab.contact.contact import Contact
from jaxstab.contact.resolution import FOR_JUMPS, PINNING, resolved_range
from jaxstab.contact.window import MOST_AT_EDGES, depth_of_edges
from jaxstab.core import display
from jaxstab.core.checks import (
    array,
    nonnegative_parameter,
    numbers,
    require,
    require_known,
    scalar_parameter,
)
from jaxstab.core.display import column, number
from jaxstab.core.equality import Comparable
from jaxstab.core.results import SolverError
from jaxstab.core.rings import Rings
from jaxstab.core.roots import bisect
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import LENGTH, NO_UNITS, Units, named_with_unit, shown_unit, unit_symbol

# The default ranges: the resolution at the shortest one, and each over the one before. It is twice
# the resolution of the range at which the extrapolation is tried.
_RESOLUTION = 2 * FOR_JUMPS
_RATIOS = 1.3 ** np.arange(4)
# The powers that are sought, and the least one that tells of a limit at the range zero.
_POWERS = -2.0, 6.0
_LEAST_POWER = 0.3
_FEWEST = 3
# An error above this part of the value at the shortest range is no answer.
_LARGEST_ERROR = 0.25


class Extrapolation(Comparable):
    """A quantity at a range that is shorter than those it was computed at.

    The unit of the quantity is that of the function; of lengths it is the contact's.

    Attributes:
        value: of the quantity there.
        error: of the value, estimated.
        power: q below the shortest range; NaN where the quantity depends on the range by less than
            the error of the grid.
        range: the range asked for [length].
        ranges: those at which the quantity was computed, rising [length].
        values: of the quantity at each.
        resolutions: of the grid at each, as `contact.resolution`.
        units: the units of length and of pressure, None where unknown.

    Example:
        >>> def pressure_of(contact):
        ...     return js.equilibrate(contact, js.MeanGap(0.05)).mean_pressure
        >>> shorter = js.extrapolate(pressure_of, contact, to=0.05)
        >>> bool(shorter.error > 0), len(shorter.values)
        (True, 4)
    """

    value: Scalar
    error: Scalar
    power: Scalar
    range: Annotated[Scalar, LENGTH]
    ranges: Annotated[Float[Array, " ranges"], LENGTH]
    values: Float[Array, " ranges"]
    resolutions: Float[Array, " ranges"]
    units: Units = eqx.field(static=True, default=NO_UNITS, repr=False)

    @display.readable
    def __repr__(self) -> str:
        unit = shown_unit(unit_symbol(self.units, LENGTH))
        columns = {
            named_with_unit("range", unit): column(self.ranges, "{:.5g}".format),
            "resolution": column(self.resolutions, "{:.3g}".format),
            "value": column(self.values, number),
        }
        head = (
            f"Extrapolation: {float(self.value):.6g} ± {float(self.error):.1g} at the range "
            f"{float(self.range):.6g} {unit}".rstrip()
            + f", with the power {float(self.power):.3g}"
        )
        return f"{head}\n{display.table(columns)}"


def extrapolate(
    function: Callable[[Contact], ArrayLike],
    contact: Contact,
    *,
    ranges: ArrayLike | None = None,
    to: ArrayLike | None = None,
) -> Extrapolation:
    """Return a quantity at a range that the grid does not resolve, from longer ranges.

    The quantity Q is computed at three or more ranges of the law, at the same work of adhesion.
    The power q of Q0 + a r^q follows from the three shortest ranges, and again from the three
    longest. From one range to the next it changes, and it changes as much again below the shortest
    one: with that power Q goes on from the two shortest ranges to the one asked for.

    The error is the sum of three. One is the change of the value with the power of the three
    longest ranges, or with the power 1, a straight line: the larger one. The second is the change
    if each value is lower by the error of a pull-off at its resolution, 20 % over its square, as
    contact edges are pinned to the grid. Longer `ranges` make it smaller, and the first larger. The
    third is from a trial: at a range shorter than all by 2^(1/2), or at the one asked for if that
    is longer, Q is computed as well. What the extrapolation there is off by, beyond the error of
    the grid, is continued to the range asked for, in proportion to the change of Q.

    Arguments:
        function: returns one number for a contact, such as the load of its `pull_off`, or the
            dissipation of a path.
        contact: the contact problem, whose law has a `length`, as those of `jaxstab.potentials`
            with a range.
        ranges: three ranges or more, in any order [length]. By default four, each 1.3 times
            the one before, from a resolution of 8 on. On rings they must be given, since the
            resolution falls with the radius a of the contact: from sqrt(R / a) times
            `resolved_range(contact, 8)` on, on a disc of radius R.
        to: the range asked for, or zero for the limit; by default that of the contact's law
            [length].

    Raises:
        ValueError: for fewer than three ranges, ranges that repeat or are not positive, none on
            rings, a range asked for that is longer than all, and a function of something else than
            one number. For a window whose edges the law reaches at the longest range, but not at
            its own.
        TypeError: for a law without one number that is its range; under JAX transformations.
        SolverError: where the values rise and fall with the range, or follow no power from -2 to 6;
            for the range zero where the power is below 0.3; and for an error above a quarter of the
            value at the shortest range: then they tell of no limit.

    Example:
        >>> def pressure_of(contact):
        ...     return js.equilibrate(contact, js.MeanGap(0.05)).mean_pressure
        >>> shorter = js.extrapolate(pressure_of, contact, to=0.05)
        >>> f"{shorter.value:.3f} ± {shorter.error:.3f}"
        '-0.203 ± 0.030'
    """
    require_known((contact, ranges, to), "extrapolate")
    shortest = float(resolved_range(contact, _RESOLUTION))
    if ranges is not None:
        lengths = _rising_ranges(ranges)
    elif isinstance(contact.grid, Rings):
        raise ValueError(
            "No ranges are given, and those that rings resolve depend on where the edge of the "
            f"contact lies: give `ranges` from {shortest:.3g} sqrt(R / a) on, as many times 1.3, "
            f"with the radius R = {float(contact.grid.radius):.6g} of the disc and the least "
            "radius a of the contact that matters."
        )
    else:
        lengths = _RATIOS * shortest
    law: Any = contact.potential
    target = law.length
    if to is not None:
        target = to
    target = float(nonnegative_parameter(scalar_parameter(target, "The range"), "The range"))
    cure = f"the longest that is computed is {lengths[-1]:.6g}, give `ranges` up to it."
    require("The range", target, target <= lengths[-1], cure)
    # The trial comes last, and only below the shortest range.
    tried = max(target, lengths[0] * (FOR_JUMPS / _RESOLUTION) ** 0.5)
    number = len(lengths)
    below = []
    if tried < lengths[0]:
        below.append(tried)
    contacts = [_with_range(contact, length) for length in (*lengths, *below)]
    if contact.solid.is_window:
        _require_large_window(contact, contacts[number - 1])
    values = np.array([_number(function(one)) for one in contacts])
    resolutions = np.array([float(one.resolution) for one in contacts])
    if not np.isfinite(values).all():
        raise SolverError(
            f"The function is {values} at the ranges {np.append(lengths, below)}: it must be "
            "finite."
        )
    errors = np.abs(values[:number]).max() * PINNING / resolutions**2
    trials = [_Trial(*one) for one in zip(below, values[number:], errors[number:], strict=True)]
    values, errors, resolutions = (x[:number] for x in (values, errors, resolutions))
    found = _extrapolation(lengths, values, errors, target, trials)
    dtype = contact.heights.dtype
    fields = found.value, found.error, found.power, target, lengths, values, resolutions
    return Extrapolation(*(array(x, dtype) for x in fields), units=contact.units)


class _Trial(NamedTuple):
    """A range below the others, the value there, and its error by the grid."""

    length: float
    value: float
    error: float


class _RangeLimit(NamedTuple):
    """A value at the range asked for, its error, and the power that leads there."""

    value: float
    error: float
    power: float


def _extrapolation(
    lengths: np.ndarray,
    values: np.ndarray,
    errors: np.ndarray,
    target: float,
    trials: Sequence[_Trial] = (),
) -> _RangeLimit:
    """Return the value at a target, by a power that goes on changing as from range to range."""
    spread = np.ptp(values)
    if spread <= errors[0]:
        # The range has less effect than the grid.
        return _RangeLimit(values[np.argmin(errors)], spread + errors[0], np.nan)
    value, power, change = _by_power(lengths, values, target)
    # Edges that are pinned make a pull-off larger.
    try:
        unpinned, _, _ = _by_power(lengths, values - np.sign(values) * errors, target)
    except SolverError:
        unpinned = value - spread
    error = change + abs(value - unpinned)
    for trial in trials:
        foreseen = _along_power(lengths, values, power, trial.length)
        missed = max(abs(trial.value - foreseen) - trial.error, 0)
        error += missed * abs((value - values[0]) / (foreseen - values[0]))
    if error > _LARGEST_ERROR * abs(values[0]):
        raise SolverError(
            f"The values {values} at the ranges {lengths} change so much that they tell "
            f"{value:.3g} ± {error:.1g} at the range {target:.6g}, with an error above "
            f"{100 * _LARGEST_ERROR:.0f} % of the first: use a finer grid, or ask for a range "
            "nearer to the shortest."
        )
    return _RangeLimit(value, error, power)


def _by_power(lengths: np.ndarray, values: np.ndarray, target: float) -> tuple[float, float, float]:
    """Return the value at a target, the power, and the error of the value by that of the power."""
    near = _power(lengths[:_FEWEST], values[:_FEWEST])
    far = _power(lengths[-_FEWEST:], values[-_FEWEST:])
    steps = max(len(lengths) - _FEWEST, 1)
    power = near + (near - far) / steps
    value = _along_power(lengths, values, power, target)
    if target == 0:
        # The rising power tells of a limit, to which a lower one would not lead.
        far = max(far, _LEAST_POWER)
    others = [_along_power(lengths, values, other, target) for other in (1.0, far)]
    return value, power, max(abs(value - other) for other in others)


def _power(lengths: np.ndarray, values: np.ndarray) -> float:
    """Return the power q of Q0 + a r^q through three values."""
    low, high = np.diff(values)
    if low * high <= 0:
        raise SolverError(
            f"The values {values} at the ranges {lengths} rise and fall, as where a contact jumps "
            "to other states at other ranges: look at them, and give ranges between which "
            "they change in one direction, or use a finer grid."
        )
    below, above = np.log(lengths[[0, 2]] / lengths[1])

    def excess(power: ArrayLike) -> np.ndarray:
        # This rises with the power.
        return -_rise(power, above) / _rise(power, below) - high / low

    least, most = _POWERS
    if not excess(least) < 0 < excess(most):
        raise SolverError(
            f"The values {values} at the ranges {lengths} follow no power of the range from "
            f"{least:g} to {most:g}, as where a contact jumps to other states at other ranges: "
            "look at them, and give ranges between which they change gradually, or use a finer "
            "grid."
        )
    return float(bisect(excess, least, most))


def _rise(power: ArrayLike, distance: float) -> np.ndarray:
    """Return (x^q - 1) / q at a logarithm of x, which is the limit where the power is zero."""
    power = np.where(power == 0, np.finfo(float).tiny, power)
    return np.expm1(power * distance) / power


def _along_power(lengths: np.ndarray, values: np.ndarray, power: float, target: float) -> float:
    """Return the value at a target by a power law through the two shortest ranges."""
    if target == 0 and power < _LEAST_POWER:
        raise SolverError(
            f"The values {values} at the ranges {lengths} go on with the power {power:.3g} of the "
            f"range, below {_LEAST_POWER}: they tell of no limit at the range zero. Use a finer "
            "grid, which resolves shorter ranges, or ask for a range above zero."
        )
    with np.errstate(divide="ignore"):
        below, above = np.log(np.array([target, lengths[1]]) / lengths[0])
    share = _rise(power, below) / _rise(power, above)
    return float(values[0] + share * (values[1] - values[0]))


def _rising_ranges(ranges: ArrayLike) -> np.ndarray:
    """Return three ranges or more, rising."""
    lengths = np.sort(np.asarray(numbers(ranges, "The ranges"), float), axis=None)
    cure = f"give {_FEWEST} different ones or more."
    require("The ranges", lengths, len(np.unique(lengths)) >= _FEWEST, cure)
    cure = "they must be positive, finite and different."
    is_right = np.isfinite(lengths).all() and lengths[0] > 0 and np.diff(lengths).min() > 0
    require("The ranges", lengths, is_right, cure)
    return lengths


def _require_large_window(contact: Contact, longest: Contact) -> None:
    """Raise `ValueError` if the longest range makes a law reach the edges of its window."""
    depth = depth_of_edges(np.asarray(contact.heights))
    reach = _reach(longest)
    # A surface that ends within reach of its own law has edges in any case.
    if _reach(contact) <= depth < reach:
        law: Any = longest.potential
        raise ValueError(
            f"The longest range is {float(law.length):.6g}: its law attracts by more than "
            f"{MOST_AT_EDGES:.0%} of its largest attraction up to a gap of {reach:.3g}, but the "
            f"edges of the window lie only {depth:.3g} below its summit, so that the surface would "
            "end within its reach. Use a larger window, whose edges lie lower, or a finer grid, "
            "which resolves shorter ranges."
        )


def _reach(contact: Contact) -> float:
    """Return the gap up to which a law attracts by more than edges may carry [length]."""
    profile = contact.profile
    return float(profile.outermost_gap(MOST_AT_EDGES * profile.max_attraction))


def _with_range(contact: Contact, length: float) -> Contact:
    """Return a contact with another range of its law."""
    law: Any = contact.potential
    changed = array(length, law.length.dtype)
    return eqx.tree_at(lambda contact: contact.potential.length, contact, changed)


def _number(value: ArrayLike) -> float:
    """Return what a function has returned as a number."""
    return float(scalar_parameter(value, "What the function returns"))
