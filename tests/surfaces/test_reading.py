"""One uneven surface in every format, and text in every form."""

import numpy as np
import pytest
from surface_files import (
    HEIGHTS,
    REMARKS,
    SAY_NO_UNIT,
    SAY_NOTHING,
    SIDES,
    WRITERS,
    as_gwy,
    read_text,
)

import jaxstab as js


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


@pytest.mark.parametrize("corner", ["", "0"])
def test_a_matrix_with_coordinates_in_its_first_row_and_column_is_refused(tmp_path, corner):
    heights = np.random.default_rng(0).normal(size=(8, 6))
    rows = [[corner, *map(str, 0.5 * np.arange(6))]]
    rows += [[str(0.5 * i), *map(str, row)] for i, row in enumerate(heights)]
    (tmp_path / "scan.csv").write_text("\n".join(map(",".join, rows)))
    with pytest.raises(ValueError, match="first row and its first column look like coordinates"):
        js.surfaces.read(tmp_path / "scan.csv")
    # A plane is one.
    plane = np.arange(8)[:, None] + 2.0 * np.arange(6)
    np.savetxt(tmp_path / "plane.txt", plane)
    np.testing.assert_array_equal(
        js.surfaces.read(tmp_path / "plane.txt", lengths=(8, 12)).heights, plane
    )
