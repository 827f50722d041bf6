"""Text that instruments and their programs write, and what must not be guessed of it."""

import gzip
import sys

import numpy as np
import pytest
import SurfaceTopography
from surface_files import (
    HEIGHTS,
    SIDES,
    as_classic_netcdf,
    as_gwy,
    as_netcdf,
    as_npy,
    as_text,
    x,
    y,
)

import jaxstab as js

# Rows along x, as instruments write them.
ROWS = "\n".join(" ".join(f"{1e3 * h:.17g}" for h in row) for row in HEIGHTS.T) + "\n"
POINTS = "\n".join(
    f"{a:.12g} {b:.12g} {1e3 * h:.17g}"
    for a, b, h in zip(x.ravel(), y.ravel(), HEIGHTS.ravel(), strict=True)
)
PROFILE = HEIGHTS[:, 3]


def written(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "a.txt"
    path.write_bytes(text.encode(encoding))
    return path


GWYDDION = {
    "English": ("Channel", "Width", "Height", "Value units"),
    "German": ("Kanal", "Breite", "Höhe", "Einheiten"),
    "French": ("Canal", "Largeur", "Hauteur", "Unités"),
    "Czech": ("Kanál", "Šířka", "Výška", "Jednotky hodnot"),
    "Russian": ("Канал", "Ширина", "Высота", "Единицы измерения"),
    "Japanese": ("チャネル", "幅", "高さ", "値の単位"),
}


def image_of_gwyddion(language, name="Topo", rows=ROWS):
    channel, width, height, unit = GWYDDION[language]
    colon = "\uff1a" if language == "Japanese" else ":"
    said = {channel: name, width: "3,000 µm", height: "1,400 µm", unit: "nm"}
    if language == "English":
        said = {key: text.replace(",", ".") for key, text in said.items()}
    return "".join(f"# {key}{colon} {text}\n" for key, text in said.items()) + rows


SPIP = """# File Format = ASCII
# x-pixels = 12
# y-pixels = 7
# x-length = 3000
# y-length = 1400
# z-unit = nm
# Start of Data:
"""
NOVA = """File Format = ASCII
NX = 12
NY = 7
Scale X = 0.25
Scale Y = 0.2
Unit X = µm
Unit Y = µm
Unit Data = nm
Start of Data :
"""
MAPS = {
    **{f"Gwyddion, {name}": image_of_gwyddion(name) for name in GWYDDION},
    "SPIP": SPIP + ROWS,
    "Nova": NOVA + ROWS,
    "pixels": "pixel size = 0.25 µm\nheight conversion factor (-> m) = 1e-9\nw=12 h=7\n" + ROWS,
    "points with titles": "x (µm) y (µm) z\n".replace(" (", "(").replace("z", "z(nm)") + POINTS,
    "points of Gwyddion": "# Channel: Topo\n# Lateral units: µm\n# Value units: nm\n" + POINTS,
}


@pytest.mark.parametrize("name", [name for name in MAPS if name != "pixels"])
def test_maps_of_instruments_have_their_axes_and_units(tmp_path, name):
    topography = js.surfaces.read(written(tmp_path, MAPS[name])).in_unit("µm")
    np.testing.assert_allclose(topography.heights, HEIGHTS, rtol=1e-9)
    np.testing.assert_allclose(topography.lengths, SIDES, rtol=1e-6)


def test_pixels_of_one_size_give_both_sides(tmp_path):
    topography = js.surfaces.read(written(tmp_path, MAPS["pixels"])).in_unit("µm")
    np.testing.assert_allclose(topography.heights, HEIGHTS, rtol=1e-9)
    np.testing.assert_allclose(topography.lengths, (12 * 0.25, 7 * 0.25), rtol=1e-6)


def test_a_map_whose_header_says_its_points_alone_takes_lengths(tmp_path):
    path = written(tmp_path, "h=7 w=12\n" + ROWS)
    with pytest.raises(ValueError, match=r"12 x 7 heights come without side lengths"):
        js.surfaces.read(path)
    topography = js.surfaces.read(path, (3000, 1400), "nm").in_unit("µm")
    np.testing.assert_allclose(topography.heights, HEIGHTS, rtol=1e-9)
    np.testing.assert_allclose(topography.lengths, SIDES)


def column_file(titles, columns, separator):
    rows = [separator.join(f"{value:.12g}" for value in row) for row in zip(*columns, strict=True)]
    return titles + "\n".join(rows) + "\n"


X = x[:, 0]
PROFILES = {
    "HFM": column_file("X;Y;valid\n[mm];[µm];[1/0]\n", (1e-3 * X, PROFILE, X >= 0), ";"),
    "microns": column_file("X_(microns),y1\n", (X, PROFILE), ","),
    "an index": column_file(
        "index,x in µm,y in nm\n", (np.arange(12), X, 1e3 * PROFILE), ","
    ),
    "titles": column_file("Distance [µm]\tHeight [nm]\n", (X, 1e3 * PROFILE), "\t"),
    "profiler": "Scan Parameters\nStylus,Radius: 5 um\n\nScan Data\n\nLateral um,Raw Nanometer,\n"
    + column_file("", (X, 1e3 * PROFILE), ",").replace("\n", ",,\n"),
}  # fmt: skip


@pytest.mark.parametrize("name", PROFILES)
def test_profiles_below_titles_have_their_units(tmp_path, name):
    topography = js.surfaces.read(written(tmp_path, PROFILES[name])).in_unit("µm")
    np.testing.assert_allclose(topography.heights, PROFILE, rtol=1e-9)
    np.testing.assert_allclose(topography.lengths, SIDES[:1], rtol=1e-6)


def test_points_that_are_marked_as_invalid_are_missing(tmp_path):
    valid = np.arange(12) != 4
    text = column_file(
        "X;Y;valid\n[mm];[mm];[1/0]\n", (X, np.where(valid, PROFILE, 99), valid), ";"
    )
    heights = js.surfaces.read(written(tmp_path, text)).heights
    np.testing.assert_array_equal(np.isnan(heights), ~valid)
    np.testing.assert_allclose(heights[valid], PROFILE[valid], rtol=1e-9)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "latin-1"])
