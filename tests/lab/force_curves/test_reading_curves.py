"""Force curves from files of an instrument and from text, complete and with gaps."""

import warnings
import zipfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import jaxstab as js

# A curve of a JPK instrument, from the tests of afmformats (MIT License, P. Müller and others).
JPK = Path(__file__).parent / "spot3-0192.jpk-force"

HEIGHT = np.concatenate([np.linspace(100, -20, 61), np.linspace(-20, 100, 41)])
FORCE = np.where(HEIGHT < 0, -HEIGHT / 4, 0) - 0.5
TITLES = "height [nm],force [nN]"


def table(titles=TITLES, *columns, comments="# spring constant: 0.5 N/m\n"):
    columns = columns or (HEIGHT, FORCE)
    rows = "\n".join(",".join(map(str, row)) for row in zip(*columns, strict=True))
    return f"{comments}{titles}\n{rows}\n"


def read(folder, text, name="curve.csv", **options):
    path = folder / name
    path.write_text(text)
    return js.lab.force_curves.read(path, **options)


def test_named_columns_become_a_curve_in_si_units(tmp_path):
    curve = read(tmp_path, table())
    assert len(curve.approach) == 61
    assert len(curve.retraction) == 41
    np.testing.assert_allclose(curve.approach.height, 1e-9 * HEIGHT[:61], rtol=1e-14)
    np.testing.assert_allclose(curve.retraction.force, 1e-9 * FORCE[61:], rtol=1e-14)
    tip = 1e-9 * (HEIGHT + FORCE / 0.5)
    np.testing.assert_allclose(curve.retraction.tip_position, tip[61:], rtol=1e-14)
    assert curve.spring_constant == 0.5
    assert curve.approach.time is None
    assert curve.speed is None


@pytest.mark.parametrize(
    ("titles", "columns", "comments", "options"),
    [
        ("Z (um);Force_(pN)", (HEIGHT / 1e3, FORCE * 1e3), "# Spring constant: 500 mN/m\n", {}),
        ("extension [Å],force [pN]", (-10 * HEIGHT, FORCE * 1e3), "", {"spring_constant": 0.5}),
        ("tip [nm],load [nN]", (HEIGHT + FORCE / 0.5, FORCE), "% spring constant: 0.5 nN/nm\n", {}),
        (
            "height [nm],deflection [V]",
            (HEIGHT, FORCE / 25),
            "# sensitivity: 50 nm/V\n",
            {"spring_constant": 0.5},
        ),
        ("height [nm],deflection [nm]", (HEIGHT, FORCE * 2), "# spring constant: 0.5 N/m\n", {}),
    ],
)
def test_one_curve_reads_alike_in_other_columns_and_units(
    tmp_path, titles, columns, comments, options
):
    text = table(titles.replace(";", ","), *columns, comments=comments)
    if ";" in titles:
        text = text.replace(",", ";").replace(".", ",")
    curve = read(tmp_path, text, "curve.txt", **options)
    expected = read(tmp_path, table())
    for name, segment in expected.segments.items():
        other = curve.segments[name]
        for field in ("height", "force", "tip_position"):
            one, two = getattr(segment, field), getattr(other, field)
            np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-22)
    assert np.isclose(curve.spring_constant, 0.5)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32"])
@pytest.mark.parametrize("name", ["curve.csv", "curve.txt"])
def test_text_in_other_encodings_reads_alike(tmp_path, encoding, name):
    text = table("height [µm],force [nN]", HEIGHT / 1e3, FORCE)
    (tmp_path / name).write_bytes(text.encode(encoding))
    curve = js.lab.force_curves.read(tmp_path / name)
    np.testing.assert_allclose(curve.approach.height, 1e-9 * HEIGHT[:61], rtol=1e-12)


