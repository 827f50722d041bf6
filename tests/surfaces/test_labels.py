"""Labels, counted points and units that heights and numbers carry: honoured, or refused."""

import datetime

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray

import jaxstab as js

GRID = js.Grid((8, 6), (8.0, 6.0))
HEIGHTS = np.random.default_rng(0).normal(size=GRID.shape) / 100
LAW = js.potentials.Exponential(0.01, 0.5)


class Quantity:
    """As of pint: a magnitude with units, which NumPy would take for its number."""

    def __init__(self, magnitude, units):
        self.magnitude, self.units = magnitude, units

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.magnitude, dtype)


class OfAstropy(np.ndarray):
    """As of astropy: an array with a unit and a value."""

    unit = "nm"
    value = property(np.asarray)


CARRIERS = {
    "pint": (Quantity(100.0, "nanometer"), r"Quantity in nanometer.*magnitude"),
    "astropy": (np.ones(()).view(OfAstropy), r"in nm.*to_value"),
    "xarray": (xarray.DataArray(1.0, attrs={"units": "nm"}), r"DataArray in nm.*\.values"),
    "numpy": (np.timedelta64(3, "s"), "timedelta64, a time with a unit"),
    "pandas": (pd.Timedelta("3s"), "Timedelta, a time with a unit"),
    "python": (datetime.timedelta(seconds=3), "timedelta, a time with a unit"),
}


@pytest.mark.parametrize("kind", CARRIERS)
def test_a_number_that_carries_a_unit_is_refused(kind):
    value, message = CARRIERS[kind]
    solid = js.HalfSpace(GRID, 1.0)
    takers = (
        js.MeanGap,
        lambda length: js.potentials.Exponential(0.01, length),
        lambda modulus: js.HalfSpace(GRID, modulus),
        lambda time: js.Viscoelastic(solid, 1.0, time),
        lambda radius: js.surfaces.paraboloid(GRID, radius),
        lambda length: js.Grid(8, length),
    )
    for taker in takers:
        with pytest.raises(TypeError, match=message):
            taker(value)


def test_numbers_without_a_unit_are_taken_as_they_are():
    for value in (Quantity(0.5, "dimensionless"), xarray.DataArray(0.5), np.float32(0.5)):
        assert js.MeanGap(value).value == 0.5


@pytest.mark.parametrize(
    "value, said",
    [
        (np.array(["a"]), "an array of text"),
        (np.array([1, None]), r"objects \(NoneType, int\)"),
        (np.ones(2, np.longdouble), r"float128.*astype\(float\)"),
    ],
)
def test_arrays_of_other_kinds_are_named(value, said):
    with pytest.raises(TypeError, match=said):
        js.MeanGap(value)


def test_a_table_is_read_by_its_labels():
    x = pd.Index(np.arange(8) * 1.0, name="x")
    y = pd.Index(np.arange(6) * 1.0, name="y")
    solid = js.HalfSpace(GRID, 1.0)
    for table in (pd.DataFrame(HEIGHTS.T, y, x), pd.DataFrame(HEIGHTS, x, y)):
        contact = js.Contact(solid, table, LAW)
        np.testing.assert_allclose(contact.heights + contact.datum, HEIGHTS, atol=1e-15)
    # Its coordinates contradict the grid.
    with pytest.raises(ValueError, match="come with lengths of 16 x 6"):
        js.Contact(solid, pd.DataFrame(HEIGHTS, 2.0 * x, y), LAW)
    with pytest.raises(ValueError, match=r"which are x and y.*rename_axis"):
        js.Contact(solid, pd.DataFrame(HEIGHTS), LAW)
    line = js.HalfSpace(js.Grid((8,), (8.0,)), 1.0)
    assert js.Contact(line, pd.Series(HEIGHTS[:, 0]), LAW).heights.shape == (8,)
    with pytest.raises(ValueError, match=r"rename_axis"):
        js.Contact(line, pd.Series(HEIGHTS[:, 0], np.arange(8) / 2), LAW)


@pytest.mark.parametrize("separator", ["\t", ";", ","])
def test_the_labels_of_a_written_table_are_no_heights(separator, tmp_path):
    file = tmp_path / "table.txt"
    table = pd.DataFrame(HEIGHTS)
    table.to_csv(file, sep=separator, index=False)
    with pytest.raises(ValueError, match="first row counts"):
        js.surfaces.read(file, lengths=(8, 6))
    table.to_csv(file, sep=separator, header=False)
    with pytest.raises(ValueError, match="first column counts"):
        js.surfaces.read(file, lengths=(8, 7))
    table.to_csv(file, sep=separator, header=False, index=False)
    read = js.surfaces.read(file, lengths=(8, 6))
    np.testing.assert_allclose(read.heights, HEIGHTS)


