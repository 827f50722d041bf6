"""Areas of rough viscoelastic contacts under a load that is held and then lowered: a study's table.

A rough surface is pressed onto a viscoelastic half space. The load is held for a waiting time and
then lowered to a part of it. The relaxed E* and the side of the cell are 1, times are in seconds.

    python benchmarks/memory.py FOLDER --output benchmarks/results/memory.nc

A second call goes on where the first has ended.
"""

import itertools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import xarray
from study_data import describe, make_data

import jaxstab as js

jax.config.update("jax_enable_x64", True)

RMS_HEIGHT = 0.01
# S. Dillavou and S. M. Rubinstein, PRL 120, 224101 (2018), figure 1: the load rises to 100 N in
# 2.3 s, and it falls to 25 N in about 1.5 s after a waiting time of 1000 s.
LOADING, UNLOADING = 2.3, 1.5
WAITS = 10.0, 100.0, 1000.0
# Since the first contact, in seconds, and since the end of the unloading, over the waiting time.
DWELL = np.logspace(1, 3, 9)
AFTER = np.append(0, np.logspace(-3, 1, 17))
LATER = np.append(DWELL, np.logspace(3.25, 4, 4))
# From below the loading time to beyond the longest evolution, two for each factor of ten.
TIMES = np.logspace(-2, 6, 17)


def creep(seconds):
    """Return a compliance of PMMA over its value at once.

    The exponent is the one of four-point bending over 450 h (doctoral thesis, core.ac.uk 4442155),
    the rise in 1000 s the one of `relaxation`.
    """
    return 1 + 0.263 * (seconds / 1000) ** 0.24


def growth(seconds):
    """Return the compliance with which a contact without adhesion grows as the measured one.

    Read from figure 1 of Dillavou and Rubinstein: the area is 2.58 mm^2 after 10 s and 3.20 mm^2
    after 1000 s, and linear in the logarithm of time.
    """
    return 1.034343 + 0.137 * np.log10(seconds)


def solid_of(grid, spectrum):
    """Return a half space of one of the relaxation functions."""
    relaxed = js.HalfSpace(grid, 1.0, 0.0)
    if spectrum == "relaxation":
        # In MPa and s: fitted by W. W. Chen, Q. J. Wang, Z. Huan and X. Luo, J. Tribol. 133, 041404
        # (2011), to PMMA of M. V. R. Kumar and R. Narasimhan, Curr. Sci. 87, 1088 (2004).
        return js.Viscoelastic(relaxed, np.array([184.62, 191.06]) / 1429.71, (8.93, 117.96))
    if spectrum == "lines":
        # The one of notebooks/ageing.ipynb, with its times of 1e-3 to 1e3 in units of 100 s.
        times = np.logspace(-1, 5, 13)
        return js.Viscoelastic(relaxed, 30 * times**-0.25 / np.sum(times**-0.25), times)
    compliance = {"creep": creep, "growth": growth}[spectrum]
    # The modulus is 1 / J, since J is a small power of time. Each term has what the modulus loses
    # around its time; exp(-t / t_k) falls, on average of log t, at t_k exp(-gamma).
    bins = np.append(TIMES / 10**0.25, TIMES[-1] * 10**0.25) * np.exp(-np.euler_gamma)
    modulus = 1 / compliance(bins)
    return js.Viscoelastic(relaxed, -np.diff(modulus) / modulus[-1], TIMES)


def contact_of(points, seed, hurst, longest, shortest, spectrum, theta, length):
    """Return a contact and the elastic energy that flattens its surface [per area].

    Adhesion is `theta` of this energy of the relaxed solid, the range `length` rms heights.
    """
    grid = js.Grid(points)
    heights = js.surfaces.self_affine(
        grid,
        jax.random.key(seed),
        hurst=hurst,
        k_low=longest,
        k_high=shortest,
        rms_height=RMS_HEIGHT,
    )
    solid = solid_of(grid, spectrum)
    flattening = float(js.surfaces.full_contact_energy(solid.relaxed, heights))
    law = js.potentials.NoAdhesion()
    if theta:
        law = js.potentials.Exponential(theta * flattening, length * RMS_HEIGHT)
    return js.Contact(solid, heights, law), flattening


def fresh(contact, pressure):
    """Return a state of the relaxed contact before it is pressed."""
    relaxed = js.Contact(contact.solid.relaxed, contact.heights, contact.potential)
    if isinstance(contact.potential, js.potentials.NoAdhesion):
        return js.equilibrate(relaxed, js.MeanPressure(1e-3 * pressure))
    # Beyond this gap the law has decayed to exp(-12).
    far = float(contact.heights.max() + 12 * contact.potential.length)
    return js.equilibrate(relaxed, js.MeanGap(far))


def touching(run):
    """Return where an evolution is in contact: a row for each time."""
    return np.asarray(run.fields.gap).reshape(run.times.size, -1) == 0