@pytest.mark.parametrize(
    "titles", ["height [nm] force [nN] segment", "segment  height (nm)   force (nN)"]
)
@pytest.mark.parametrize("mark", [".", ","])
def test_blanks_separate_titles_and_numbers(tmp_path, titles, mark):
    names = ["in"] * 61 + ["out"] * 41
    columns = {"height": HEIGHT, "force": FORCE, "segment": names}
    order = [word for word in titles.split() if word in columns]
    rows = zip(*(columns[name] for name in order), strict=True)
    body = "\n".join("   ".join(map(str, row)) for row in rows).replace(".", mark)
    curve = read(tmp_path, f"# spring constant: 0.5 N/m\n{titles}\n{body}\n", "curve.txt")
    np.testing.assert_allclose(curve.retraction.force, 1e-9 * FORCE[61:], rtol=1e-12)
    np.testing.assert_allclose(curve.approach.height, 1e-9 * HEIGHT[:61], rtol=1e-12)
    assert not curve.remarks


def test_text_of_an_instrument_that_is_not_known_is_told_of_named_columns(tmp_path):
    pytest.importorskip("afmformats")
    text = table("Z\tDeflection", comments="Ramp size: 500\n").replace(",", "\t")
    for name in ("export.txt", "export.asc"):
        with pytest.raises(ValueError, match="a line that names columns with units"):
            read(tmp_path, text, name)
    with pytest.raises(ValueError, match="no column force"):
        read(tmp_path, text, "export.csv")


def test_the_sensitivity_of_a_detector_of_currents_is_per_ampere(tmp_path):
    """Three columns, as Nova of NT-MDT exports them, begin with repeated values."""
    pytest.importorskip("afmformats")
    height = np.linspace(-3000, 0, 40)
    force = np.where(height > -500, (height + 500) / 1e3, 0.001 * np.arange(40))
    rows = zip(height, force, force, strict=True)
    text = "\n".join("\t".join(f"{x:.4f}".replace(".", ",") for x in row) for row in rows)
    curve = read(tmp_path, text, "nova.txt", spring_constant=0.05, sensitivity=50.0)
    assert "sensitivity      5e+07 µm/A" in repr(curve.in_units("µm", "nN"))
    assert curve.to_dataset().sensitivity.attrs["units"] == "m/A"


def test_units_are_converted_and_back(tmp_path):
    path = tmp_path / "curve.csv"
    columns = (HEIGHT, FORCE, np.arange(102.0), np.full(102, 3.0), np.full(102, 4.0))
    comments = "# spring constant: 0.5 N/m\n# sensitivity: 50 nm/V\n"
    path.write_text(table(f"{TITLES},time [ms],x [um],y [um]", *columns, comments=comments))
    curve = js.lab.force_curves.read(path)
    assert np.isclose(curve.speed, 120e-9 / 60e-3)
    changed = curve.in_units("nm", "pN")
    np.testing.assert_allclose(changed.approach.force, 1e3 * FORCE[:61], rtol=1e-12)
    np.testing.assert_allclose(changed.approach.height, HEIGHT[:61], rtol=1e-12)
    assert np.isclose(changed.spring_constant, 500)
    assert np.isclose(changed.sensitivity, 50)
    np.testing.assert_allclose(changed.position, [3e3, 4e3])
    np.testing.assert_allclose(changed.speed, 2e3)
    np.testing.assert_allclose(changed.approach.time, curve.approach.time)
    back = changed.in_units("m", "N")
    np.testing.assert_allclose(back.approach.tip_position, curve.approach.tip_position, rtol=1e-12)
    assert "0.5 N/m" in repr(changed)
    with pytest.raises(ValueError, match="unit of force is 'dyn'"):
        curve.in_units("nm", "dyn")


@pytest.mark.parametrize("first", [0.0, 0.25])
@pytest.mark.parametrize("labels", [True, False])
def test_times_that_begin_anew_in_each_segment_are_joined(tmp_path, first, labels):
    time = np.concatenate([np.arange(61), np.arange(20), np.arange(21)]) / 4 + first
    titles = f"{TITLES},time [s]"
    columns = [HEIGHT, FORCE, time]
    if labels:
        titles += ",segment"
        columns.append(["extend"] * 61 + ["pause"] * 20 + ["retract"] * 21)
    curve = read(tmp_path, table(titles, *columns))
    assert "times that begin anew at zero joined to one clock" in curve.remarks
    joined = np.sort(np.concatenate([part.time for part in curve.segments.values()]))
    np.testing.assert_allclose(joined, np.arange(102) / 4 + first)
    assert curve.approach.time[0] == first


