"""The contact-mechanics challenge on its published surface (Müser and others 2017).

The surface is public, in files whose names tell their form: HDF5 with a matrix `surface`, text with
a matrix or with rows x, y, h, and the nonzero Fourier coefficients as rows qx, qy, Re h, Im h, in
HDF5 or in text. Heights and lengths are in units of 0.1 mm; qx and qy count waves along the cell.
The transform is FFTW's backward one, without a factor.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import h5py
import jax.numpy as jnp
import numpy as np
from rows import Row

import jaxstab as js

SIDE = 1e-4  # [m], and the unit of the files
MODULUS = 25e6  # E* [Pa]
WORK, RANGE = 50e-3, 2.071e-9  # an exponential law over a hard wall [J/m²], [m]
PRESSURE = 250e3  # the reference load [Pa]
# Other loads at which the area is published, over the reference load.
LOADS = (0.04, 0.2, 1.0, 5.0)
SOURCE = "Müser and others 2017"
MISSING = "in the publication"


def read_surface(path: Path, points: int | None = None) -> np.ndarray:
    """Return the heights [m] of a published file on n x n points.

    Arguments:
        path: the file.
        points: n, of Fourier coefficients; by default the least power of two that has them all.
    """
    table = _read_table(path)
    rows, columns = table.shape
    if columns == 4:
        return SIDE * _synthesis(table, points)
    if columns == 3:
        side = round(rows**0.5)
        order = np.lexsort((table[:, 1], table[:, 0]))
        table = table[order, 2].reshape(side, -1)
    if table.shape[0] != table.shape[1]:
        raise ValueError(
            f"{path} has {rows} rows of {columns} numbers: not a form of the challenge."
        )
    return SIDE * table


def _read_table(path: Path) -> np.ndarray:
    if h5py.is_hdf5(path):
        found: list[np.ndarray] = []
        with h5py.File(path) as file:
            file.visititems(
                lambda _, item: found.append(item[...]) if hasattr(item, "dtype") else None
            )
        tables = [np.atleast_2d(x) for x in found if x.ndim == 2]
        if len(tables) != 1:
            raise ValueError(f"{path} has {len(tables)} tables: the challenge's files have one.")
        return tables[0].astype(float)
    lines = path.read_text().replace(",", " ").splitlines()
    return np.loadtxt(lines, comments="#", ndmin=2)


def _synthesis(table: np.ndarray, points: int | None) -> np.ndarray:
    """Return the sum of h(q) exp(2 pi i (qx x + qy y)) on n x n points of the unit square."""
    waves = table[:, :2].round().astype(int)
    highest = int(np.abs(waves).max())
    n = points or 2 ** int(np.ceil(np.log2(2 * highest + 1)))
    if n <= 2 * highest:
        raise ValueError(f"{n} points do not resolve wave {highest}: give more than {2 * highest}.")
    spectrum = np.zeros((n, n), complex)
    values = table[:, 2] + 1j * table[:, 3]
    # Of a real surface either both of h(q) and h(-q) = h(q)* are given, or one.
    spectrum[tuple(-waves.T)] = values.conj()
    spectrum[tuple(waves.T)] = values
    return n**2 * np.fft.ifft2(spectrum).real


def challenge_rows(
    path: Path, reference: Path | None, points: int | None = None, is_inverted: bool = False
) -> Iterator[Row]:
    """Yield area, gap and distributions on the published surface, beside published numbers.

    Arguments:
        path: a file of the surface.
        reference: published numbers, as JSON: pairs of a pressure [Pa] and the contact fraction
            (`area`) or the mean gap [m] (`gap`); pairs of a pressure [Pa] (`pressures`) or a gap
            [m] (`gaps`) and its density [1/Pa], [1/m].
        points: points a side, for Fourier coefficients.
        is_inverted: whether low points of the file touch first, in place of high ones.
    """
    heights = read_surface(path, points) * (-1 if is_inverted else 1)
    published = json.loads(reference.read_text()) if reference else {}
    grid = js.Grid(heights.shape, (SIDE, SIDE))
    solid, heights = js.HalfSpace(grid, MODULUS), jnp.asarray(heights - heights.mean())
    where = f"challenge as published, {heights.shape[0]}²"
    yield Row(f"{where}: rms slope", SOURCE, 1.0, float(js.surfaces.rms_slope(grid, heights)))
    height = 1e6 * float(js.surfaces.rms_height(heights))
    yield Row(f"{where}: rms height [µm]", SOURCE, MISSING, height)
    bare = js.Contact(solid, heights, js.potentials.NoAdhesion(), unit="m")
    adhesive = js.Contact(solid, heights, js.potentials.Exponential(WORK, RANGE), unit="m")
    yield Row(f"{where}: contact.resolution", "", "above 4", float(adhesive.resolution))
    start = None
    for factor in LOADS:
        load = js.MeanPressure(factor * PRESSURE)
        start = js.equilibrate(bare, load, initial=start)
        # As on approach, adhesion acts on a contact that was made without it.
        pulled = js.equilibrate(adhesive, load, initial=start)
        for contact, state in ((bare, start), (adhesive, pulled)):
            setting = f"{where}, {'adhesive' if contact is adhesive else 'no adhesion'}"
            yield from _numbers(setting, contact, state, published)
            if factor == 1:
                yield from _distributions(setting, state, published)


def _numbers(
    where: str, contact: js.Contact, state: js.results.Equilibrium, published: dict
) -> Iterator[Row]:
    pressure = float(state.mean_pressure)
    setting = f"{where}, {pressure / 1e3:.4g} kPa"
    # The published numbers are those with adhesion.
    known = published if "no adhesion" not in where else {}
    counted = float(state.contact_area)
    corrected = float(js.patches(contact, state).true_area) / SIDE**2
    for name, key, ours, unit in (
        ("contact as counted [%]", "area", 100 * counted, 0.01),
        ("corrected contact [%]", "area", 100 * corrected, 0.01),
        ("mean gap [µm]", "gap", 1e6 * float(state.mean_gap), 1e-6),
    ):
        yield Row(f"{setting}: {name}", SOURCE, _value(known.get(key), pressure, unit), ours)


def _value(pairs: list | None, at: float, unit: float) -> float | str:
    """Return the published number, interpolated within its range."""
    if not pairs:
        return MISSING
    x, y = np.array(sorted(pairs)).T
    return float(np.interp(at, x, y)) / unit if 0.999 * x[0] <= at <= 1.001 * x[-1] else MISSING


def _distributions(where: str, state: js.results.Equilibrium, published: dict) -> Iterator[Row]:
    """Yield the densities of the pressure in contact and of the gap elsewhere, over the cell."""
    touches = np.asarray(state.in_contact)
    known = published if "no adhesion" not in where else {}
    for name, key, field, unit, scale in (
        ("pressure [kPa]", "pressures", np.asarray(state.pressure)[touches], 1e3, MODULUS),
        ("gap [µm]", "gaps", np.asarray(state.gap)[~touches], 1e-6, None),
    ):
        limit = np.quantile(field, 0.995) if field.size else 0.0
        edges = np.linspace(0, max(limit, 1e-3 * (scale or limit or 1.0)), 11)
        counts = np.histogram(field, edges)[0]
        densities = counts / (touches.size * np.diff(edges))
        for middle, density in zip((edges[1:] + edges[:-1]) / 2, densities, strict=True):
            setting = f"{where}: density at a {name.replace(' [', f' of {middle / unit:.3g} [')}"
            yield Row(setting, SOURCE, _value(known.get(key), middle, 1 / unit), density * unit)
