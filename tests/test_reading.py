"""One uneven surface in every format, files that are damaged, and what is asked of the user."""

import io
import struct
import sys
import zipfile

import numpy as np
import pytest
import xarray

import jaxstab as js

# 12 x 7 points on 3 x 1.4 micrometres, with no symmetry that would hide a swapped axis.
SIDES = 3.0, 1.4
x, y = np.meshgrid(np.arange(12) * SIDES[0] / 12, np.arange(7) * SIDES[1] / 7, indexing="ij")
HEIGHTS = 0.1 * x + 0.03 * y**2 + 0.02 * np.sin(5 * x * y + 1)


def as_text(path):
    np.savetxt(path, HEIGHTS, header="a line for each x")


def as_xyz(path):
    points = np.column_stack([x.ravel() + 10, y.ravel() - 3, HEIGHTS.ravel()])
    np.savetxt(path, np.random.default_rng(0).permutation(points), delimiter=";")


def as_npy(path):
    with path.open("wb") as file:
        np.save(file, HEIGHTS)


X3P = """<?xml version="1.0" encoding="UTF-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">
<Record1><Revision>ISO5436 - 2000</Revision><FeatureType>SUR</FeatureType><Axes>
<CX><AxisType>I</AxisType><DataType>D</DataType><Increment>0.25e-6</Increment></CX>
<CY><AxisType>I</AxisType><DataType>D</DataType><Increment>0.2e-6</Increment></CY>
<CZ><AxisType>A</AxisType><DataType>D</DataType></CZ></Axes></Record1>
<Record3><MatrixDimension><SizeX>12</SizeX><SizeY>7</SizeY><SizeZ>1</SizeZ></MatrixDimension>
<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink></Record3></p:ISO5436_2>"""


def as_x3p(path):
    # By ISO 25178-72: metres, the points of a profile along x one after another.
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("main.xml", X3P)
        archive.writestr("bindata/data.bin", (1e-6 * HEIGHTS).T.astype("<f8").tobytes())


def gwy_part(name, kind, value):
    return name.encode() + b"\0" + kind.encode() + value


def gwy_object(name, *parts):
    content = b"".join(parts)
    return name.encode() + b"\0" + struct.pack("<I", len(content)) + content


def as_gwy(path, unit="m", per_height=1e-6):
    # By Gwyddion's description: rows of constant y one after another, a unit each for xy and z.
    unit_xy, unit_z = (gwy_object("GwySIUnit", gwy_part("unitstr", "s", u + b"\0"))
                       for u in (b"m", unit.encode()))  # fmt: skip
    field = gwy_object(
        "GwyDataField",
        gwy_part("xres", "i", struct.pack("<i", 12)),
        gwy_part("yres", "i", struct.pack("<i", 7)),
        gwy_part("xreal", "d", struct.pack("<d", 3e-6)),
        gwy_part("yreal", "d", struct.pack("<d", 1.4e-6)),
        gwy_part("si_unit_xy", "o", unit_xy),
        gwy_part("si_unit_z", "o", unit_z),
        gwy_part("data", "D", struct.pack("<I", 84) + (per_height * HEIGHTS).T.tobytes()),
    )
    path.write_bytes(b"GWYP" + gwy_object("GwyContainer", gwy_part("/0/data", "o", field)))


def as_text_of_gwyddion(path):
    # A row for each y, in the order of the same image's .gwy file.
    header = "Channel: Height\nWidth: 3.000 µm\nHeight: 1400 nm\nValue units: m"
    np.savetxt(path, 1e-6 * HEIGHTS.T, delimiter="\t", header=header, encoding="utf-8")


def as_netcdf(path, engine="h5netcdf"):
    # Rows from the top down, y first, heights in another unit than the sides.
    coordinates = {"x": ("x", x[:, 0], {"units": "um"}), "y": ("y", y[0], {"units": "um"})}
    heights = ("x", "y"), 1e3 * HEIGHTS, {"units": "nm"}
    data = xarray.Dataset({"z": heights, "time": 3.0}, coordinates)
    data.isel(y=slice(None, None, -1)).transpose("y", "x").to_netcdf(path, engine=engine)


def as_classic_netcdf(path):
    as_netcdf(path, engine="scipy")


def by_surface_topography(path):
    import SurfaceTopography

    topography = SurfaceTopography.Topography(HEIGHTS, SIDES, unit="µm", periodic=False)
    topography.to_netcdf(str(path))