def test_a_constant_time_is_not_used_and_others_stay_as_they_are(tmp_path):
    curve = read(tmp_path, table(f"{TITLES},time [s]", HEIGHT, FORCE, np.full(102, 3.0)))
    assert curve.approach.time is None
    assert curve.remarks[-1] == "times not used: all are 3 s"
    for time in (np.arange(102.0) + 5, np.arange(102.0)[::-1], np.arange(102.0) % 61 + 9):
        curve = read(tmp_path, table(f"{TITLES},time [s]", HEIGHT, FORCE, time))
        found = np.concatenate([curve.approach.time, curve.retraction.time])
        np.testing.assert_array_equal(found, time)


def test_segments_of_any_number_keep_all_points(tmp_path):
    pause = np.full(20, -20.0)
    height = np.concatenate([HEIGHT[:61], pause, HEIGHT[61:]])
    force = np.concatenate([FORCE[:61], np.linspace(4.5, 3, 20), FORCE[61:]])
    labels = ["extend"] * 61 + ["pause"] * 20 + ["retract"] * 41
    curve = read(tmp_path, table(f"{TITLES},segment", height, force, labels))
    assert [len(part) for part in curve.segments.values()] == [61, 41, 20]
    np.testing.assert_allclose(curve.pauses[0].force, 1e-9 * np.linspace(4.5, 3, 20))


def test_a_curve_that_lacks_parts_names_them(tmp_path):
    approach = read(tmp_path, table(TITLES, HEIGHT[:61], FORCE[:61], comments=""))
    assert approach.retraction is None
    assert "retraction       missing" in repr(approach)
    assert "spring constant  missing" in repr(approach)
    with pytest.raises(ValueError, match=r"read\(path, spring_constant=0.2\)"):
        approach.approach.tip_position  # noqa: B018
    holed = FORCE.copy()
    holed[[3, 70, 71]] = np.nan
    curve = read(tmp_path, table(TITLES, HEIGHT, holed))
    assert [part.num_missing for part in curve.segments.values()] == [1, 2]
    assert "41 points, 2 missing" in repr(curve)
    np.testing.assert_array_equal(np.isnan(curve.approach.force), np.arange(61) == 3)


def test_several_curves_are_a_sequence(tmp_path):
    twice = [np.tile(column, 2) for column in (HEIGHT, FORCE)]
    numbers = np.repeat(["a", "b"], 102)
    places = [np.repeat(pair, 102) for pair in ((1.0, 2.0), (0.0, 0.0))]
    titles = f"{TITLES},curve,x [um],y [um],note"
    notes = ["-"] * 204
    curves = read(tmp_path, table(titles, *twice, numbers, *places, notes))
    assert len(curves) == 2
    assert [curve.position for curve in curves] == [(1e-6, 0.0), (2e-6, 0.0)]
    assert curves[1].remarks[0] == "column 'note' not read"
    assert len(curves[:1]) == 1
    np.testing.assert_allclose(
        curves.in_units("nm", "nN")[1].approach.force, FORCE[:61], rtol=1e-12
    )
    with pytest.raises(ValueError, match="of no map"):
        curves.numbers  # noqa: B018


