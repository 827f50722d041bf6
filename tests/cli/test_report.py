import shlex
import sys
import warnings
from html.parser import HTMLParser
from itertools import pairwise, takewhile
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import jaxstab as js
from jaxstab.__main__ import main
from jaxstab.lab import page
from jaxstab.lab.report_results import Arguments, results_of
from jaxstab.surfaces.processing import trend

MATERIAL = ["--modulus", "1e6", "--poisson-ratio", "0.4", "--work", "0.05"]
SCAN = ["--lengths", "2", "1.5", "--unit", "um"]


class Page(HTMLParser):
    """The cells of the tables, the texts, and all that the page loads or refers to."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.texts, self.addresses, self.tags = [], [], [], []
        self.words = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.addresses += [x for name, x in attributes if name in ("src", "href", "srcset", "data")]
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_data(self, data):
        self.texts.append(data)
        if self.tags and self.tags[-1] == "span":
            self.words.append(data)
        if self.tags and self.tags[-1] in ("td", "th") and self.rows:
            self.rows[-1][-1] += data.strip()

    def row(self, name):
        (cells,) = [cells[1:] for cells in self.rows if cells[0] == name]
        return cells


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A report on a scan of 16 x 12 points with a hole, and the file of the scan."""
    folder = tmp_path_factory.mktemp("report")
    heights = np.array(js.surfaces.sinusoid(js.Grid((16, 12)), 0.1, waves=(2, 1)))
    heights += 0.3 * np.linspace(0, 1, 16)[:, None]
    heights[4, 5] = np.nan
    # Text of a file must not be taken for tags.
    file = folder / "scan <b>&.txt"
    np.savetxt(file, heights)
    arguments = [*SCAN, *MATERIAL, "--detrend", "1", "--output", str(folder / "report.html")]
    main(["report", str(file), *arguments])
    return Page((folder / "report.html").read_text()), file


@pytest.mark.nightly
def test_a_report_loads_nothing_and_takes_no_text_for_tags(made):
    shown, file = made
    assert len(shown.addresses) == 7
    assert all(x.startswith("data:image/png;base64,") for x in shown.addresses)
    assert not {"script", "link", "iframe", "object", "b"} & {*shown.tags}
    assert shown.texts.count(f"Adhesion of {file.name}") == 2


@pytest.mark.nightly
def test_a_reports_numbers_are_those_of_the_library(made):
    shown, file = made
    surface = js.surfaces.read(file, lengths=(2.0, 1.5), unit="um").detrended().filled()
    surface = surface.periodic("as_is").in_unit("m")
    solid = js.HalfSpace(surface.grid, 1e6, 0.4)
    law = js.potentials.Exponential(0.05, 1e-7)
    shortest = float(js.resolved_range(js.Contact(solid, surface, law)))
    (text,) = shown.row("range rho")
    length = float(text.split(" nm")[0]) * 1e-9
    assert shortest <= length < 1.1 * shortest
    contact = js.Contact(solid, surface, js.potentials.Exponential(0.05, length))

    assert shown.row("rms height") == 2 * [f"{1e9 * np.std(surface.heights):.3g} nm"]
    energy = float(js.surfaces.full_contact_energy(solid, surface))
    (adhesion, _) = shown.row("w less the elastic energy of full contact")
    assert adhesion == f"{1e3 * (0.05 - energy):.3g} mJ/m²"
    assert shown.row("E* = E / (1 - nu²)") == [f"{1 / 0.84:.3g} MPa"]
    state = js.equilibrate(contact, js.MeanPressure(0.0))
    verdict = js.assess_stability(contact, state).verdict.name.replace("_", " ")
    area = f"{100 * float(state.contact_area):.1f} %"
    assert shown.row("without load") == [f"{area} of the area in contact, {verdict}"]
    assert shown.row("0 Pa")[0] == area
    # Extrapolated to the range from those that the grid resolves twice as well and better.
    ranges = js.resolved_range(contact, 8) * 1.3 ** np.arange(4)
    found = js.extrapolate(lambda other: -js.pull_off(other).load.value, contact, ranges=ranges)
    value, error = float(found.value) / 1e3, float(found.error) / 1e3
    rounded = float(f"{error:.1g}")
    at = f"{1e9 * length:.3g} nm"
    assert shown.row(f"pull-off at the range {at}") == [f"{value:.3g} ± {rounded:g} kPa"]
    assert any("is extrapolated from longer ranges" in text for text in shown.texts)
    assert shown.row(f"{1e9 * float(found.ranges[0]):.3g} nm")[0] == "8"
    tension = -float(js.pull_off(contact).load.value)
    assert shown.row(f"range {at}")[0] == f"{tension / 1e3:.3g} kPa"
    assert abs(value - tension / 1e3) < error
    coarse = surface.resampled((8, 6))
    other = js.Contact(js.HalfSpace(coarse.grid, 1e6, 0.4), coarse, contact.potential)
    change = 100 * (-float(js.pull_off(other).load.value) / tension - 1)
    assert shown.row("… on half the points along each side") == [f"{change:+.1f} %"]


