"""The options that describe a contact and its loads."""

import argparse
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxstab import surfaces
from jaxstab.cli.parsing import Parser, number, whole_number
from jaxstab.contact import Contact
from jaxstab.core.display import times
from jaxstab.core.grid import Grid
from jaxstab.core.warn import warn
from jaxstab.loads import Load, MeanDisplacement, MeanGap, MeanPressure, Spring
from jaxstab.potentials import (
    Dugdale,
    Exponential,
    Gaussian,
    LennardJones,
    NoAdhesion,
    Potential,
    Rational,
)
from jaxstab.potentials.profile import innermost_gap
from jaxstab.solids import HalfSpace

LAWS = {
    "exponential": Exponential,
    "gaussian": Gaussian,
    "rational": Rational,
    "dugdale": Dugdale,
    "lennard-jones": LennardJones,
}
LOADS = {"gap": MeanGap, "displacement": MeanDisplacement, "pressure": MeanPressure}
_LOAD_KINDS = [*LOADS, "spring"]
# What belongs to a surface that is made here, and its defaults.
_GENERATED: dict[str, Any] = {
    "size": 256,
    "seed": 0,
    "hurst": 0.8,
    "k_low": 2.0,
    "k_rolloff": None,
    "k_high": 32.0,
    "rms_height": 0.1,
}
# What a file of a surface may leave to say.
OF_A_FILE = ("lengths", "unit", "channel")
_MEASURED: dict[str, Any] = {**dict.fromkeys(OF_A_FILE), "detrend": 1, "periodic": None}
# Those of the paper's example, which suit the surface made here.
_MATERIAL: dict[str, Any] = {"youngs_modulus": 1e-3, "surface_energy": 1e-2, "range": 1.0}
_DEFAULTS = {**_GENERATED, **_MEASURED, **_MATERIAL}


def add_options(parser: Parser) -> None:
    """Add the options of surface, solid, law and loads."""
    add = parser.add_argument_group("generated surface (cut-offs in waves per side)").add_argument
    add("--size", type=whole_number(2), help=f"points along a side{_default('size')}")
    add("--seed", type=whole_number(0, 2**32 - 1), help=f"seed of the surface{_default('seed')}")
    add("--hurst", type=number, help=f"Hurst exponent{_default('hurst')}")
    add("--k-low", type=number, help=f"lower cut-off{_default('k_low')}")
    add("--k-rolloff", type=number, help="roll-off (default: the lower cut-off)")
    add("--k-high", type=number, help=f"upper cut-off{_default('k_high')}")
    add("--rms-height", type=number, help=f"rms height{_default('rms_height')}")
    add_file_options(parser, "measured surface", "--surface")
    add = parser.add_argument_group("treatment of a measured surface").add_argument
    help = f"order of the trend that is removed{_default('detrend')}"
    add("--detrend", type=whole_number(0, 2), help=help)
    help = "how to make its edges meet (default: as they are, with a warning)"
    add("--periodic", choices=["window", "mirror", "as_is"], help=help)
    add = parser.add_argument_group("solid and adhesion (all needed with --surface)").add_argument
    add("--youngs-modulus", type=number, help=f"E{_default('youngs_modulus')}")
    add("--poisson-ratio", type=number, default=0.0, help="nu (default %(default)g)")
    choices = [*LAWS, "none"]
    add("--potential", choices=choices, default=choices[0], help="law (default %(default)s)")
    help = f"work of adhesion w, twice gamma of equal surfaces{_default('surface_energy')}"
    add("--surface-energy", type=number, help=help)
    add("--range", type=number, help=f"rho{_default('range')}")
    help = "edge width of Dugdale's law, over rho (default 0.1)"
    add("--smoothing", type=number, help=help)
    add = parser.add_argument_group("loads").add_argument
    add("--load", choices=_LOAD_KINDS, default="gap", help="kind of load (default %(default)s)")
    add("--stiffness", type=number, help="stiffness of the spring")
    help = "first load (default of a gap: 1e-4 rms heights, above the minimum of a law with a core)"
    add("--first", type=number, help=help)
    add("--last", type=number, help="last load (default of a gap: 20 rms heights more)")


def _default(name: str) -> str:
    """Return the default of an option in words, for its help."""
    return f" (default {_DEFAULTS[name]:g})"