def test_curves_that_are_none_are_left_out_and_named(tmp_path):
    height, force = np.tile(HEIGHT, 3), np.tile(FORCE, 3)
    height[102:204] = 5.0
    force[204:] = np.nan
    columns = height, force, np.repeat(["a", "b", "c"], 102)
    message = r"2 of 3 curves are left out. .*curve b: its height is the same .*curve c: only 0 of"
    with pytest.warns(js.lab.force_curves.ForceCurveWarning, match=message):
        curves = read(tmp_path, table(f"{TITLES},curve", *columns))
    assert len(curves) == 1
    np.testing.assert_allclose(curves[0].approach.force, 1e-9 * FORCE[:61], rtol=1e-12)
    whole = table(f"{TITLES},curve", *(column[102:] for column in columns))
    with pytest.raises(ValueError, match="curve b: its height is the same"):
        read(tmp_path, whole)


def test_reversed_forces_of_several_curves_are_told_once(tmp_path):
    columns = *(np.tile(column, 3) for column in (HEIGHT, -FORCE)), np.repeat([1, 2, 3], 102)
    with pytest.warns(
        js.lab.force_curves.ForceCurveWarning, match="3 of 3 curves look wrong"
    ) as said:
        read(tmp_path, table(f"{TITLES},curve", *columns))
    assert len(said) == 1


@pytest.mark.parametrize(
    ("titles", "message"),
    [
        ("height,force", "its column 'height' has no unit"),
        ("height [nm],force [V]", r"its column 'force \[V\]' has the unit 'V'"),
        ("height [nm],z [nm]", "both the height: keep one"),
        ("time [s],force [nN]", "no column height or extension or tip"),
        ("height [nm],flow [nN]", "no column force or deflection"),
        ("tip [nm],force [nN]", "a tip position and no height"),
        ("height [nm],deflection [V]", "its sensitivity is unknown"),
        ("height [nm],deflection [nm]", "its spring constant is unknown"),
        ("extension [nm],force [nN]", "grows during the approach"),
    ],
)
def test_columns_that_do_not_suffice_are_named(tmp_path, titles, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, table(titles, comments=""))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("# only this\n", "no line but comments"),
        (TITLES, "names of columns, and no values"),
        (f"{TITLES}\n1,2\n3\n", r"line 3 has 1 values for 2 columns\.$"),
        (f"{TITLES}\n1,5,2,0\n", "4 values for 2 columns. If commas are decimal marks, save it"),
        (f'{TITLES}\n"1,5","2,0"\n', "'1,5' on line 2, no number. If commas are decimal marks"),
        (f"{TITLES}\n1,2\n3,high\n", "'high' on line 3"),
        (f"{TITLES}\n1,nan\n3,4\n5,\n", "only 1 of its points"),
        (f"{TITLES}\n1,2\n1,4\n1,5\n", "the same at all points"),
        (table(comments="# spring constant: 3\n"), "states no spring constant"),
        (table(comments="# spring constant: 0.5 N\n"), "states no spring constant"),
        (table(comments="# spring constant: -1 N/m\n"), "must be positive"),
    ],
)
def test_damaged_text_is_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, text)


def test_a_contradicted_spring_constant_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"is 0.5 N/m, the given one 0.4 N/m"):
        read(tmp_path, table(), spring_constant=0.4)


def test_numbers_and_units_that_are_mistaken_are_noticed(tmp_path):
    with pytest.raises(ValueError, match=r"is '0\.4': give a number in N/m"):
        read(tmp_path, table(TITLES), spring_constant="0.4")
    with pytest.raises(ValueError, match=r"as in `height \[nm\]`"):
        read(tmp_path, table("height,force [nN]"))
    with pytest.warns(js.lab.force_curves.ForceCurveWarning, match="are they in another unit"):
        curve = read(tmp_path, table(TITLES.replace("nm", "m")))
    assert "which no tip moves" in repr(curve)


def test_forces_with_the_wrong_sign_are_noticed_and_reversed(tmp_path):
    with pytest.warns(
        js.lab.force_curves.ForceCurveWarning, match="attraction seems to be positive"
    ):
        curve = read(tmp_path, table(TITLES, HEIGHT, -FORCE))
    assert "looks wrong" in repr(curve)
    expected = read(tmp_path, table())
    reversed_ = -curve
    assert not reversed_.suspicions
    for field in ("force", "tip_position"):
        one, two = (getattr(c.retraction, field) for c in (reversed_, expected))
        np.testing.assert_allclose(one, two, rtol=1e-12)