@pytest.mark.nightly
def test_a_report_states_what_was_done_and_the_command(made):
    shown, file = made
    for warning in ("0.521 % of the points were missing", "has no self-affine band"):
        assert any(warning in text for text in shown.texts)
    words = shlex.split("".join(shown.words))
    assert words[:3] == ["python", "-m", "jaxstab"]
    assert words[3:5] == ["report", str(file)]
    options = dict(pairwise(words))
    length = float(shown.row("range rho")[0].split(" nm")[0]) * 1e-9
    assert float(options["--range"]) == pytest.approx(length)
    assert float(options["--work"]) == 0.05 and options["--size"] == "16"
    assert any("Rey" in text and "Computational Mechanics" in text for text in shown.texts)


def results(file, **arguments):
    scan = js.surfaces.read(file, (2.0, 1.5), "um")
    names = ("range", "size", "detrend", "periodic", "hardness")
    return results_of(scan, Arguments(1e6, 0.05, 0.4, **(dict.fromkeys(names) | arguments)))


def rough(size, rms=0.1):
    """A periodic surface of so many points, with waves of 16 to 4 spacings, on 2 x 1.5 µm."""
    grid = js.Grid((size, size), (2.0, 1.5))
    heights = js.surfaces.self_affine(
        grid, jax.random.key(0), k_low=size / 16, k_high=size / 4, rms_height=rms
    )
    return np.array(heights)


@pytest.fixture
def written(tmp_path):
    """Write heights to a file and return it."""

    def write(heights):
        np.savetxt(tmp_path / "heights.txt", heights)
        return tmp_path / "heights.txt"

    return write


# Half of the surface, with twice the points, has edges that do not meet.
PERIODIC, CUT = rough(32), rough(64)[:32, :32]
WAVE = 0.1 * np.sin(2 * np.pi * np.arange(32) / 32)[:, None] * np.ones(32)


@pytest.mark.parametrize(
    ("heights", "arguments", "treatment", "flat"),
    [
        (PERIODIC, {}, "as_is", PERIODIC),
        (PERIODIC + np.linspace(0, 3, 32)[:, None], {}, "as_is", PERIODIC),
        # The best plane of one wave is no tilt.
        (WAVE, {}, "as_is", WAVE),
        (WAVE + np.linspace(0, 3, 32)[:, None], {}, "as_is", WAVE),
        (np.zeros((8, 8)), {}, "as_is", np.zeros((8, 8))),
        (CUT, {}, "mirror", None),
        (CUT + np.linspace(0, 3, 32), {}, "mirror", None),
        (CUT, {"periodic": "window"}, "window", None),
        (PERIODIC, {"periodic": "window"}, "window", PERIODIC),
    ],
)
def test_only_a_scan_whose_edges_do_not_meet_is_treated(
    heights, arguments, treatment, flat, written
):
    known = next(results(written(heights), **arguments))
    assert known.treatment == treatment
    # What was measured stays, whatever the treatment does to it.
    # A periodic surface keeps its waves whole, another one is less its best plane.
    if flat is None:
        flat = heights - trend(heights, 1)
    assert known.measured.heights.std() == pytest.approx(1e-6 * flat.std(), rel=1e-3, abs=1e-12)
    measured = float(js.surfaces.rms_height(known.measured))
    contact = float(js.surfaces.rms_height(known.surface))
    assert (contact < 0.95 * measured) == (treatment == "window")


