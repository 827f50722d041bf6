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
    x,
    y,
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
        "1 2 3 7\n4 nan 6 8\n",
        "# scan 7\n1,2,3,7 % first\n\n4,nan,6,8\n",
        "1; 2; 3; 7\r\n4; nan; 6; 8\r\n",
        "\ufeff1\t2\t3\t7\n4\tNaN\t6\t8",
        "1 2\t3 7\n4 NaN\t6 8",
    ],
)
def test_separators_comments_and_missing_points_of_text(tmp_path, text):
    topography = read_text(tmp_path, text, (1, 1))
    np.testing.assert_array_equal(topography.heights, [[1, 2, 3, 7], [4, np.nan, 6, 8]])
    assert "1 points (12.5 %)" in str(topography)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be", "utf-32"])
def test_text_in_other_encodings_reads_alike(tmp_path, encoding):
    (tmp_path / "matrix.txt").write_bytes("# µm\n1 2 3 .1\n4 5 6.5 .2\n".encode(encoding))
    topography = js.surfaces.read(tmp_path / "matrix.txt", lengths=(9.0, 9.0), unit="µm")
    np.testing.assert_array_equal(topography.heights, [[1, 2, 3, 0.1], [4, 5, 6.5, 0.2]])


def test_comments_of_ones_own_are_left_alone(tmp_path):
    header = "# h: heights along x\n# made: 7.8.2026\n# Channel: Height\n"
    topography = read_text(tmp_path, header + "1 2 3 4\n5 6 7 8\n9 8 7 6\n", (1, 2))
    np.testing.assert_array_equal(topography.heights, [[1, 2, 3, 4], [5, 6, 7, 8], [9, 8, 7, 6]])


def test_headers_that_surface_topography_knows_give_axes_and_units(tmp_path):
    rows = "\n".join(" ".join(f"{1e3 * h:.17g}" for h in row) for row in HEIGHTS.T) + "\n"
    points = zip(x.ravel(), y.ravel(), 1e3 * HEIGHTS.ravel(), strict=True)
    points = "\n".join(" ".join(f"{value:.15g}" for value in point) for point in points)
    for text in (
        "# File Format = ASCII\n# x-pixels = 12\n# y-pixels = 7\n# x-length = 3000\n"
        f"# y-length = 1400\n# z-unit = nm\n# Start of Data:\n{rows}",
        "File Format = ASCII\nNX = 12\nNY = 7\nScale X = 0.25\nScale Y = 0.2\nUnit X = µm\n"
        f"Unit Y = µm\nUnit Data = nm\nStart of Data :\n{rows}",
        f"# Channel: Topo\n# Lateral units: µm\n# Value units: nm\n{points}",
    ):
        topography = read_text(tmp_path, text).in_unit("µm")
        np.testing.assert_allclose(topography.heights, HEIGHTS, rtol=1e-9)
        np.testing.assert_allclose(topography.lengths, SIDES, rtol=1e-6)
    # One that states points alone states no orientation that can be relied on.
    with pytest.raises(ValueError, match=r"SurfaceTopography: .*unknown kind"):
        read_text(tmp_path, "h=7 w=12\n" + rows, (3000, 1400))


@pytest.mark.parametrize(
    "text", ["0,1.5\n1,2.0\n2,3\n", "0, 1.5\n1, 2\n2, 3\n", "0.0,1.5\n1,2\n2,3"]
)
def test_commas_that_cannot_be_decimal_separate_columns(tmp_path, text):
    topography = read_text(tmp_path, text)
    np.testing.assert_array_equal(topography.heights, [1.5, 2, 3])
    assert topography.remarks == ()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x,y,z\n0,0,1\n0,1,2\n2,0,3\n2,1,4\n", [[1, 2], [3, 4]]),
        ("X; Y; Height\r\n0;0;1\r\n0;1;2\r\n2;0;3\r\n2;1;4\r\n", [[1, 2], [3, 4]]),
        ('"x"\t"z"\n0\t3\n1\t1\n2\t2\n', [3, 1, 2]),
    ],
)
def test_a_line_may_name_the_columns_of_points(tmp_path, text, expected):
    np.testing.assert_array_equal(read_text(tmp_path, text).heights, expected)


def test_two_columns_are_a_profile_and_single_lines_too(tmp_path):
    topography = read_text(tmp_path, "0.5 3\n0.75 1\n1.0 2\n1.25 5\n")
    np.testing.assert_array_equal(topography.heights, [3, 1, 2, 5])
    np.testing.assert_allclose(topography.lengths, [1.0])
    falling = read_text(tmp_path, "1.25 5\n1.0 2\n0.75 1\n0.5 3\n")
    np.testing.assert_array_equal(falling.heights, [3, 1, 2, 5])
    np.testing.assert_allclose(falling.lengths, [1.0])
    assert read_text(tmp_path, "3 1 2 5\n", 1.0).grid.shape == (4,)
    with pytest.raises(ValueError, match=r"a\.txt: .* no points x z of an even lattice, in 4 rows"):
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
        with pytest.raises(ValueError, match=r"no points x y z of .* in 60 rows: interpolate them"):
            js.surfaces.read(tmp_path / "a", (1, 1))


@pytest.mark.parametrize("columns", [2, 3])
def test_few_columns_are_points_and_never_a_matrix(tmp_path, columns):
    np.savetxt(tmp_path / "a", np.random.default_rng(0).normal(size=(40, columns)))
    with pytest.raises(ValueError, match=r"lattice, in 40 rows: .* Save a matrix as \.npy"):
        js.surfaces.read(tmp_path / "a", (1, 1))


@pytest.mark.parametrize("corner", ["nan", "0"])
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