def test_a_file_of_an_instrument_is_read():
    pytest.importorskip("afmformats")
    curve = js.lab.force_curves.read(JPK)
    assert (len(curve.approach), len(curve.retraction)) == (2000, 2000)
    # As the header of the file states them.
    assert np.isclose(curve.spring_constant, 0.043493666407368466)
    assert np.isclose(curve.sensitivity, 7.000143623002982e-08)
    np.testing.assert_allclose(curve.speed, 5e-6, rtol=1e-3)
    np.testing.assert_allclose(curve.position, -5e-5 / 3)
    np.testing.assert_allclose(curve.approach.force[[0, -1]], [-5.14557919e-10, 3.48e-9], rtol=1e-3)
    np.testing.assert_allclose(curve.retraction.time[[0, -1]], [1, 1.9995])
    deflection = (curve.approach.tip_position - curve.approach.height) * curve.spring_constant
    np.testing.assert_allclose(deflection, curve.approach.force, rtol=1e-6)
    assert "A0042-CellHesion" in repr(curve)


def test_formats_of_afmformats_read_alike(tmp_path):
    afmformats = pytest.importorskip("afmformats")
    expected = js.lab.force_curves.read(JPK)
    (data,) = afmformats.load_data(JPK)
    for kind, name in {"tab": "curve.tab", "hdf5": "curve.h5"}.items():
        metadata = ["spring constant", "enum", "imaging mode"]
        data.export_data(tmp_path / name, fmt=kind, metadata=metadata)
        curve = js.lab.force_curves.read(tmp_path / name)
        np.testing.assert_allclose(
            curve.retraction.tip_position, expected.retraction.tip_position, rtol=1e-6
        )
        assert curve.sensitivity is None


WORKSHOP = """Force-Distance Curve
Date:\tWednesday, August 1, 2018
Time:\t1:07:47 PM
Mode:\tMapping
Point:\t{point}
X, um:\t{x}
Y, um:\t{y}

Extend Z-Sense(nm),Extend T-B(V),Retract Z-Sense(nm),Retract T-B(V)
"""


def workshop_map(path, pixels):
    rows = "\n".join(
        f"{-a},{fa},{-b},{fb}"
        for a, fa, b, fb in zip(HEIGHT[:41], FORCE[:41], HEIGHT[61:], FORCE[61:], strict=True)
    )
    with zipfile.ZipFile(path, "w") as archive:
        for point, (x, y) in enumerate(pixels, 1):
            head = WORKSHOP.format(point=point, x=x, y=y)
            archive.writestr(f"{point:02}.csv", head + rows)


def test_a_map_with_holes_keeps_its_pixels(tmp_path):
    pytest.importorskip("afmformats")
    path = tmp_path / "map.zip"
    pixels = [(0, 0), (1, 0), (2, 0), (0, 1), (2, 1)]
    workshop_map(path, pixels)
    with pytest.raises(ValueError, match=r"lacks the spring constant \[N/m\] and the sensitivity"):
        js.lab.force_curves.read(path)
    curves = js.lab.force_curves.read(path, spring_constant=0.5, sensitivity=20e-9)
    np.testing.assert_array_equal(curves.numbers, [[0, 3], [1, -1], [2, 4]])
    np.testing.assert_array_equal(curves.on_map(np.arange(5.0))[1], [1, np.nan])
    np.testing.assert_allclose(curves[2].approach.force, 10e-9 * FORCE[:41], rtol=1e-12)
    assert "3 x 2 pixels, 1 of 6 pixels missing" in repr(curves)


def archive_of(path, contents):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    return path


