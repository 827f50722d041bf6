"""The results that a report shows: a scan's contact, its states, its loop and its pull-off."""

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import jax.numpy as jnp
import numpy as np

import jaxstab as js
from jaxstab.contact import pinning_error

# Points along the longest side of the periodic cell for which a report takes a few minutes, and
# those below which a scan has no roughness to speak of.
_POINTS = 128
_FEWEST = 8
# Mean pressures over E* times the rms slope, or over twice the hardness if that is less. Without
# adhesion twice that share of the area is in contact.
_PRESSURES = (0.0, 0.05, 0.15)
# The loop turns at this many ranges above the highest point, and at this share of the rms height,
# or of the range on a flat surface.
_FAR = 10.0
_NEAR = 1e-3
# The least loss of a located jump, as in `follow`: by default a loop takes twice as long, for about
# 1 % of its loss.
_SMALLEST_JUMP = 1e-5
# The other range, over the range.
_LONGER = 2.0
# From this resolution on the pull-off is computed, below it is extrapolated from the ranges that
# have it and are so many times as long.
_RESOLVED = 8.0
_RATIOS = 1.3 ** np.arange(4)
# The resolution that pull-offs and jumps need.
FOR_JUMPS = 4.0
# The inner part of a scan begins at this share of each side, where a window ends.
_INSIDE = 0.1

Treatment = Literal["window", "mirror", "as_is"]


@dataclass(frozen=True)
class Arguments:
    """The arguments of a report beside the scan, as `jaxstab.lab.report` explains them."""

    youngs_modulus: float
    surface_energy: float
    poisson_ratio: float
    range: float | None
    size: int | None
    detrend: int | None
    periodic: Treatment | None
    hardness: float | None


@dataclass(frozen=True)
class LoadedState:
    """An equilibrium under a mean pressure, its patches and its stability."""

    equilibrium: js.results.Equilibrium
    patches: js.results.Patches
    stability: js.results.Stability


@dataclass(frozen=True)
class Tension:
    """The tension of the pull-off at a range, with its error by the range and the grid.

    Attributes:
        value: the tension; NaN without a pull-off.
        error: of it by range and grid; NaN where it is not known.
        range: the range of the law at which it holds.
        extrapolation: from longer ranges, None where the grid resolves the range.
        refusal: why the extrapolation tells no value, "" where it does.
    """

    value: float
    error: float
    range: float
    extrapolation: js.results.Extrapolation | None = None
    refusal: str = ""


@dataclass(frozen=True)
class Treated:
    """A scan whose edges were made to meet in one of several ways, and its pull-off.

    Attributes:
        name: the way.
        surface: the periodic cell, with the spacing of the contact.
        pull_off: at the range of the contact's law.
        keeps_roughness: whether the way leaves the heights as they were measured.
    """

    name: str
    surface: js.surfaces.Topography
    pull_off: js.results.CriticalLoad
    keeps_roughness: bool


@dataclass(frozen=True)
class Results:
    """The results that a report shows; those that are not computed yet are None.

    Attributes:
        scan: the scan with all its points, levelled and filled, in metres.
        treatment: how opposite edges were made to meet, as in `Topography.periodic`.
        measured: a periodic surface with the heights of the scan, for its statistics.
        power_law: of the spectrum, or the reason why it has none.
        surface: the surface on the points of the contact.
        solid, law: of the contact.
        range: the range that was asked for; that of the law is longer if the grid does not resolve
            it.
        contact: the contact problem.
        states: states under three pressures, the first without load.
        pull_off: of the contact.
        tension: of the pull-off, with its error.
        treated: the scan with its edges made to meet in several ways, as in the contact first;
            empty if they meet.
        longer: the pull-off at a longer range.
        coarser: the pull-off on half the points.
        loop: the path of approach and retraction, computed last.
    """

    scan: js.surfaces.Topography
    treatment: Treatment
    measured: js.surfaces.Topography
    power_law: js.surfaces.PowerLaw | str
    surface: js.surfaces.Topography
    solid: js.HalfSpace
    law: js.potentials.Exponential
    range: float
    contact: js.Contact
    states: list[LoadedState] | None = None
    pull_off: js.results.CriticalLoad | None = None
    tension: Tension | None = None
    treated: list[Treated] | None = None
    longer: js.results.CriticalLoad | None = None
    coarser: js.results.CriticalLoad | None = None
    loop: js.results.Path | None = None

    @property
    def error_by_edges(self) -> float:
        """The error of the pull-off by the treatment of the edges, over the pull-off.

        The largest change by another way that keeps the roughness; NaN if one is not known.
        """
        if not self.treated:
            return 0.0
        first, *others = self.treated
        changes = [change(first.pull_off, x.pull_off) for x in others if x.keeps_roughness]
        return float(np.max(np.abs(changes)))