WRITERS = [
    as_text,
    as_xyz,
    as_npy,
    as_x3p,
    as_gwy,
    as_text_of_gwyddion,
    as_netcdf,
    as_classic_netcdf,
    by_surface_topography,
]
SAY_NOTHING = {as_text, as_npy}
SAY_NO_UNIT = SAY_NOTHING | {as_xyz}
REMARKS = {
    as_netcdf: ("heights converted from nm to µm",),
    as_classic_netcdf: ("heights converted from nm to µm",),
    as_text_of_gwyddion: (
        "an image of Gwyddion, a row for each y",
        "heights converted from m to µm",
    ),
}


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_one_surface_reads_alike_in_every_format_under_any_name(write, tmp_path):
    path = tmp_path / "surface.jpeg"
    write(path)
    said = {"lengths": SIDES} if write in SAY_NOTHING else {}
    if write in SAY_NO_UNIT:
        assert js.surfaces.read(path, **said).unit is None
        said["unit"] = "um"
    topography = js.surfaces.read(path, **said).in_unit("µm")
    np.testing.assert_allclose(topography.heights, HEIGHTS, rtol=1e-14)
    np.testing.assert_allclose(topography.lengths, SIDES, rtol=1e-14)
    assert topography.heights.dtype == np.float64
    assert (topography.unit, topography.is_periodic) == ("µm", False)
    assert topography.remarks == REMARKS.get(write, ())


def test_units_of_sides_and_heights_that_differ_become_one(tmp_path):
    as_gwy(tmp_path / "a", unit="nm", per_height=1e3)
    topography = js.surfaces.read(tmp_path / "a")
    assert topography.unit == "m"
    np.testing.assert_allclose(topography.heights, 1e-6 * HEIGHTS, rtol=1e-14)


def read_text(tmp_path, text, lengths=None):
    (tmp_path / "a.txt").write_text(text)
    return js.surfaces.read(tmp_path / "a.txt", lengths)


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3\n4 nan 6\n",
        "# scan 7\n1,2,3 % first\n\n4,,6\n",
        "1; 2; 3;\r\n4; ; 6;\r\n",
        "\ufeff1\t2\t3\n4\t\t6",
        "1 2\t3\n4 NaN\t6",
    ],
)
def test_separators_comments_and_missing_points_of_text(tmp_path, text):
    topography = read_text(tmp_path, text, (1, 1))
    np.testing.assert_array_equal(topography.heights, [[1, 2, 3], [4, np.nan, 6]])
    assert "1 points (16.7 %)" in str(topography)


GWYDDION = "# Width: 2 µm\n# Height: 1 µm\n# Value units: µm\n"


def test_a_header_of_gwyddion_may_have_decimal_commas_and_no_unit_of_heights(tmp_path):
    text = "# Width: 2,5 µm\n# Height: 1,0 µm\n# Value units:\n0,1\t0,2\t0,3\n0,4\t0,5\t0,6\n"
    topography = read_text(tmp_path, text)
    np.testing.assert_array_equal(topography.heights, [[0.1, 0.4], [0.2, 0.5], [0.3, 0.6]])
    np.testing.assert_allclose(topography.lengths, [2.5, 1.0])
    assert topography.unit == "µm"
    assert "unit of heights taken from the sides, µm" in str(topography)
    # A single row is a profile along x, and a matrix of three columns no points.
    np.testing.assert_allclose(read_text(tmp_path, GWYDDION + "1 2 3\n").lengths, [2])
    assert read_text(tmp_path, GWYDDION + "1 2 3\n" * 60).grid.shape == (3, 60)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GWYDDION + "1 2\n3 4\n" + GWYDDION + "1 2\n3 4\n", "several images: export one"),
        (GWYDDION.replace("2 µm", "wide") + "1 2\n3 4\n", "its width is 'wide': write a number"),
        (GWYDDION.replace("1 µm", "1 s") + "1 2\n3 4\n", "its height is '1 s': write a number"),
        (GWYDDION.replace("2 µm", "2") + "1 2\n3 4\n", "comes without a unit"),
        (GWYDDION.replace("units: µm", "units: V") + "1 2\n3 4\n", "the unit is 'V'"),
    ],
)
def test_a_header_of_gwyddion_that_says_too_little_is_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=rf"a\.txt: .*{message}"):
        read_text(tmp_path, text)


@pytest.mark.parametrize(
    "text", ["1,5\t2\t3\n4\t\t6,25\n", "1,5 2 3\n4 nan 6,25\n", "1,5; 2;3\n4;;6,25\n"]
)
def test_decimal_commas_are_read_beside_another_separator(tmp_path, text):
    topography = read_text(tmp_path, text, (1, 1))
    np.testing.assert_array_equal(topography.heights, [[1.5, 2, 3], [4, np.nan, 6.25]])
    assert "decimal commas taken for points" in str(topography)


