"""Files that are damaged, ambiguous or incomplete, and the error for the user."""

import gzip
import io
import sys
from contextlib import nullcontext

import numpy as np
import pytest
import xarray
from surface_files import (
    GWYDDION,
    HEIGHTS,
    SIDES,
    as_classic_netcdf,
    as_gwy,
    as_netcdf,
    as_npy,
    as_npz,
    as_text_of_gwyddion,
    as_x3p,
    read_text,
)

import jaxstab as js

ROWS = "1 2 3 0\n4 5 6 1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("# nothing\n\n", "holds no numbers"),
        (ROWS + "7 8\n", "columns changed from 4 to 2 at row 3"),
        (ROWS + "7 abc 9 3\n", "'abc' to float64 at row 2, column 2.*SurfaceTopography: "),
        (
            "x y z\n" + ROWS,
            "'x' to float64 at row 0, column 1.* SurfaceTopography: .*unknown kind",
        ),
        (ROWS + "7 -inf 9 3\n", r"A height is -inf at \(2, 1\)"),
        # Decimal commas, and a field left empty.
        ("1,5 2\n3 4\n", "to float64"),
        ("1,5;2\n3;4\n", "'1,5' to float64"),
        ("1,100\n1,150\n", "'1,100' looks like decimal commas, or like two columns: write 1.5"),
        ("1,2,3\n4,,6\n", "'' to float64"),
        # The header of an instrument, and columns below titles of no unit.
        (GWYDDION + ROWS.replace("5", "x"), "of its 2 rows 1 are not numbers alone"),
        (GWYDDION.replace("3.000 µm", "3 s") + 4 * "1 2 3 4\n", "Height: 1.* looks.*unknown kind"),
        ("# Breite: 3 µm\n# Einheiten: nm\n" + 5 * ROWS, "says one side of two"),
        ("# x-pixels = 4\n# y-pixels = 9\n" + 5 * ROWS, "x-pixels = 4' looks.*unknown kind"),
        (
            "Date 7.8.2024 by me\n" + 5 * ROWS,
            "SurfaceTopography: .*unknown kind",
        ),
        (
            "x [mm];z [V]\n0;1\n1;2\n2;4\n",
            "SurfaceTopography: .*unknown kind",
        ),
        ("1\n", "shape .*of 2 points or more"),
        (4 * "nan nan nan nan\n", "all heights are missing"),
    ],
)
def test_text_that_is_damaged_or_could_be_misread_is_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=rf"a\.txt: .*{message}"):
        read_text(tmp_path, text, (1, 1))


@pytest.mark.parametrize("write", [as_npy, as_npz, as_x3p, as_gwy, as_netcdf, as_classic_netcdf])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_truncated_file_is_refused_by_name(tmp_path, write, share):
    path = tmp_path / "a.bin"
    write(path)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=r"a\.bin: .*(truncated|damaged)"):
        js.surfaces.read(path, SIDES)


def npy_of(values):
    stream = io.BytesIO()
    np.save(stream, values, allow_pickle=True)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (npy_of(np.array([[1, "a"], [None, 2]], object)), "more than plain arrays of numbers"),
        (npy_of(np.ones((3, 3), complex)), "complex128: heights are real"),
        (npy_of(np.ones((3, 3, 3))), r"shape \(3, 3, 3\)"),
        (npy_of(np.array([[1, np.inf], [2, 3]])), r"A height is inf at \(0, 1\)"),
        (bytes(range(256)) * 8, "damaged or of an unknown kind"),
        (b"\0" * 288, "damaged or of an unknown kind"),
    ],
)
def test_content_that_is_no_surface_is_refused(tmp_path, content, message):
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(ValueError, match=rf"a\.npy: .*{message}"):
        js.surfaces.read(tmp_path / "a.npy", (1, 1))


def test_what_is_not_there_is_not_found(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"a\.npy does not exist"):
        js.surfaces.read(tmp_path / "a.npy")
    with pytest.raises(ValueError, match="is no file"):
        js.surfaces.read(tmp_path)


def test_lengths_and_units_are_asked_for_and_not_contradicted(tmp_path):
    as_npy(tmp_path / "a.npy")
    as_gwy(tmp_path / "a.gwy")
    with pytest.raises(ValueError, match=r"12 x 7 heights come without side lengths: give"):
        js.surfaces.read(tmp_path / "a.npy")
    with pytest.raises(
        ValueError, match=r"lengths is 3\.0, one number for 12 x 7 points: give one"
    ):
        js.surfaces.read(tmp_path / "a.npy", 3.0)
    np.save(tmp_path / "square.npy", HEIGHTS[:7])
    np.testing.assert_allclose(js.surfaces.read(tmp_path / "square.npy", 3.0).lengths, [3, 3])
    for wrong in ((0.0, 1.4), (3.0, -1.4), (1.0, 2.0, 3.0)):
        with pytest.raises(ValueError, match=r"a\.npy: .*rid length"):
            js.surfaces.read(tmp_path / "a.npy", wrong)
    with pytest.raises(ValueError, match="the unit is 'inch': choose one of"):
        js.surfaces.read(tmp_path / "a.npy", SIDES, "inch")
    with pytest.raises(ValueError, match=r"heights come with lengths of 3e-06 x 1\.4e-06 m"):
        js.surfaces.read(tmp_path / "a.gwy", SIDES)
    with pytest.raises(ValueError, match=r"'um', but the heights are in 'm'.*\.in_unit\(\"um\"\)"):
        js.surfaces.read(tmp_path / "a.gwy", unit="um")
    assert js.surfaces.read(tmp_path / "a.gwy", (3e-6, 1.4e-6), "m").unit == "m"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda data: data.rename(x="u"),
            r"no variable over the dimensions x and y, but z\('y', 'u'",
        ),
        (lambda data: data.assign(w=2 * data.z), "several arrays, z, w: name the surface"),
        (lambda data: data.assign_coords(x=data.x**2), "coordinates x are not evenly spaced"),
        (lambda data: data.assign_coords(x=data.x.assign_attrs(units="m")), "different units"),
        (lambda data: data.drop_vars(["x", "y"]), "without side lengths"),
    ],
)
def test_netcdf_that_is_ambiguous_is_refused(tmp_path, change, message):
    as_netcdf(tmp_path / "a.nc")
    change(xarray.load_dataset(tmp_path / "a.nc")).to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=rf"b\.nc: .*{message}"):
        js.surfaces.read(tmp_path / "b.nc")