def change(pull_off: js.results.CriticalLoad, other: js.results.CriticalLoad) -> float:
    """Return the relative change from a pull-off to another one, NaN if one was not found."""
    if not pull_off.result == other.result == js.RESULTS.successful:
        return math.nan
    return float(other.load.value / pull_off.load.value) - 1


def results_of(scan: js.surfaces.Topography, arguments: Arguments) -> Iterator[Results]:
    """Yield the results of a report on a scan, more complete each time."""
    scan = _level(scan, arguments.detrend)
    treatment: Treatment = arguments.periodic or ("as_is" if scan.edges_meet else "mirror")
    # A mirrored surface has the heights of the scan, and no step.
    measured = scan.periodic("as_is" if treatment == "as_is" else "mirror")
    surface = _resample(scan.periodic(treatment), arguments.size)
    solid = js.HalfSpace(surface.grid, arguments.youngs_modulus, arguments.poisson_ratio)
    law, asked = _law_and_range(solid, surface, arguments)
    contact = js.Contact(solid, surface, law, hardness=arguments.hardness)
    power_law = _power_law(measured)
    known = Results(scan, treatment, measured, power_law, surface, solid, law, asked, contact)
    yield known
    known = replace(known, states=loaded_states(contact, solid))
    yield known
    known = replace(known, pull_off=_pull_off(contact))
    yield known
    known = replace(known, tension=_tension(known))
    yield known
    known = replace(known, treated=_treatments(known))
    _warn_of_treatment(known)
    yield known
    longer = _law(arguments, _LONGER * float(law.length))
    known = replace(
        known, longer=_pull_off(js.Contact(solid, surface, longer, hardness=arguments.hardness))
    )
    yield known
    coarser = surface.resampled([max(2, -(-points // 2)) for points in surface.grid.shape])
    coarse_solid = js.HalfSpace(coarser.grid, arguments.youngs_modulus, arguments.poisson_ratio)
    # A coarser grid is its purpose.
    with warnings.catch_warnings(action="ignore", category=js.exceptions.ResolutionWarning):
        rough = js.Contact(coarse_solid, coarser, law, hardness=arguments.hardness)
        known = replace(known, coarser=_pull_off(rough))
    yield known
    assert known.states is not None
    yield replace(
        known, loop=_loop(_yielded_contact(contact), solid, law, known.states[-1].equilibrium)
    )


def _level(scan: js.surfaces.Topography, order: int | None) -> js.surfaces.Topography:
    """Return a scan in metres, levelled and filled."""
    if scan.unit is None:
        raise ValueError(
            'The scan has no unit of length: give it one, as in js.surfaces.read(path, unit="um").'
        )
    if min(scan.grid.shape) < _FEWEST:
        raise ValueError(
            f"The scan has {' x '.join(map(str, scan.grid.shape))} points, too few for a "
            f"roughness: give a scan of at least {_FEWEST} along each side."
        )
    # A grid of single precision, as it is made by default, would stay so.
    scan = replace(scan, grid=js.Grid(scan.grid.shape, scan.lengths))
    return scan.levelled(order).in_unit("m")


def _power_law(surface: js.surfaces.Topography) -> js.surfaces.PowerLaw | str:
    try:
        return js.surfaces.power_law(js.surfaces.power_spectrum(surface.grid, surface))
    except ValueError as error:
        return f"none: {error}"


def _resample(surface: js.surfaces.Topography, size: int | None) -> js.surfaces.Topography:
    """Return a surface with so many points along its longest side, by default at most `_POINTS`."""
    most = max(surface.grid.shape)
    if size is None:
        size = min(most, _POINTS)
    return surface.resampled([max(2, round(size * n / most)) for n in surface.grid.shape])


def _law_and_range(
    solid: js.HalfSpace, surface: js.surfaces.Topography, arguments: Arguments
) -> tuple[js.potentials.Exponential, float]:
    """Return the law of adhesion, at a range that the grid resolves, and the range asked for.

    By default this is the shortest that the grid resolves.
    """
    longest = float(surface.lengths.max())
    wide = _law(arguments, longest)
    shortest = float(js.resolved_range(js.Contact(solid, surface, wide), FOR_JUMPS))
    power = math.floor(math.log10(shortest)) - 1
    # Rounded up to two digits.
    resolved = float(f"{math.ceil(shortest / 10.0**power)}e{power}")
    if arguments.range is None:
        return _law(arguments, resolved), resolved
    # The law checks it.
    law = _law(arguments, arguments.range)
    if arguments.range > longest:
        raise ValueError(
            f"`range` is {arguments.range:g} m, longer than the periodic cell of {longest:.3g} m: "
            "give it in metres, as 2e-9 for 2 nm."
        )
    if arguments.range < shortest:
        law = _law(arguments, resolved)
        warnings.warn(
            f"the grid does not resolve a range of {arguments.range:g} m: the pull-off is "
            "extrapolated to it if possible, and all else is computed at a range of "
            f"{resolved:g} m. More points, by `size`, resolve a shorter one: four times as many "
            "along a side half of it.",
            stacklevel=2,
        )
    return law, arguments.range


def _law(arguments: Arguments, length: float) -> js.potentials.Exponential:
    return js.potentials.Exponential(jnp.asarray(arguments.surface_energy), jnp.asarray(length))


def loaded_states(contact: js.Contact, solid: js.HalfSpace) -> list[LoadedState]:
    """Return the states of the report under several pressures, with patches and verdicts."""
    states = []
    for share in _PRESSURES:
        equilibrium = js.equilibrate(contact, js.MeanPressure(share * _pressure(contact, solid)))
        stability = js.assess_stability(contact, equilibrium)
        states.append(LoadedState(equilibrium, js.patches(contact, equilibrium), stability))
    return states


def _pressure(contact: js.Contact, solid: js.HalfSpace) -> float:
    """Return the pressure of which `_PRESSURES` are shares."""
    slope = js.surfaces.rms_slope(contact.grid, contact.heights)
    unit = float(solid.contact_modulus * slope) or float(contact.profile.max_attraction)
    if contact.hardness is None:
        return unit
    return min(unit, 2 * float(contact.hardness))


def _yielded_contact(contact: js.Contact) -> js.Contact:
    """Return the contact over the surface that the largest pressure leaves, if it yields."""
    if contact.hardness is None:
        return contact
    solid = contact.solid
    assert isinstance(solid, js.HalfSpace)
    load = js.MeanPressure(_PRESSURES[-1] * _pressure(contact, solid))
    return contact.after(js.equilibrate(contact, load)).elastic


def _loop(
    contact: js.Contact,
    solid: js.HalfSpace,
    law: js.potentials.Exponential,
    pressed: js.results.Equilibrium,
) -> js.results.Path:
    """Return the path from separation to the mean gap of a state, and back."""
    heights = np.asarray(contact.heights)
    # The solid is stretched less than under a flat punch as wide as the cell, which lets go at the
    # displacement (pi w L / E*)^(1/2).
    length = contact.grid.lengths.max()
    stretch = jnp.sqrt(math.pi * law.surface_energy * length / solid.contact_modulus)
    far = float(heights.max() - heights.mean() + _FAR * law.length + stretch)
    near = max(float(pressed.mean_gap), _NEAR * (float(heights.std()) or float(law.length)))
    turns = js.MeanGap(jnp.array([far, near, far]))
    loop = js.follow(contact, turns, smallest_jump=_SMALLEST_JUMP, throw=False)
    _require_uninterrupted(loop.result)
    return loop


def _pull_off(contact: js.Contact) -> js.results.CriticalLoad:
    """Return the pull-off of a contact, which may not be found."""
    pull_off = js.pull_off(_yielded_contact(contact), throw=False)
    _require_uninterrupted(pull_off.result)
    return pull_off


def _tension(known: Results) -> Tension:
    """Return the tension of the pull-off, extrapolated if the grid does not resolve the range."""
    contact = known.contact
    length = float(known.law.length)
    assert known.pull_off is not None
    if known.pull_off.result != js.RESULTS.successful:
        return Tension(math.nan, math.nan, length)
    computed = -float(known.pull_off.load.value)
    if known.range >= length and float(contact.resolution) >= _RESOLVED:
        return Tension(computed, computed * float(pinning_error(contact)), length)

    def tension(longer: js.Contact) -> float:
        found = _pull_off(longer)
        return -float(found.load.value) if found.result == js.RESULTS.successful else math.nan

    ranges = _RATIOS * float(js.resolved_range(contact, _RESOLVED))
    try:
        found = js.extrapolate(tension, contact, ranges=ranges, to=known.range)
    except js.exceptions.SolverError as error:
        return Tension(computed, math.nan, length, refusal=str(error))
    return Tension(float(found.value), float(found.error), known.range, found)


def _treatments(known: Results) -> list[Treated]:
    """Return the scan with its edges made to meet in several ways, the way of the contact first."""
    if known.treatment == "as_is":
        return []
    scan = known.scan
    spacing = known.surface.lengths / known.surface.grid.shape
    inner = scan.cropped(*[(_INSIDE * side, (1 - _INSIDE) * side) for side in scan.lengths])
    cells = {
        "mirror": ("mirrored", scan.periodic("mirror"), True),
        "window": ("windowed", scan.periodic("window"), False),
        "inner": ("inner part, mirrored", inner.periodic("mirror"), True),
    }
    assert known.pull_off is not None
    name, _, keeps = cells.pop(known.treatment)
    treated = [Treated(name, known.surface, known.pull_off, keeps)]
    for name, cell, keeps in cells.values():
        surface = cell.resampled([round(n) for n in (cell.lengths / spacing).tolist()])
        solid = js.HalfSpace(surface.grid, known.solid.contact_modulus)
        pull_off = _pull_off(js.Contact(solid, surface, known.law, hardness=known.contact.hardness))
        treated.append(Treated(name, surface, pull_off, keeps))
    return treated


def _warn_of_treatment(known: Results) -> None:
    if not known.treated:
        return
    first, *others = known.treated
    changes = [f"{x.name} {100 * change(first.pull_off, x.pull_off):+.0f} %" for x in others]
    warnings.warn(
        f"the scan was {first.name} to make opposite edges meet. In other ways its pull-off "
        f"changes: {', '.join(changes)}. If they meet as they are, give "
        '`periodic="as_is"`.',
        stacklevel=2,
    )


def _require_uninterrupted(result: js.RESULTS) -> None:
    """Raise `KeyboardInterrupt` again: a search ends early at Ctrl-C, with what it has."""
    if result == js.RESULTS.interrupted:
        raise KeyboardInterrupt
