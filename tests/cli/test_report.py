import shlex
from html.parser import HTMLParser
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

import jaxstab as js
from jaxstab.__main__ import main
from jaxstab.cli import page

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
    main(["report", str(file), *SCAN, *MATERIAL, "--output", str(folder / "report.html")])
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
    surface = surface.periodic("window").detrended(0).in_unit("m")
    solid = js.HalfSpace(surface.grid, 1e6, 0.4)
    law = js.potentials.Exponential(0.05, 1e-7)
    shortest = float(js.resolved_range(js.Contact(solid, surface, law)))
    (text,) = shown.row("range rho")
    length = float(text.split(" nm")[0]) * 1e-9
    assert shortest <= length < 1.1 * shortest
    contact = js.Contact(solid, surface, js.potentials.Exponential(0.05, length))

    assert shown.row("rms height") == [f"{1e9 * np.std(surface.heights):.3g} nm"]
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
    assert shown.row("pull-off") == [f"{value:.3g} ± {rounded:g} kPa"]
    assert any("is extrapolated to the range" in text for text in shown.texts)
    assert shown.row(f"{1e9 * float(found.ranges[0]):.3g} nm")[0] == "8"
    tension = -float(js.pull_off(contact).load.value)
    assert shown.row("as above")[0] == f"{tension / 1e3:.3g} kPa"
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


@pytest.mark.parametrize("name", ["follow", "pull_off"])
def test_a_report_whose_search_is_interrupted_ends_and_writes_nothing(
    name, scan, tmp_path, monkeypatch, capsys
):
    # Both return what they have at Ctrl-C.
    ended = SimpleNamespace(result=js.RESULTS.interrupted)
    state = SimpleNamespace(equilibrium=SimpleNamespace(mean_gap=1e-8))
    found = SimpleNamespace(result=js.RESULTS.successful)
    monkeypatch.setattr("jaxstab.cli.report_results.loaded_states", lambda *_: [state])
    monkeypatch.setattr(js, "follow", lambda *_, **__: found)
    monkeypatch.setattr(js, name, lambda *_, **__: ended)
    with pytest.raises(SystemExit) as stopped:
        main(["report", str(scan), *SCAN, *MATERIAL, "--output", str(tmp_path / "report.html")])
    assert stopped.value.code == 130
    assert capsys.readouterr().err.endswith("jaxstab: interrupted.\n")
    assert not (tmp_path / "report.html").exists()


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
        ([*SCAN, *MATERIAL, "--range", "50"], "--range is 50 m, longer than the scan of 2e-06 m"),
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
