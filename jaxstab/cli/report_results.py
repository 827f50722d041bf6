"""The results that a report shows: a scan's contact, its states, its loop and its pull-off."""

import argparse
import math
import warnings
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

import jaxstab as js
from jaxstab.branches.differentiable_limit import CriticalLoad
from jaxstab.cli.problem import topography_of
from jaxstab.contact.resolution import FOR_JUMPS, PINNING
from jaxstab.core.results import RESULTS
from jaxstab.equilibrium import Equilibrium
from jaxstab.stability import Stability
from jaxstab.surfaces import Topography

# Points along the longest side for which a report takes two minutes.
_POINTS = 128
# Mean pressures over E* times the rms slope. Without adhesion twice that share of the area is in
# contact.
_PRESSURES = (0.0, 0.05, 0.15)
# The loop turns at this many ranges above the highest point, and at this share of the rms height.
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


@dataclass(frozen=True)
class LoadedState:
    """An equilibrium under a mean pressure, its patches and its stability."""

    equilibrium: Equilibrium
    patches: js.Patches
    stability: Stability


@dataclass(frozen=True)
class Tension:
    """The tension of the pull-off, with its error by the range and the grid.

    Attributes:
        value: the tension; NaN without a pull-off.
        error: of it; NaN where it is not known.
        extrapolation: from longer ranges, None where the grid resolves the range.
        refusal: why the extrapolation tells no value, "" where it does.
    """

    value: float
    error: float
    extrapolation: js.Extrapolation | None = None
    refusal: str = ""


@dataclass(frozen=True)
class Results:
    """The results that a report shows.

    Attributes:
        scan: the surface with all its points, in metres.
        power_law: of the scan's spectrum.
        surface: the surface on the points of the contact.
        solid, law: of the contact.
        contact: the contact problem.
        states: states under three pressures, the first without load.
        loop: the path of approach and retraction.
        pull_offs: of the contact, of one with a longer range, and of one on half the points.
        tension: of the pull-off, with its error.
    """

    scan: Topography
    power_law: js.surfaces.PowerLaw
    surface: Topography
    solid: js.HalfSpace
    law: js.potentials.Exponential
    contact: js.Contact
    states: list[LoadedState]
    loop: js.Path
    pull_offs: list[CriticalLoad]
    tension: Tension