def test_an_archive_is_read_as_its_curves(tmp_path):
    pytest.importorskip("afmformats")
    contents = {
        "day 1/curve.csv": table(),
        "day 2/curve.csv": table(TITLES, HEIGHT, 2 * FORCE),
        "../../outside.csv": table(TITLES, HEIGHT, 3 * FORCE),
        "scan.jpk-force": JPK.read_bytes(),
        "notes.csv": "Two days in May\n",
        "__MACOSX/._curve.csv": "of a Macintosh",
    }
    path = archive_of(tmp_path / "folder.zip", contents)
    with pytest.warns(js.lab.force_curves.ForceCurveWarning, match=r"notes\.csv: ") as caught:
        curves = js.lab.force_curves.read(path)
    assert len(caught) == 1
    assert curves.sources == [
        "day 1/curve.csv",
        "day 2/curve.csv",
        "../../outside.csv",
        "scan.jpk-force",
    ]
    for number in range(3):
        force = curves[number].approach.force
        np.testing.assert_allclose(force, 1e-9 * (number + 1) * FORCE[:61], rtol=1e-12)
    expected = js.lab.force_curves.read(JPK).approach.force
    np.testing.assert_array_equal(curves[3].approach.force, expected)
    assert [*tmp_path.rglob("*")] == [path] and not (
        tmp_path.parent.parent / "outside.csv"
    ).exists()


def test_archives_without_curves_are_refused(tmp_path, monkeypatch):
    within = archive_of(tmp_path / "in.zip", {"curve.csv": table()}).read_bytes()
    for contents, message in (
        ({}, "holds no file"),
        ({"in.zip": within}, r"folder.zip: in.zip: it is an archive in the archive: unpack it"),
        ({"a/curve.csv": ""}, r"folder.zip: a/curve.csv: the file is empty"),
    ):
        path = archive_of(tmp_path / "folder.zip", contents)
        with pytest.raises(ValueError, match=message):
            js.lab.force_curves.read(path)
    path = archive_of(tmp_path / "damaged.zip", {"curve.csv": table()})
    content = bytearray(path.read_bytes())
    content[60:80] = bytes(20)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"damaged.zip: curve.csv: it is damaged"):
        js.lab.force_curves.read(path)
    content[content.index(b"PK\1\2")] = 0
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"damaged.zip: the archive is damaged"):
        js.lab.force_curves.read(path)
    monkeypatch.setattr("jaxstab.lab.force_curves.archives._LARGEST", 1000)
    bomb = archive_of(tmp_path / "bomb.zip", {"curve.csv": "0" * 2000})
    assert bomb.stat().st_size < 1000
    with pytest.raises(ValueError, match=r"its files have .* GB, more than"):
        js.lab.force_curves.read(bomb)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("curve.spm", b"\0\1\2", "its suffix '.spm' is none"),
        ("curve.jpk-force", b"PK\3\4 damaged", "afmformats cannot read it"),
        ("curve.ibw", b"\0" * 100, "afmformats cannot read it"),
    ],
)
def test_unknown_and_damaged_files_are_refused(tmp_path, name, content, message, capfd):
    pytest.importorskip("afmformats")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        js.lab.force_curves.read(tmp_path / name)
    assert capfd.readouterr().err == ""
    with pytest.raises(FileNotFoundError):
        js.lab.force_curves.read(tmp_path / "nothing.csv")


def test_without_afmformats_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "afmformats", None)
    with pytest.raises(ImportError, match=r"jaxstab\[afm\]"):
        js.lab.force_curves.read(JPK)
    assert len(read(tmp_path, table()).approach) == 61


def test_a_data_set_holds_every_number(tmp_path):
    curve = read(tmp_path, table(f"{TITLES},time [s]", HEIGHT, FORCE, np.arange(102)))
    dataset = curve.in_units("nm", "nN").to_dataset()
    np.testing.assert_allclose(dataset.approach_force, FORCE[:61], rtol=1e-12)
    assert dataset.retraction_tip_position.attrs["units"] == "nm"
    assert dataset.spring_constant.attrs["units"] == "nN/nm"
    numbers = np.repeat([1, 2], [102, 61])
    columns = [np.append(column, column[:61]) for column in (HEIGHT, FORCE)]
    curves = read(tmp_path, table(f"{TITLES},curve", *columns, numbers))
    joined = curves.to_dataset()
    assert dict(joined.sizes) == {"curve": 2, "approach_point": 61, "retraction_point": 41}
    np.testing.assert_allclose(joined.approach_force[1], 1e-9 * FORCE[:61], rtol=1e-12)
    assert np.isnan(joined.retraction_force[1]).all()