def held_and_lowered(contact, pressure, ratio, ramp, rtol):
    """Return evolutions under the held load, under the lowered one, and under the latter alone.

    The lowered load is `ratio` of the held one. `ramp` multiplies the times of loading and
    unloading.
    """
    options = {"rtol": rtol, "fields": True, "max_steps": 4000, "progress": False}

    def held(value, times, **start):
        values = np.append(start.pop("first"), np.full(times.size - 1, value))
        return js.evolve(contact, js.MeanPressure(jnp.asarray(values)), times, **start, **options)

    before = fresh(contact, pressure)
    times = np.concatenate([[0, ramp * LOADING], DWELL])
    dwell = held(pressure, times, first=0.01 * pressure, initial=before)
    times = np.concatenate([[0, ramp * LOADING], LATER])
    always = held(ratio * pressure, times, first=0.01 * ratio * pressure, initial=before)
    lowered = []
    for wait in WAITS:
        end = dwell[2 + int(np.argmin(np.abs(DWELL - wait)))]
        times = np.append(0, ramp * UNLOADING + wait * AFTER)
        lowered.append(held(ratio * pressure, times, first=pressure, initial=end)[1:])
    return dwell[1:], lowered, always[1:]


def two_steps(
    points, seed, hurst, longest, shortest, spectrum, theta, length, pressed, ratio, ramp, rtol
):
    """Return areas while a load is held and after it is lowered, and the points that change."""
    warnings.simplefilter("ignore")
    contact, flattening = contact_of(
        points, seed, hurst, longest, shortest, spectrum, theta, length
    )
    slope = float(js.surfaces.rms_slope(contact.grid, contact.heights))
    dwell, lowered, always = held_and_lowered(contact, pressed * slope, ratio, ramp, rtol)
    found = {name: [] for name in ("area", "opened", "closed", "again")}
    found |= {"patches": [], "shrinking": [], "vanishing": [], "regrowing": []}
    for wait, run in zip(WAITS, lowered, strict=True):
        now = touching(run)
        first = now[0]
        before = touching(dwell)[1 + int(np.argmin(np.abs(DWELL - wait)))]
        found["area"].append(now.mean(axis=1))
        found["opened"].append((first & ~now).mean(axis=1))
        found["closed"].append((~first & now).mean(axis=1))
        found["again"].append((~first & before & now).mean(axis=1))
        sizes = patch_sizes(run, now)
        least = sizes.min(axis=0)
        shrinks = least < sizes[0]
        found["patches"].append(sizes.shape[1])
        found["shrinking"].append(np.sum(shrinks))
        found["vanishing"].append(np.sum(least == 0))
        found["regrowing"].append(np.sum(shrinks & (sizes[-1] > least)))
    dims = "wait", "after"
    outputs = {name: (dims[: np.ndim(rows)], np.array(rows)) for name, rows in found.items()}
    outputs |= {
        "dwell": ("held", touching(dwell).mean(axis=1)),
        "always": ("since", touching(always).mean(axis=1)),
        "rms_slope": slope,
        "flattening": flattening,
        "resolution": float(contact.resolution) if theta else np.inf,
        "jumps": sum(run.jump_times.size for run in lowered),
        "num_steps": sum(int(np.sum(run.num_steps)) for run in (dwell, always, *lowered)),
    }
    return xarray.Dataset(outputs)


def patch_sizes(run, now):
    """Return how many points of each patch of the first state are in contact, at each time."""
    labels = np.asarray(js.patches(*run[0].instant).labels).ravel()
    return np.array([np.bincount(labels[each], minlength=labels.max() + 1) for each in now])[:, 1:]


def published_theta(rms_height):
    """Return `theta` of two blocks of PMMA with an rms height in metres.

    The surface energy is half of w. The rms slope is the one with which the area of figure 1 of
    Dillavou and Rubinstein carries its load elastically: the mean pressure on it is E* h' / 2.
    """
    grid = js.Grid(64)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(0), hurst=0.8, k_low=4, k_high=16, rms_height=RMS_HEIGHT
    )
    scale = rms_height / RMS_HEIGHT
    side = scale * float(js.surfaces.rms_slope(grid, heights)) / RMS_SLOPE
    solid = js.HalfSpace(js.Grid(64, side), RELAXED_MODULUS / 2, POISSON)
    return 2 * SURFACE_ENERGY / float(js.surfaces.full_contact_energy(solid, scale * heights))


# Critical surface tension of PMMA in J/m^2 (Accu Dyne Test, table 3); w is that of two surfaces.
SURFACE_ENERGY = 0.0375
# The relaxed Young's modulus of `relaxation` in Pa; Poisson's ratio is typically 0.35 to 0.4.
RELAXED_MODULUS, POISSON = 1429.71e6, 0.35
# 100 N on 2.27 to 3.20 mm^2.
RMS_SLOPE = 0.08
# No adhesion, that of rms heights of 1.8 um (lapped) and 11 nm (extruded), the extremes of Dillavou
# and Rubinstein, between them and beyond. Ranges are those that 64^2 points resolve.
LENGTHS = {0.0: 0.2, 0.0028: 0.033, 0.025: 0.1, 0.1: 0.2, 0.45: 0.42, 1.5: 0.77}