def results_of(options: argparse.Namespace) -> Results:
    """Return the results for the options of a report."""
    scan = topography_of(options.file, options)
    if scan.unit is None:
        raise ValueError(f"{options.file} has no unit of length: give --unit, as in --unit um.")
    scan = scan.in_unit("m")
    power_law = js.surfaces.power_law(js.surfaces.power_spectrum(scan.grid, scan))
    surface = _resampled(scan, options.size)
    solid = js.HalfSpace(surface.grid, options.modulus, options.poisson_ratio)
    law = _law(solid, surface, options)
    contact = js.Contact(solid, surface, law)
    states = loaded_states(contact, solid)
    loop = _loop(contact, solid, law, states[-1].equilibrium)
    longer = js.potentials.Exponential(options.work, _LONGER * law.length)
    coarser = surface.resampled([-(-points // 2) for points in surface.grid.shape])
    coarser_solid = js.HalfSpace(coarser.grid, options.modulus, options.poisson_ratio)
    pull_offs = [_pull_off(contact), _pull_off(js.Contact(solid, surface, longer))]
    # A coarser grid is the purpose of the last one.
    with warnings.catch_warnings(action="ignore", category=js.ResolutionWarning):
        pull_offs.append(_pull_off(js.Contact(coarser_solid, coarser, law)))
    tension = _tension(contact, pull_offs[0])
    return Results(scan, power_law, surface, solid, law, contact, states, loop, pull_offs, tension)


def _resampled(surface: Topography, size: int | None) -> Topography:
    """Return a surface with so many points along its longest side, by default at most `_POINTS`."""
    most = max(surface.grid.shape)
    if size is None:
        size = min(most, _POINTS)
    return surface.resampled([max(2, round(size * n / most)) for n in surface.grid.shape])


def _law(
    solid: js.HalfSpace, surface: Topography, options: argparse.Namespace
) -> js.potentials.Exponential:
    """Return the law of adhesion; by default its range is the shortest that the grid resolves."""
    length = options.range
    longest = float(surface.lengths.max())
    if length is not None and length > longest:
        raise ValueError(
            f"--range is {length:g} m, longer than the scan of {longest:.3g} m: give it in metres, "
            "as 2e-9 for 2 nm."
        )
    if length is None:
        wide = js.potentials.Exponential(options.work, surface.lengths.max())
        shortest = float(js.resolved_range(js.Contact(solid, surface, wide), FOR_JUMPS))
        power = math.floor(math.log10(shortest)) - 1
        # Rounded up to two digits.
        length = float(f"{math.ceil(shortest / 10.0**power)}e{power}")
    return js.potentials.Exponential(options.work, jnp.asarray(length))


def loaded_states(contact: js.Contact, solid: js.HalfSpace) -> list[LoadedState]:
    """Return the states of the report under several pressures, with patches and verdicts."""
    slope = js.surfaces.rms_slope(contact.grid, contact.heights)
    unit = solid.contact_modulus * slope
    states = []
    for share in _PRESSURES:
        equilibrium = js.equilibrate(contact, js.MeanPressure(share * unit))
        stability = js.assess_stability(contact, equilibrium)
        states.append(LoadedState(equilibrium, js.patches(contact, equilibrium), stability))
    return states


def _loop(
    contact: js.Contact,
    solid: js.HalfSpace,
    law: js.potentials.Exponential,
    pressed: Equilibrium,
) -> js.Path:
    """Return the path from separation to the mean gap of a state, and back."""
    heights = np.asarray(contact.heights)
    # The solid is stretched less than under a flat punch as wide as the cell, which lets go at the
    # displacement (pi w L / E*)^(1/2).
    length = contact.grid.lengths.max()
    stretch = jnp.sqrt(math.pi * law.surface_energy * length / solid.contact_modulus)
    far = float(heights.max() - heights.mean() + _FAR * law.length + stretch)
    near = max(float(pressed.mean_gap), _NEAR * float(heights.std()))
    turns = js.MeanGap(jnp.array([far, near, far]))
    loop = js.follow(contact, turns, smallest_jump=_SMALLEST_JUMP, progress=True, throw=False)
    _require_uninterrupted(loop.result)
    return loop


def _pull_off(contact: js.Contact) -> CriticalLoad:
    pull_off = js.pull_off(contact, progress=True, throw=False)
    _require_uninterrupted(pull_off.result)
    return pull_off


def _tension(contact: js.Contact, pull_off: CriticalLoad) -> Tension:
    """Return the tension of a pull-off, extrapolated if the grid does not resolve the range."""
    if pull_off.result != RESULTS.successful:
        return Tension(math.nan, math.nan)
    computed = -float(pull_off.load.value)
    resolution = float(contact.resolution)
    if resolution >= _RESOLVED:
        return Tension(computed, computed * PINNING / resolution**2)

    def tension(longer: js.Contact) -> float:
        found = _pull_off(longer)
        return -float(found.load.value) if found.result == RESULTS.successful else math.nan

    ranges = _RATIOS * float(js.resolved_range(contact, _RESOLVED))
    try:
        found = js.extrapolate(tension, contact, ranges=ranges)
    except js.SolverError as error:
        return Tension(computed, math.nan, refusal=str(error))
    return Tension(float(found.value), float(found.error), found)


def _require_uninterrupted(result: RESULTS) -> None:
    """Raise `KeyboardInterrupt` again: a search ends early at Ctrl-C, with what it has."""
    if result == RESULTS.interrupted:
        raise KeyboardInterrupt