def test_measured_and_treated_values_stand_side_by_side(written, tmp_path, monkeypatch):
    file = written(CUT)
    monkeypatch.setattr("jaxstab.lab.report_results.loaded_states", interrupt)
    page_file = tmp_path / "report.html"
    with pytest.raises(SystemExit) as stopped:
        command = ["report", str(file), *SCAN, *MATERIAL, "--periodic", "window"]
        main([*command, "--output", str(page_file)])
    assert stopped.value.code == 130
    shown = Page(page_file.read_text())
    flat = CUT - trend(CUT, 1)
    measured, windowed = (float(text.removesuffix(" nm")) for text in shown.row("rms height"))
    assert measured == pytest.approx(1e3 * flat.std(), rel=5e-3)
    assert windowed < 0.95 * measured
    # The page can be read, and says what it lacks.
    assert any("This page is not complete" in text for text in shown.texts)
    (name,) = [cells[0] for cells in shown.rows if cells[0].startswith("pull-off")]
    assert name == f"pull-off at the range {shown.row('range rho')[0].split(',')[0]}"
    assert shown.row(name) == ["not computed yet"]


def interrupt(*_, **__):
    raise KeyboardInterrupt


class Found(SimpleNamespace):
    """A pull-off that was found, at a tension in Pa."""

    def __init__(self, tension):
        super().__init__(
            result=js.RESULTS.successful,
            load=js.MeanPressure(-tension),
            kind=js.results.KINDS.fold,
        )


@pytest.mark.parametrize(
    ("heights", "arguments", "error"),
    [
        # By points of the cell: mirrored 64, windowed 32, inner part 50.
        (CUT, {}, 0.12),
        # From 100 to 80 kPa.
        (CUT, {"periodic": "window"}, 0.2),
        (PERIODIC, {}, 0.0),
    ],
)
def test_the_error_contains_what_the_edges_change(heights, arguments, error, written, monkeypatch):
    tensions = {64: 80e3, 32: 100e3, 50: 80e3 * 1.12}

    def pull_off(contact, **_):
        return Found(tensions[contact.grid.shape[0]])

    # At a range that the grid resolves.
    size = 32 if arguments or heights is PERIODIC else 64
    stages = results(written(heights), **arguments, size=size, range=4e-7)
    monkeypatch.setattr(js, "pull_off", pull_off)
    monkeypatch.setattr("jaxstab.lab.report_results.loaded_states", lambda *_: [])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        known = next(known for known in stages if known.treated is not None)
    assert known.error_by_edges == pytest.approx(error)
    said = [str(x.message) for x in caught if "opposite edges meet" in str(x.message)]
    assert len(said) == (error > 0)
    if error == 0.12:
        assert "the scan was mirrored" in said[0]
        assert "windowed +25 %, inner part, mirrored +12 %" in said[0]


def test_a_range_that_the_grid_does_not_resolve_is_never_computed(written, monkeypatch):
    computed = []

    def pull_off(contact, **_):
        computed.append(float(contact.resolution))
        return Found(1e5 - 1e5 * (float(contact.potential.length) / 1e-6) ** 2)

    monkeypatch.setattr(js, "pull_off", pull_off)
    monkeypatch.setattr("jaxstab.lab.report_results.loaded_states", lambda *_: [])
    with pytest.warns(UserWarning, match="does not resolve a range of 1e-09 m: the pull"):
        *_, known = takewhile(
            lambda known: known.longer is None,
            results(written(PERIODIC), range=1e-9),
        )
    assert min(computed) > 3.99
    # The tensions fall as the square of the range, to 100 kPa at zero.
    assert known.tension.range == 1e-9
    assert known.tension.value == pytest.approx(1e5, rel=1e-4)


@pytest.mark.parametrize(
    ("heights", "arguments", "message"),
    [
        (np.eye(4), {}, "has 4 x 4 points, too few for a roughness: give a scan of at least 8"),
        (PERIODIC, {"range": 0.0}, "The length of the potential is 0"),
    ],
)
def test_what_has_no_report_is_said(heights, arguments, message, written):
    with pytest.raises(ValueError, match=message):
        next(results(written(heights), **arguments))


def test_heights_in_another_unit_are_told(written):
    with pytest.warns(UserWarning, match="hardly in one unit"):
        next(results(written(1e-6 * PERIODIC)))