@pytest.mark.parametrize("name", ["Gwyddion, German", "Nova", "points with titles"])
def test_text_is_read_in_the_encodings_of_windows(tmp_path, name, encoding):
    topography = js.surfaces.read(written(tmp_path, MAPS[name], encoding)).in_unit("µm")
    np.testing.assert_allclose(topography.heights, HEIGHTS, rtol=1e-9)
    np.testing.assert_allclose(topography.lengths, SIDES, rtol=1e-6)


@pytest.mark.parametrize("write", [as_text, as_npy, as_gwy, as_netcdf, as_classic_netcdf])
def test_files_that_gzip_packed_are_read(tmp_path, write):
    write(tmp_path / "a")
    content = gzip.compress((tmp_path / "a").read_bytes())
    (tmp_path / "a.gz").write_bytes(content)
    lengths = SIDES if write in (as_text, as_npy) else None
    plain = js.surfaces.read(tmp_path / "a", lengths)
    packed = js.surfaces.read(tmp_path / "a.gz", lengths)
    np.testing.assert_array_equal(packed.heights, plain.heights)
    np.testing.assert_array_equal(packed.lengths, plain.lengths)
    assert (packed.unit, packed.remarks) == (plain.unit, plain.remarks)
    (tmp_path / "a.gz").write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match=r"a\.gz: its gzip data are truncated"):
        js.surfaces.read(tmp_path / "a.gz", lengths)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # A line of a matrix that SurfaceTopography takes for a part of the header.
        ("h=7 w=12\n" + ROWS + ROWS.splitlines()[0].replace("1", "l", 1), r"line 9: .* is no num"),
        (NOVA + ROWS.replace(".", ","), "line 1: 'File' is no number"),
        # It says nothing of axes or units, and so may be of any.
        ("Date 7.8.2024 by me\n" + ROWS, "line 1: 'Date' is no number"),
        ("heights in nm\n" + POINTS, "line 1: 'heights' is no number"),
        ("a b c\n" + POINTS, "line 1: 'a' is no number"),
        ("some words\nx (µm) z (nm)\n0 1\n1 2\n2 3\n", "line 1: 'some' is no number"),
        ("# x-pixels = 12\n# y-pixels = 9\n" + ROWS, "header says 'x-pixels = 12', as that of an"),
        # Units of no length, of x and y that differ, and decimal commas of one column or two.
        ("x [mm];z [V]\n0;1\n1;2\n2;4\n", "the unit is 'V'"),
        ("x in µm, Phase in deg\n0, 1\n1, 2\n2, 4\n", "'Phase in deg' has no unit of length"),
        ("x (µm), Current\n0, 1\n1, 2\n2, 4\n", "its column 'Current' has no unit of length"),
        ("x [mm];y [nm];z [nm]\n0;0;1\n0;1;2\n1;0;3\n1;1;4\n", "x and y are in different units"),
        ("X_(microns),y1\n1,500\n2,250\n3,125\n", "looks like decimal commas, or like two"),
        ("x (µm), z (nm)\n0, 1\n1, 2\n5, 3\n", "rises unevenly"),
        ("x (µm), z (nm)\n0, 1\n5, 2\n3, 3\n", "x neither rises nor falls"),
        ("x;y;z [nm]\n0;0;1\n3;1;2\n1;5;3\n", "points lie on no lattice"),
        ("# Breite: 3 µm\n# Einheiten: nm\n" + ROWS, "says one side of two"),
        ("# Kanal: a\n# Breite: 3 µm\n# Höhe: 1 µm\n" * 2 + ROWS, "holds several images"),
        ("pixel size = 0.25 µm\n" + "1 2 x 4\n" * 5, "line 1: 'pixel' is no number"),
    ],
)  # fmt: skip
def test_text_that_could_be_misread_is_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=rf"a\.txt: .*({message})"):
        js.surfaces.read(written(tmp_path, text), (1, 1))


def test_comments_of_ones_own_are_left_alone(tmp_path):
    header = "# h: heights along x\n# width of the tip = 3\n# Channel: Height\n"
    topography = js.surfaces.read(written(tmp_path, header + "1 2 3 4\n5 6 7 8\n"), (1, 2))
    np.testing.assert_array_equal(topography.heights, [[1, 2, 3, 4], [5, 6, 7, 8]])


def test_without_surface_topography_it_is_said_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "SurfaceTopography.IO", None)
    message = r"line 1: 'File' is no number.* pip install 'jaxstab\[surfaces\]'"
    with pytest.raises(ValueError, match=message):
        js.surfaces.read(written(tmp_path, MAPS["Nova"]))
    # What is read without it still is.
    js.surfaces.read(written(tmp_path, MAPS["Gwyddion, German"]))


def test_its_own_matrix_keeps_axes_and_gaps(tmp_path):
    masked = np.ma.masked_where(HEIGHTS > 0.2, HEIGHTS)
    path = tmp_path / "own.txt"
    SurfaceTopography.Topography(masked, SIDES, unit="µm", periodic=False).to_matrix(str(path))
    topography = js.surfaces.read(path).in_unit("µm")
    np.testing.assert_allclose(topography.heights, masked.filled(np.nan), rtol=1e-14)
    np.testing.assert_allclose(topography.lengths, SIDES)