def test_a_column_of_decimal_commas_is_no_two_columns(tmp_path):
    # Neither a profile x, z, nor a matrix, nor a column with a whole number.
    for text in ("1,100\n2,150\n3,120\n", "1,100\n1,150\n", "1,5e-6\n2\n"):
        with pytest.raises(ValueError, match=r"line 1: '1,.* looks like decimal commas.* 1\.5"):
            read_text(tmp_path, text, 1.0)


@pytest.mark.parametrize(
    "text", ["0,1.5\n1,2.0\n2,3\n", "0, 1.5\n1, 2\n2, 3\n", "0.0,1.5\n1,2\n2,3"]
)
def test_commas_that_cannot_be_decimal_separate_columns(tmp_path, text):
    topography = read_text(tmp_path, text)
    np.testing.assert_array_equal(topography.heights, [1.5, 2, 3])
    assert topography.remarks == ()


def test_two_columns_are_a_profile_and_single_lines_too(tmp_path):
    topography = read_text(tmp_path, "0.5 3\n0.75 1\n1.0 2\n1.25 5\n")
    np.testing.assert_array_equal(topography.heights, [3, 1, 2, 5])
    np.testing.assert_allclose(topography.lengths, [1.0])
    falling = read_text(tmp_path, "1.25 5\n1.0 2\n0.75 1\n0.5 3\n")
    np.testing.assert_array_equal(falling.heights, [3, 1, 2, 5])
    np.testing.assert_allclose(falling.lengths, [1.0])
    assert read_text(tmp_path, "3 1 2 5\n", 1.0).grid.shape == (4,)
    with pytest.raises(ValueError, match=r"a\.txt: its first column rises unevenly"):
        read_text(tmp_path, "0 3\n1 1\n3 2\n4 5\n", (1, 1))


def test_points_missing_from_a_lattice_are_missing_from_the_surface(tmp_path):
    # Coordinates are rounded, and a whole line of the lattice is not there.
    points = [(f"{i / 3:.3f}", f"{j / 7:.3f}", (i - 2 * j) / 9) for i in range(6) for j in range(4)]
    text = "\n".join(" ".join(map(str, p)) for p in points if p[0] != "0.667" and p[2] != 5 / 9)
    topography = read_text(tmp_path, text)
    expected = np.add.outer(np.arange(6.0), -2 * np.arange(4)) / 9
    expected[2] = expected[5, 0] = np.nan
    np.testing.assert_array_equal(topography.heights, expected)
    np.testing.assert_allclose(topography.lengths, [2, 4 / 7], rtol=1e-3)
    assert "5 points of the lattice not in the file" in str(topography)
    with pytest.raises(ValueError, match=r"several heights at x = 0, y = 1"):
        read_text(tmp_path, "0 0 1\n0 1 2\n1 0 3\n1 1 4\n0 1 5\n")


@pytest.mark.parametrize("noise", [0, 1e-5])
def test_rounded_or_noisy_coordinates_lie_on_a_lattice(tmp_path, noise):
    rng = np.random.default_rng(0)
    i, j = (side.ravel() for side in np.meshgrid(np.arange(512), np.arange(4), indexing="ij"))
    heights = 0.1 * rng.normal(size=(512, 4))
    x = np.linspace(0, 10, 512)[i] + noise * rng.normal(size=i.size)
    np.savetxt(tmp_path / "a", np.column_stack([x, j / 3, heights.ravel()]),
               fmt=["%.4f" if not noise else "%.9f", "%.4f", "%.17g"])  # fmt: skip
    topography = js.surfaces.read(tmp_path / "a")
    np.testing.assert_array_equal(topography.heights, heights)
    np.testing.assert_allclose(topography.lengths, [512 * 10 / 511, 4 / 3], rtol=1e-4)


def test_lines_missing_from_a_lattice_do_not_widen_it(tmp_path):
    points = [(i, j, i + j) for i in (0, 1, 3, 5, 7, 9) for j in range(4)]
    topography = read_text(tmp_path, "\n".join(" ".join(map(str, p)) for p in points))
    assert topography.grid.shape == (10, 4)
    assert topography.num_missing == 16


def test_many_points_on_no_lattice_are_refused_as_points(tmp_path):
    points = np.random.default_rng(0).normal(size=(60, 3))
    lattice = np.array([(i, j, i * j) for i in range(10) for j in range(6)], float)
    lattice[7, 0] = np.nan
    for table in (points, lattice):
        np.savetxt(tmp_path / "a", table)
        with pytest.raises(ValueError, match=r"lie on no lattice, in 60 rows: interpolate them"):
            js.surfaces.read(tmp_path / "a", (1, 1))