def test_a_figure_shows_every_segment(tmp_path):
    curve = read(tmp_path, table()).in_units("nm", "nN")
    axes = js.plots.force_curve(curve)
    assert [line.get_label() for line in axes.lines[:2]] == ["approach", "retraction"]
    np.testing.assert_allclose(axes.lines[0].get_xdata(), curve.approach.tip_position)
    np.testing.assert_allclose(axes.lines[1].get_ydata(), curve.retraction.force)
    assert axes.get_xlabel() == "tip position [nm]"
    assert axes.get_ylabel() == "force [nN]"
    with pytest.raises(ValueError, match="has no time"):
        js.plots.force_curve(curve, "time")
    plt.close("all")


def test_reading_is_silent(tmp_path):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read(tmp_path, table())
    assert caught == []


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "latin-1", "mac_roman"])
def test_a_unit_in_any_common_encoding(tmp_path, encoding):
    path = tmp_path / "curve.csv"
    lines = [f"{5 - 0.1 * i:.2f},{max(0, i - 20) * 0.3:.2f}" for i in range(60)]
    path.write_bytes("\n".join(["height [µm],force [nN]", *lines]).encode(encoding))
    height = js.lab.force_curves.read(path).approach.height
    np.testing.assert_allclose(height, np.linspace(5e-6, -0.9e-6, 60))


@pytest.mark.parametrize("encoding", ["cp437", "utf-8 twice"])
def test_a_unit_that_cannot_be_decoded_is_refused(tmp_path, encoding):
    path = tmp_path / "curve.csv"
    text = "height [µm],force [nN]\n1,2\n2,3\n3,4"
    content = text.encode("cp437") if encoding == "cp437" else text.encode().decode("latin-1")
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=r"has the unit .*name a length"):
        js.lab.force_curves.read(path)


def test_numbers_that_may_be_halves_of_numbers_are_refused(tmp_path):
    path = tmp_path / "curve.csv"
    rows = [f"{60 - i},{i % 10},{i // 4},{i % 7}" for i in range(60)]
    path.write_text("\n".join(["height [nm],force [nN],note,operator", *rows]))
    with pytest.raises(ValueError, match="may be the decimals of numbers"):
        js.lab.force_curves.read(path)
    # Words are no decimals, and points no whole numbers.
    for others in (",a,b", ".5,1,2"):
        words = [f"{60 - i},{i // 4}{others}" for i in range(60)]
        path.write_text("\n".join(["height [nm],force [nN],note,operator", *words]))
        assert len(js.lab.force_curves.read(path).approach) == 60


def test_a_map_with_pauses_of_several_lengths(tmp_path):
    path = tmp_path / "map.csv"
    lines = ["height [nm],force [nN],time [s],segment,curve"]
    for curve, pause in (("0", 5), ("1", 9)):
        moves = [("approach", 60 - np.arange(60)), ("pause", np.full(pause, 0.0))]
        time = 0.0
        for name, heights in [*moves, ("retraction", np.arange(1, 61))]:
            for height in heights:
                lines.append(f"{height},{max(0, 10 - height) * 0.5},{time:.2f},{name},{curve}")
                time += 0.01
    path.write_text("\n".join(lines))
    curves = js.lab.force_curves.read(path, spring_constant=0.5)
    assert [len(curve.pauses[0]) for curve in curves] == [5, 9]
    joined = curves.to_dataset()
    assert joined.sizes["pause_1_point"] == 9
    assert int(np.isnan(joined.pause_1_force[0]).sum()) == 4