STANDARD = {
    "points": 64,
    "hurst": 0.8,
    "longest": 4,
    "shortest": 16,
    "spectrum": "growth",
    "pressed": 0.04,
    "ratio": 0.25,
    "ramp": 1.0,
    "rtol": 1e-3,
}
LARGE = {"points": 128, "longest": 8, "shortest": 32}


def block(thetas=(0.1,), seeds=range(3), **changes):
    """Return the cases of some adhesions and surfaces."""
    return [
        STANDARD | {"seed": seed, "theta": theta, "length": LENGTHS[theta]} | changes
        for seed, theta in itertools.product(seeds, thetas)
    ]


# In the order of their worth: what a short time allows comes first.
BLOCKS = (
    block(LENGTHS),
    block((0.0, 0.1, 0.45), spectrum="relaxation"),
    block((0.0, 0.1, 0.45), spectrum="creep"),
    block((0.0, 0.1, 0.45), spectrum="lines"),
    block((0.0, 0.1, 0.45), ratio=0.1),
    block(ratio=0.5),
    block((0.0, 0.1, 0.45), ramp=1e-3),
    block(rtol=2.5e-4),
    block(length=0.4),
    block((0.1, 0.45), seeds=range(3, 6)),
    block(spectrum="relaxation", seeds=range(3, 6)),
    block(pressed=0.02),
    block(pressed=0.08),
    block(hurst=0.5),
    block(longest=2),
    block((0.0, 0.1), seeds=(0,), **LARGE),
    block(seeds=(0,), points=128),
    block(seeds=(0,), points=128, length=0.14),
    block((0.45,), points=128, length=0.3),
    block((0.45,), seeds=(0,), points=256, length=0.21),
    block((0.1, 0.45), seeds=(0, 1), **LARGE),
    block(seeds=(2,), **LARGE),
    block((0.025,), points=128, length=0.07),
    block((0.0028,), points=128, length=0.023),
    block(points=128),
    block(points=128, length=0.14),
    block((0.45,), seeds=(1,), points=256, length=0.21),
    block((0.0, 0.45), seeds=(0,), points=128),
    block(points=128, shortest=32),
    block((0.0,), seeds=(1,), **LARGE),
    block(seeds=(0,), points=256, longest=8, shortest=64),
    block((0.45,), seeds=(2,), points=256, length=0.21),
    block((0.0, 0.45), **LARGE),
    block(spectrum="relaxation", **LARGE),
    block(seeds=(0,), points=256, length=0.1),
    block(seeds=(0,), points=256, longest=16, shortest=64),
    block((0.0, 0.1), points=256, longest=8, shortest=64),
)

VARIABLES = {
    "wait": ("time for which the load is held, from the first contact on", "s"),
    "after": ("time since the end of the unloading over the waiting time", ""),
    "held": ("time since the first contact", "s"),
    "since": ("time since the first contact", "s"),
    "points": ("points along a side", ""),
    "seed": ("key of the surface", ""),
    "hurst": ("Hurst exponent", ""),
    "longest": ("waves per side of the longest wave", ""),
    "shortest": ("waves per side of the shortest wave", ""),
    "spectrum": ("relaxation function: see `solid_of` in benchmarks/memory.py", ""),
    "theta": ("work of adhesion over `flattening`", ""),
    "length": ("range of the exponential law over the rms height", ""),
    "pressed": ("held mean pressure over the rms slope", "relaxed E*"),
    "ratio": ("lowered load over the held one", ""),
    "ramp": ("times of loading and unloading over 2.3 s and 1.5 s", ""),
    "rtol": ("tolerance of the time steps", ""),
    "area": ("part of the points in contact", ""),
    "opened": ("part of the points that are open and touched after the unloading", ""),
    "closed": ("part of the points that touch and were open after the unloading", ""),
    "again": ("those of `closed` that touched while the load was held", ""),
    "patches": ("number of patches after the unloading", ""),
    "shrinking": ("patches that lose a point", ""),
    "vanishing": ("patches that lose all points", ""),
    "regrowing": ("patches that lose a point and gain one later", ""),
    "dwell": ("part of the points in contact while the load is held", ""),
    "always": ("part of the points in contact that has always carried the lowered load", ""),
    "rms_slope": ("rms slope of the surface", ""),
    "flattening": ("elastic energy per area of the flattened surface, relaxed", "E* side"),
    "resolution": ("stiffness of the grid's shortest wave over the largest |f''|", ""),
    "jumps": ("jumps after the unloading", ""),
    "num_steps": ("time steps of all evolutions", ""),
    "seconds": ("time of the case on a busy machine", "s"),
}


def documented(study):
    """Return the data set of a study with its times, and the meaning and unit of each variable."""
    times = {"wait": list(WAITS), "after": AFTER}
    times |= {"held": np.append(LOADING, DWELL), "since": np.append(LOADING, LATER)}
    title = "Areas of rough contacts after a load is held and lowered"
    return describe(study.assign_coords(times), VARIABLES, title)


if __name__ == "__main__":
    make_data(__doc__, two_steps, BLOCKS, documented)