def add_file_options(parser: Parser, title: str, *names: str) -> None:
    """Add the options of a measured surface."""
    add = parser.add_argument_group(title).add_argument
    for name in names:
        add(name, type=Path, metavar="FILE", help="a scan: text, xyz, npy, NetCDF, x3p, gwy, ...")
    help = "lengths of its sides, if the file has none"
    add("--lengths", type=number, nargs="+", metavar="L", help=help)
    add("--unit", help="unit of lengths and heights, if the file has none")
    add("--channel", help="channel to read (default: the first with heights)")


def surface_of(path: Path, options: argparse.Namespace) -> surfaces.Topography:
    """Return the surface of a file as it is."""
    return surfaces.read(path, *(getattr(options, name) for name in OF_A_FILE))


def settle(parser: Parser, options: argparse.Namespace) -> None:
    """Refuse options that do not belong together, and set the defaults of the others."""
    is_measured = options.surface is not None
    others, reason = (
        (_GENERATED, "describes a generated surface: leave it out with --surface")
        if is_measured
        else (_MEASURED, "belongs to --surface")
    )
    for name in others:
        if getattr(options, name) is not None:
            parser.refuse(name, reason)
    for name in _MATERIAL:
        is_given = getattr(options, name) is not None
        is_needed = options.potential != "none" or name == "youngs_modulus"
        if is_given and not is_needed:
            parser.refuse(name, "belongs to a law, not to --potential none")
        if is_measured and is_needed and not is_given:
            parser.refuse(name, "is needed with --surface, in the units of the surface")
    if options.smoothing is not None and options.potential != "dugdale":
        parser.refuse("smoothing", "belongs to --potential dugdale")
    if (options.stiffness is not None) != (options.load == "spring"):
        parser.refuse("stiffness", "belongs to --load spring, which needs it")
    for name in ("first", "last"):
        if options.load not in ("gap", "displacement") and getattr(options, name) is None:
            parser.refuse(name, f"is needed with --load {options.load}")
    for name, value in _DEFAULTS.items():
        if getattr(options, name) is None:
            setattr(options, name, value)


def contact_of(options: argparse.Namespace) -> Contact:
    """Return the contact that the options describe."""
    if options.surface is not None:
        heights = topography_of(options)
        grid = heights.grid
    else:
        grid = Grid(options.size)
        heights = surfaces.self_affine(
            grid,
            jax.random.key(options.seed),
            **{name: getattr(options, name) for name in _GENERATED if name not in ("size", "seed")},
        )
    solid = HalfSpace(grid, options.youngs_modulus, options.poisson_ratio)
    return Contact(solid, heights, _potential(options))


def topography_of(options: argparse.Namespace) -> surfaces.Topography:
    """Return the surface of a file, without gaps and trend."""
    topography = surface_of(options.surface, options)
    if topography.num_missing:
        share = topography.num_missing / topography.heights.size
        warn(f"{100 * share:.3g} % of the points were missing and have been filled.")
        topography = topography.filled()
    topography = topography.detrended(options.detrend)
    return topography.periodic(options.periodic) if options.periodic else topography


def _potential(options: argparse.Namespace) -> Potential:
    if options.potential == "none":
        return NoAdhesion()
    parameters = [options.surface_energy, options.range]
    if options.smoothing is not None:
        parameters.append(options.smoothing)
    return LAWS[options.potential](*parameters)


def loads_of(options: argparse.Namespace, contact: Contact, shares: Any) -> Load:
    """Return loads at shares of the way from the first to the last."""
    rms = float(np.std(contact.heights))
    # Inside of a core pressures know no bounds.
    innermost = innermost_gap(contact.profile)
    first = innermost + 1e-4 * rms if options.first is None else options.first
    last = first + 20 * rms if options.last is None else options.last
    values = jnp.asarray(first + (last - first) * np.asarray(shares))
    if options.load == "spring":
        return Spring(values, options.stiffness)
    return LOADS[options.load](values)


def described(options: argparse.Namespace, contact: Contact) -> str:
    """Describe the problem, in lines."""
    shape = times(contact.grid.shape)
    what = f"Self-affine surface {options.seed}"
    if options.surface is not None:
        unit = f" {contact.unit}" if contact.unit else ""
        lengths = times(map(float, contact.grid.lengths), ".4g")
        what = f"{options.surface.name}, {lengths}{unit}"
    law = options.potential
    if law != "none":
        law += f", w = {options.surface_energy:g}, rho = {options.range:g}"
    return (
        f"{what}, {shape} points, rms height {float(np.std(contact.heights)):.4g}\n"
        f"Half space, E = {options.youngs_modulus:g}, nu = {options.poisson_ratio:g}; "
        f"adhesion: {law}; {contact.heights.dtype}\n"
    )