SMOOTH = 0.02 * np.sin(np.arange(12.0))[:, None] + 0.3 * np.linspace(0, 1, 8)
NOISY = np.random.default_rng(1).normal(size=(12, 8))
LABELS = {
    "pandas": range(8),
    "spreadsheet": range(1, 9),
    "floats": np.arange(8.0),
    "coordinates": 0.25 * np.arange(8),
}


@pytest.mark.parametrize("heights", [SMOOTH, NOISY, NOISY[:, :4], 100 * SMOOTH - 7])
@pytest.mark.parametrize("labels", LABELS)
def test_labels_above_or_beside_heights_are_refused_whatever_the_heights(labels, heights, tmp_path):
    columns = list(LABELS[labels])[: heights.shape[1]]
    pd.DataFrame(heights, columns=columns).to_csv(tmp_path / "row.csv", index=False)
    pd.DataFrame(heights.T, index=columns).to_csv(tmp_path / "column.csv", header=False)
    for name in ("row", "column"):
        with pytest.raises(ValueError, match=rf"first {name} (counts|rises).*numpy\.save"):
            js.surfaces.read(tmp_path / f"{name}.csv", lengths=(8, 6))


def test_the_labels_of_few_columns_are_no_points(tmp_path):
    x = 0.25 * np.arange(12)
    points = np.array([(a, b, NOISY[i, j]) for i, a in enumerate(x) for j, b in enumerate(x[:8])])
    for table in (NOISY[:, :1], np.column_stack([x + 0.5, NOISY[:, 0]]), points, NOISY[:1]):
        pd.DataFrame(table).to_csv(tmp_path / "labelled.csv", index=False)
        with pytest.raises(ValueError, match="first row counts from 0"):
            js.surfaces.read(tmp_path / "labelled.csv", lengths=3.0)


@pytest.mark.parametrize(
    "heights",
    [
        SMOOTH,
        # Planes, one in counts of a converter, and a surface that is flat but for its noise.
        np.add.outer(np.arange(12), np.arange(8)),
        0.3 * np.arange(8) + 1e-4 * NOISY,
        np.add.outer(3 * np.arange(12), np.arange(1, 9)),
        np.outer(1 + np.linspace(0, 1, 12), np.arange(8.0)),
    ],
)
@pytest.mark.parametrize("form", ["%.18e", "%g"])
def test_tilted_heights_are_no_labels(heights, form, tmp_path):
    np.savetxt(tmp_path / "heights.txt", heights, form)
    read = js.surfaces.read(tmp_path / "heights.txt", lengths=(1200, 800))
    np.testing.assert_allclose(read.heights, heights, rtol=1e-4, atol=1e-5)


def test_numbers_of_points_are_no_lengths(tmp_path):
    file = tmp_path / "profile.txt"
    pd.Series(HEIGHTS[:, 0]).to_csv(file, header=False, sep=" ")
    with pytest.raises(ValueError, match="numbers of points, and no lengths in µm"):
        js.surfaces.read(file, unit="µm")
    profile = js.surfaces.read(file, lengths=4.0, unit="µm")
    np.testing.assert_allclose(profile.grid.lengths, 4)
    np.testing.assert_allclose(profile.heights, HEIGHTS[:, 0])
    counted = xarray.DataArray(HEIGHTS, dims=("x", "y")).assign_coords(
        x=np.arange(8), y=np.arange(6)
    )
    contact = js.Contact(js.HalfSpace(js.Grid((8, 6), (4.0, 3.0)), 1.0), counted, LAW)
    np.testing.assert_allclose(contact.heights + contact.datum, HEIGHTS, atol=1e-15)


@pytest.mark.parametrize(
    "name, unit",
    [
        ("micrometer", "µm"),
        ("Metres", "m"),
        ("angstrom", "Å"),
        ("micron", "µm"),
        ("cm", "cm"),
        ("centimetres", "cm"),
    ],
)
def test_units_have_their_usual_names(name, unit):
    assert js.Contact(js.HalfSpace(GRID, 1.0), HEIGHTS, LAW, unit=name).unit == unit
    with pytest.raises(ValueError, match=r"'inches': choose one of km, m, cm, mm.*convert"):
        js.Contact(js.HalfSpace(GRID, 1.0), HEIGHTS, LAW, unit="inches")


def test_lengths_in_centimetres_are_converted(tmp_path):
    np.savez(tmp_path / "scan.npz", heights=HEIGHTS, lengths=(8.0, 6.0), unit="cm")
    metres = js.surfaces.read(tmp_path / "scan.npz").in_unit("m")
    np.testing.assert_allclose(metres.lengths, [0.08, 0.06])
    np.testing.assert_allclose(metres.heights, HEIGHTS / 100, rtol=1e-15)


def test_a_data_set_of_hdf5_is_a_plain_array(tmp_path):
    with h5py.File(tmp_path / "heights.h5", "w") as file:
        contact = js.Contact(js.HalfSpace(GRID, 1.0), file.create_dataset("z", data=HEIGHTS), LAW)
    np.testing.assert_allclose(contact.heights + contact.datum, HEIGHTS, atol=1e-15)