def test_a_spike_is_told(written):
    heights = PERIODIC.copy()
    heights[3, 5] = 5.0
    with pytest.warns(UserWarning, match="1 of 1024 heights stand out alone"):
        next(results(written(heights)))


@pytest.mark.parametrize("heights", [np.zeros((8, 8)), np.sin(np.arange(16) * np.pi / 4)])
def test_a_surface_without_a_spectrum_has_a_page(heights, written, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxstab.lab.report_results.loaded_states", interrupt)
    file = written(heights.reshape(-1, 1) * np.ones(8) if heights.ndim == 1 else heights)
    with pytest.raises(SystemExit):
        main(["report", str(file), *SCAN, *MATERIAL, "--output", str(tmp_path / "a.html")])
    (text,) = Page((tmp_path / "a.html").read_text()).row("Hurst exponent")
    assert text.startswith("none: The spectrum has")


@pytest.mark.parametrize("name", ["follow", "pull_off"])
def test_a_report_whose_search_is_interrupted_leaves_its_page(
    name, written, tmp_path, monkeypatch, capsys
):
    # Both return what they have at Ctrl-C.
    ended = SimpleNamespace(result=js.RESULTS.interrupted)
    state = SimpleNamespace(equilibrium=SimpleNamespace(mean_gap=1e-8))
    monkeypatch.setattr("jaxstab.lab.report_results.loaded_states", lambda *_: [state])
    monkeypatch.setattr(sys.modules["jaxstab.lab.report"], "parts", lambda *_: ["part"])
    monkeypatch.setattr(js, "pull_off", lambda *_, **__: Found(1e5))
    monkeypatch.setattr(js, name, lambda *_, **__: ended)
    arguments = [*SCAN, *MATERIAL, "--range", "4e-7", "--output", str(tmp_path / "report.html")]
    with pytest.raises(SystemExit) as stopped:
        main(["report", str(written(PERIODIC)), *arguments])
    assert stopped.value.code == 130
    assert capsys.readouterr().err.endswith("jaxstab: interrupted.\n")
    assert "part" in (tmp_path / "report.html").read_text()


def test_texts_of_a_page_are_no_tags():
    text = '</p><script src="https://example.org/x.js">"&amp;'
    parts = [page.paragraph(text), page.table([(text, text)], [text, ""]), page.bullets([text])]
    figure = page.figures([(page.axes_of_figure(), text)])
    shown = Page(page.page(text, [*parts, page.heading(text), page.command([text]), figure]))
    assert "script" not in shown.tags
    assert shown.texts.count(text) == 10
    (address,) = shown.addresses
    assert address.startswith("data:image/png;base64,")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--modulus", "1e6"], "the following arguments are required: --work"),
        (["--modulus", "soft", "--work", "1"], "--modulus: 'soft' is not a finite number."),
        ([*SCAN, "--modulus", "-1", "--work", "0.05"], "Young's modulus is -1"),
        ([*SCAN, "--modulus", "1e6", "--work", "-1"], "surface energy is -1"),
        ([*SCAN, *MATERIAL, "--range", "0"], "The length of the potential is 0"),
        (
            [*SCAN, *MATERIAL, "--range", "50"],
            "--range is 50 m, longer than the periodic cell",
        ),
        ([*SCAN, *MATERIAL, "--size", "4"], "--size: '4' is not a whole number of at least 8."),
        (["--lengths", "2", "1.5", *MATERIAL], "has no unit of length: give --unit"),
        ([*SCAN, *MATERIAL, "--output", "there.html"], "there.html exists, and is not overwritten"),
        ([*SCAN, *MATERIAL, "--output", "a.pdf"], "a.pdf has no ending that can be written"),
        ([*SCAN, *MATERIAL, "--youngs-modulus", "1"], "there is no option --youngs-modulus"),
    ],
)
def test_bad_input_of_a_report_ends_in_one_line(
    scan, arguments, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.html").touch()
    with pytest.raises(SystemExit) as refused:
        main(["report", str(scan), *arguments])
    assert refused.value.code == 2
    *warnings, said = capsys.readouterr().err.splitlines()
    assert message in said
    assert len(warnings) <= 1
    assert not (tmp_path / "report.html").exists()
