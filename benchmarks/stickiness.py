"""Pull-offs of self-affine surfaces as ever shorter waves are added: the table of a study.

Shorter waves are added to a reference, whose own waves keep their heights. The reference gives the
units of adhesion, range and load. E* and the side of the cell are 1.

    python benchmarks/stickiness.py FOLDER --output benchmarks/results/stickiness.nc

A second call goes on where the first has ended.
"""

import itertools
import warnings

import jax
import jax.numpy as jnp
from study_data import describe, make_data

import jaxstab as js

jax.config.update("jax_enable_x64", True)

# The reference has waves from the longest down to a fourth of it, and this rms height.
REFERENCE = 4
RMS_HEIGHT = 0.01
HURST = 0.8, 0.3, 0.5, 0.7, 0.9
# What is held while waves are added, with its value, and the adhesion.
SETTINGS = (
    ("range", 0.5, 0.5),
    ("Tabor", 0.5, 0.5),
    ("range", 0.5, 2.5),
    ("Tabor", 0.5, 2.5),
    ("range", 0.5, 1.0),
    ("Tabor", 0.5, 1.0),
    ("range", 0.25, 0.1),
    ("range", 0.25, 0.5),
    ("range", 0.5, 0.1),
    ("range", 0.25, 0.02),
    ("range", 1.0, 0.5),
)
PRESSED = 0.5


def surface(points, seed, hurst, longest, cutoff):
    """Return the waves of the reference, and those up to a cut-off over the longest wave."""
    grid, key = js.Grid(points), jax.random.key(seed)
    waves = {"hurst": hurst, "k_low": longest}
    reference = js.surfaces.self_affine(
        grid, key, **waves, k_high=REFERENCE * longest, rms_height=RMS_HEIGHT
    )
    heights = js.surfaces.self_affine(grid, key, **waves, k_high=cutoff * longest, rms_height=1.0)
    # The waves are orthogonal, and those of the reference are the same but for a factor.
    scale = jnp.sum(reference * reference) / jnp.sum(reference * heights)
    return reference, scale * heights


def contact_of(points, seed, hurst, longest, cutoff, held, value, theta):
    """Return a contact and the elastic energy that flattens its reference [per area].

    Adhesion is `theta` of that energy. The range of the law is `value` of the rms height if the
    range is `held`, otherwise it follows from Tabor's parameter of the rms curvature.
    """
    reference, heights = surface(points, seed, hurst, longest, cutoff)
    solid = js.HalfSpace(js.Grid(points), 1.0)
    flattening = float(js.surfaces.full_contact_energy(solid, reference))
    work = theta * flattening
    length = value * RMS_HEIGHT
    if held == "Tabor":
        curvature = float(js.surfaces.rms_curvature(solid.grid, heights))
        length = (work**2 / curvature) ** (1 / 3) / value
    return js.Contact(solid, heights, js.potentials.Exponential(work, length)), flattening


def pulled(points, seed, hurst, longest, cutoff, held, value, theta, pressed):
    """Return the pull-off of a contact that was pressed, its areas, and its surface's numbers."""
    warnings.simplefilter("ignore", js.exceptions.ResolutionWarning)
    contact, flattening = contact_of(points, seed, hurst, longest, cutoff, held, value, theta)
    grid, heights = contact.grid, contact.heights
    load = js.MeanPressure(pressed * flattening / RMS_HEIGHT)
    start = js.equilibrate(contact, load)
    unloaded = js.equilibrate(contact, js.MeanPressure(0.0), initial=start)
    pull = js.pull_off(contact, initial=start)
    return {
        "work": contact.potential.surface_energy,
        "range": contact.potential.length,
        "resolution": contact.resolution,
        "flattening": flattening,
        "full_flattening": js.surfaces.full_contact_energy(contact.solid, heights),
        "rms_height": js.surfaces.rms_height(heights),
        "rms_slope": js.surfaces.rms_slope(grid, heights),
        "rms_curvature": js.surfaces.rms_curvature(grid, heights),
        "pull_off": -pull.load.value,
        "kind": pull.kind.name,
        "pressed_area": start.contact_area,
        "unloaded_area": unloaded.contact_area,
        "last_area": pull.equilibrium.contact_area,
    }


STANDARD = {"longest": 1, "pressed": PRESSED}