def test_two_rows_of_three_are_a_matrix_and_no_half_of_a_lattice(tmp_path):
    topography = read_text(tmp_path, "1,2,3\n4,5,6\n", (1, 1))
    np.testing.assert_array_equal(topography.heights, [[1, 2, 3], [4, 5, 6]])


def test_three_columns_on_no_lattice_are_a_matrix(tmp_path):
    heights = np.random.default_rng(0).normal(size=(40, 3))
    np.savetxt(tmp_path / "a", heights)
    with pytest.warns(js.SurfaceWarning, match="rms slope"):
        read = js.surfaces.read(tmp_path / "a", (1, 1))
    np.testing.assert_array_equal(read.heights, heights)
    assert "a matrix of three columns" in str(read)


ROWS = "1 2 3\n4 5 6\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("# nothing\n\n", "holds no numbers"),
        (ROWS + "7 8\n", "line 3 has 2 numbers, line 1 has 3"),
        (ROWS + "7 abc 9\n", "line 3: 'abc' is no number"),
        ("x y z\n" + ROWS, "line 1: 'x' is no number"),
        (ROWS + "7 -inf 9\n", "line 3: '-inf' is infinite"),
        ("1\n", "shape .*of 2 points or more"),
        ("nan nan\nnan nan", "all heights are missing"),
    ],
)
def test_damaged_text_names_its_line_and_word(tmp_path, text, message):
    with pytest.raises(ValueError, match=rf"a\.txt: .*{message}"):
        read_text(tmp_path, text, (1, 1))


@pytest.mark.parametrize("write", [as_npy, as_x3p, as_gwy, as_netcdf, as_classic_netcdf])
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
        (npy_of(np.array([[1, "a"], [None, 2]], object)), "no plain array of numbers"),
        (npy_of(np.ones((3, 3), complex)), "complex128: heights are real"),
        (npy_of(np.ones((3, 3, 3))), r"shape \(3, 3, 3\)"),
        (npy_of(np.array([[1, np.inf], [2, 3]])), r"infinite, the first at \(0, 1\)"),
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
    with pytest.raises(ValueError, match=r"the file says 3e-06 x 1\.4e-06 m: leave them out"):
        js.surfaces.read(tmp_path / "a.gwy", SIDES)
    with pytest.raises(ValueError, match=r"'um', but the file says 'm'.*\.in_unit\(\"um\"\)"):
        js.surfaces.read(tmp_path / "a.gwy", unit="um")
    assert js.surfaces.read(tmp_path / "a.gwy", (3e-6, 1.4e-6), "m").unit == "m"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda data: data.rename(x="u"),
            r"no variable over the dimensions x and y, but z\('y', 'u'",
        ),
        (lambda data: data.assign(w=2 * data.z), "several maps, z, w: name the surface `heights`"),
        (lambda data: data.assign_coords(x=data.x**2), "coordinates x are not evenly spaced"),
        (lambda data: data.assign_coords(x=data.x.assign_attrs(units="m")), "different units"),
        (lambda data: data.assign_coords(x=data.x.assign_attrs(length=5.0)), "length of x is 5"),
        (lambda data: data.drop_vars(["x", "y"]), "without side lengths"),
    ],
)
def test_netcdf_that_is_ambiguous_is_refused(tmp_path, change, message):
    as_netcdf(tmp_path / "a.nc")
    change(xarray.load_dataset(tmp_path / "a.nc")).to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=rf"b\.nc: .*{message}"):
        js.surfaces.read(tmp_path / "b.nc")


@pytest.mark.parametrize(
    ("change", "remark"),
    [
        (lambda data: data.z.attrs.pop("units"), "unit of heights taken from the sides, µm"),
        (
            lambda data: [data[side].attrs.pop("units") for side in "xy"],
            "unit of lengths taken from the heights, nm",
        ),
    ],
)
def test_a_unit_that_netcdf_does_not_say_is_taken_with_a_remark(tmp_path, change, remark):
    as_netcdf(tmp_path / "a.nc")
    data = xarray.load_dataset(tmp_path / "a.nc")
    data["z"] = data.z.copy(data=1e-3 * data.z.values)
    change(data)
    data.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    topography = js.surfaces.read(tmp_path / "b.nc")
    assert topography.remarks == (remark,)
    assert remark.endswith(topography.unit)


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
    with pytest.warns(js.SurfaceWarning, match=r"rms slope is 1\.\d+e\+05.*sides of 3e-06 x"):
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
    [(as_gwy, "SurfaceTopography.IO", "surfaces"), (as_netcdf, "xarray", "data")],
)
def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch, write, package, extra):
    write(tmp_path / "a")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"pip install 'jaxstab\[{extra}\]'"):
        js.surfaces.read(tmp_path / "a")
