"""The contact, the loads and the result that options describe."""

import argparse
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxstab import loads, potentials, surfaces
from jaxstab.cli.options import LOADS, OF_A_FILE, SPECTRUM
from jaxstab.contact import Contact
from jaxstab.core.grid import Grid
from jaxstab.files import load
from jaxstab.files.dataset import Result
from jaxstab.potentials.profile import innermost_gap
from jaxstab.solids import HalfSpace


def surface_of(path: Path, options: argparse.Namespace) -> surfaces.Topography:
    """Return the surface of a file as it is."""
    lengths, unit, channel = (getattr(options, name) for name in OF_A_FILE)
    if lengths is not None and len(lengths) == 1:
        # A single length applies to all sides.
        lengths = lengths[0]
    return surfaces.read(path, lengths, unit, channel)


def contact_of(options: argparse.Namespace) -> Contact:
    """Return the contact that the options describe."""
    if options.surface is not None:
        heights = topography_of(options.surface, options)
        grid = heights.grid
    else:
        grid = Grid(options.size)
        spectrum = {name: getattr(options, name) for name in SPECTRUM}
        heights = surfaces.self_affine(grid, jax.random.key(options.seed), **spectrum)
    solid = HalfSpace(grid, options.youngs_modulus, options.poisson_ratio)
    return Contact(solid, heights, _potential(options), pressure_unit=options.pressure_unit)


def topography_of(path: Path, options: argparse.Namespace) -> surfaces.Topography:
    """Return the surface of a file, without trend and gaps."""
    topography = surface_of(path, options).levelled(options.detrend)
    if options.periodic:
        topography = topography.periodic(options.periodic)
    # Default loads are gaps and displacements alike, which needs heights of zero mean.
    return topography.detrended(0)


def _potential(options: argparse.Namespace) -> potentials.Potential:
    if options.potential == "none":
        return potentials.NoAdhesion()
    parameters = [options.surface_energy, options.range]
    if options.smoothing is not None:
        parameters.append(options.smoothing)
    return getattr(potentials, options.potential.title().replace("-", ""))(*parameters)


def loads_of(
    options: argparse.Namespace, contact: Contact, shares: Sequence[float] | np.ndarray
) -> loads.Load:
    """Return loads at shares of the way from the first to the last."""
    rms = float(np.std(contact.heights))
    first = options.first
    if first is None:
        # Pressures inside of a core are unbounded.
        first = innermost_gap(contact.profile) + 1e-4 * rms
    last = options.last
    if last is None:
        last = first + 20 * rms
    values = jnp.asarray(first + (last - first) * np.asarray(shares))
    kind = getattr(loads, LOADS[options.load])
    if options.stiffness is None:
        return kind(values)
    return kind(values, options.stiffness)


def load_file(options: argparse.Namespace) -> tuple[Contact, Result]:
    """Return the contact and the result of a file, in double precision."""
    jax.config.update("jax_enable_x64", True)
    for name in vars(options)["import"]:
        import_module(name)
    return load(options.file)