def block(points, cutoffs, settings=SETTINGS, hurst=HURST, seeds=range(3), **others):
    """Return the cases of some surfaces and settings."""
    return [
        STANDARD
        | {"points": points, "cutoff": cutoff, "hurst": h, "seed": seed}
        | dict(zip(("held", "value", "theta"), setting, strict=True))
        | others
        for seed, setting, h, cutoff in itertools.product(seeds, settings, hurst, cutoffs)
    ]


WEAK, STRONG, REST = SETTINGS[:2], SETTINGS[2:4], SETTINGS[4:]
STIFF = ("Tabor", 0.25, 0.5), ("Tabor", 0.25, 2.5)
# Their ranges need sixteen points to the shortest wave, where the others need four.
SOFT = ("Tabor", 1.0, 0.5), ("Tabor", 1.0, 2.5)
EXTREMES = 0.8, 0.3
BLOCKS = (
    block(64, (4, 8, 16), WEAK + STRONG),
    block(128, (32,), WEAK + STRONG),
    block(64, (4, 8, 16), REST + STIFF),
    block(128, (32,), REST + STIFF),
    block(64, (4,), SOFT),
    block(128, (8,), SOFT),
    block(256, (16,), SOFT),
    # Higher cut-offs.
    block(256, (64,), WEAK + STRONG),
    block(256, (64,), REST[:3], seeds=(0,)),
    block(256, (64,), STIFF, EXTREMES, seeds=(0,)),
    block(512, (32,), SOFT, seeds=(0,)),
    block(512, (128,), WEAK + STRONG, seeds=(0,)),
    block(512, (128,), WEAK, EXTREMES, seeds=(1, 2)),
    block(1024, (256,), WEAK, EXTREMES, seeds=(0,)),
    # Finer grids, a larger load before, and larger cells.
    block(128, (16,), WEAK + STRONG),
    block(256, (32,), WEAK + STRONG, seeds=(0,)),
    block(128, (4,), SOFT, EXTREMES, seeds=(0,)),
    block(256, (8,), SOFT, EXTREMES, seeds=(0,)),
    block(64, (4, 16), WEAK + STRONG, EXTREMES, seeds=(0,), pressed=2 * PRESSED),
    # Here 64² points do not resolve the range of the other strong setting.
    block(64, (4, 8), WEAK + STRONG[1:], EXTREMES, longest=2),
    block(128, (16,), WEAK + STRONG[1:], EXTREMES, longest=2),
)

VARIABLES = {
    "points": ("points along a side", ""),
    "seed": ("key of the surface", ""),
    "hurst": ("Hurst exponent", ""),
    "longest": ("waves per side of the longest wave", ""),
    "cutoff": ("shortest wave over the longest, as a number of waves", ""),
    "held": ("quantity held while waves are added: the range, or Tabor's parameter", ""),
    "value": ("range over the rms height of the reference, or Tabor's parameter", ""),
    "theta": ("work of adhesion over `flattening`", ""),
    "pressed": ("pressure before the unloading times rms height over `flattening`", ""),
    "work": ("work of adhesion w of the law -w exp(-g / range)", "E* side"),
    "range": ("range of the law", "side"),
    "resolution": ("stiffness of the grid's shortest wave over the largest |f''|", ""),
    "flattening": ("elastic energy per area of the flattened reference", "E* side"),
    "full_flattening": ("elastic energy per area of the flattened surface", "E* side"),
    "rms_height": ("rms height of the surface", "side"),
    "rms_slope": ("rms slope of the surface", ""),
    "rms_curvature": ("rms curvature of the surface", "1 / side"),
    "pull_off": ("largest mean tension under a dead load", "E*"),
    "kind": ("end of the last branch, a fold or a release", ""),
    "pressed_area": ("part of the points in contact under the pressure", ""),
    "unloaded_area": ("part of the points in contact once unloaded", ""),
    "last_area": ("part of the points in contact before the pull-off", ""),
    "seconds": ("time of the case on a busy machine", "s"),
}


def documented(study):
    """Return the data set of a study with the meaning and the unit of each variable."""
    return describe(study, VARIABLES, "Pull-offs of self-affine surfaces over the cut-off")


if __name__ == "__main__":
    make_data(__doc__, pulled, BLOCKS, documented)