@pytest.mark.parametrize("names, unit", [("z", "µm"), ("xy", "nm")])
def test_a_unit_that_netcdf_does_not_state_is_the_other_one(tmp_path, names, unit):
    as_netcdf(tmp_path / "a.nc")
    data = xarray.load_dataset(tmp_path / "a.nc")
    for name in names:
        data[name].attrs.pop("units")
    data.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    with (
        pytest.warns(js.exceptions.SurfaceWarning, match="rms slope")
        if names == "z"
        else nullcontext()
    ):
        topography = js.surfaces.read(tmp_path / "b.nc")
    assert topography.unit == unit
    np.testing.assert_array_equal(topography.heights, 1e3 * HEIGHTS)


def test_masked_points_of_netcdf_and_of_instruments_are_missing(tmp_path):
    import SurfaceTopography

    masked = np.ma.masked_where(HEIGHTS > 0.2, HEIGHTS)
    topography = SurfaceTopography.Topography(masked, SIDES, unit="µm", periodic=True)
    topography.to_netcdf(str(tmp_path / "a"))
    topography.to_gwy(str(tmp_path / "b"))
    for name in "ab":
        read = js.surfaces.read(tmp_path / name).in_unit("um")
        np.testing.assert_allclose(read.heights, masked.filled(np.nan), rtol=1e-14)
        assert read.is_periodic == (name == "a")


def test_heights_in_another_unit_than_the_sides_warn(tmp_path):
    as_npy(tmp_path / "a.npy")
    with pytest.warns(
        js.exceptions.SurfaceWarning, match=r"rms slope is 1\.\d+e\+05.*sides of 3e-06 x"
    ):
        js.surfaces.read(tmp_path / "a.npy", (3e-6, 1.4e-6))


def test_an_instruments_text_is_read_as_such(tmp_path):
    # By ISO 25178-71: metres, a row for each y.
    header = {"ManufacID": "x", "CreateDate": "010120260000", "ModDate": "010120260000",
              "NumPoints": 12, "NumProfiles": 7, "Xscale": 0.25e-6, "Yscale": 0.2e-6,
              "Zscale": 1e-6, "Zresolution": -1, "Compression": 0, "DataType": 7,
              "CheckType": 0}  # fmt: skip
    lines = ["aISO-1.0", *(f"{name} = {value}" for name, value in header.items()), "*"]
    rows = [" ".join(f"{h:.17g}" for h in row) for row in HEIGHTS.T]
    (tmp_path / "a.txt").write_text("\n".join([*lines, *rows, "*", "*"]))
    read = js.surfaces.read(tmp_path / "a.txt").in_unit("um")
    np.testing.assert_allclose(read.heights, HEIGHTS, rtol=1e-12)
    np.testing.assert_allclose(read.lengths, SIDES)


@pytest.mark.parametrize(
    ("write", "package", "extra"),
    [
        (as_gwy, "SurfaceTopography.IO", "surfaces"),
        (as_text_of_gwyddion, "SurfaceTopography.IO", "surfaces"),
        (as_netcdf, "xarray", "data"),
        (as_netcdf, "h5py", "data"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch, write, package, extra):
    write(tmp_path / "a")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"/a: .*pip install 'jaxstab\[{extra}\]'"):
        js.surfaces.read(tmp_path / "a")


@pytest.mark.parametrize("write", [as_npy, as_npz, as_gwy, as_netcdf, as_classic_netcdf])
def test_files_that_gzip_packed_are_read(tmp_path, write):
    write(tmp_path / "a")
    content = gzip.compress((tmp_path / "a").read_bytes())
    (tmp_path / "a.gz").write_bytes(content)
    lengths = SIDES if write is as_npy else None
    plain, packed = (js.surfaces.read(tmp_path / name, lengths) for name in ("a", "a.gz"))
    np.testing.assert_array_equal(packed.heights, plain.heights)
    np.testing.assert_array_equal(packed.lengths, plain.lengths)
    assert (packed.unit, packed.remarks) == (plain.unit, plain.remarks)
    (tmp_path / "a.gz").write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match=r"a\.gz: its gzip data are truncated"):
        js.surfaces.read(tmp_path / "a.gz", lengths)


def test_doubled_coordinates_are_refused():
    places = {"x": [0.0, 1.0, 1.0, 3.0], "y": [0.0, 1.0, 2.0, 3.0]}
    array = xarray.DataArray(HEIGHTS[:4, :4], dims=("x", "y"), coords=places)
    with pytest.raises(ValueError, match="coordinates x are not evenly spaced"):
        js.surfaces.Topography(js.Grid(4, 4.0), array)


def test_one_length_in_a_file_of_an_oblong_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", heights=HEIGHTS, lengths=3.0)
    with pytest.raises(
        ValueError, match=r"lengths is 3\.0, one number for 12 x 7 points: give one"
    ):
        js.surfaces.read(tmp_path / "a.npz")
