"""Figures on disk."""

import re
import sys

import equinox as eqx
import imageio_ffmpeg
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from PIL import Image, ImageSequence

from jaxstab import plots


@pytest.fixture
def drawn():
    axes = plt.subplots(figsize=(6, 4))[1]
    axes.plot([0, 1], [0, 1e6], "o-", label="a curve")
    axes.scatter([0.5], [2e5])
    # A function that cannot be pickled.
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:.1f}")
    axes.set(xlabel="x [length]", ylabel="a label of some\nheight", title="a title")
    axes.legend()
    return axes


@pytest.mark.parametrize(("width", "mm"), [("single", 90), ("double", 190), (60, 60)])
def test_a_bitmap_has_300_dots_per_inch_at_its_width(drawn, tmp_path, width, mm):
    file = plots.save(drawn, tmp_path / "figure.png", width=width)
    with Image.open(file) as image:
        np.testing.assert_allclose(image.size, mm / 25.4 * 300 * np.array([1, 4 / 6]), atol=1)
        pixels = np.asarray(image.convert("L"))
    edge = np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])
    # Nothing is cut.
    assert (edge == 255).all() and (pixels < 50).any()


def test_a_pdf_holds_its_letters_as_truetype(drawn, tmp_path):
    content = plots.save(drawn.figure, tmp_path / "figure.pdf", width="double").read_bytes()
    box = re.search(rb"/MediaBox \[ 0 0 ([0-9.]+)", content)
    np.testing.assert_allclose(float(box[1]), 190 / 25.4 * 72, rtol=1e-5)
    assert b"/CIDFontType2" in content or b"/TrueType" in content
    assert b"/Type3" not in content


@pytest.mark.parametrize("layout", [None, "constrained", "tight"])
def test_saving_leaves_the_figure_as_it_was(hertz, tmp_path, layout):
    figure, (left, right) = plt.subplots(1, 2, layout=layout)
    left.scatter([0.5, 1e5], [0.5, 0.7], label="marks", s=[10, 90])
    left.semilogx([1, 1e5], [0, 1], "o--", label="a line")
    left.set(xlabel="wavenumber", title="a title")
    left.legend()
    plots.surface(hertz, axes=right)

    def look():
        # Saving closes the figure, which leaves it without a canvas that draws.
        FigureCanvasAgg(figure)
        figure.canvas.draw()
        # A layout depends a little on the one before.
        figure.canvas.draw()
        sizes = [text.get_fontsize() for text in figure.findobj(Text)]
        marks = [(line.get_linewidth(), line.get_markersize()) for line in figure.findobj(Line2D)]
        widths = [part.get_linewidth() for part in figure.findobj(Patch)]
        places = [axes.get_position().bounds for axes in figure.axes]
        return sizes, marks, widths, places, np.asarray(figure.canvas.buffer_rgba(), float)

    before = look()
    plots.save(right, tmp_path / "figure.png")
    *properties, places, picture = look()
    assert properties == list(before[:3])
    np.testing.assert_allclose(places, before[3], atol=0 if layout is None else 2e-3)
    if layout is None:
        np.testing.assert_array_equal(picture, before[4])


def test_nothing_is_overwritten_and_no_nonsense_saved(drawn, tmp_path):
    file = plots.save(drawn, tmp_path / "figure.png")
    content = file.read_bytes()
    with pytest.raises(FileExistsError, match="is not overwritten: choose another name"):
        plots.save(drawn, file)
    assert file.read_bytes() == content
    file.write_bytes(b"an earlier figure")
    assert plots.save(drawn, file, overwrite=True) == file and file.read_bytes() == content
    with pytest.raises(ValueError, match=r"choose one of .*\.pdf, .*\.png"):
        plots.save(drawn, tmp_path / "figure.doc")
    with pytest.raises(FileNotFoundError, match="make it first"):
        plots.save(drawn, tmp_path / "nowhere" / "figure.png")
    for width in ("triple", 0, float("nan"), "90"):
        with pytest.raises(ValueError, match=rf"width is {width!r}: choose"):
            plots.save(drawn, tmp_path / "other.png", width=width)
    with pytest.raises(TypeError, match="list is no figure"):
        plots.save([drawn], tmp_path / "other.png")
    assert list(tmp_path.iterdir()) == [file]


def test_a_saved_figure_is_closed_and_can_be_saved_again(tmp_path):
    figures = [plt.subplots()[0] for _ in range(3)]
    for number, figure in enumerate(figures[1:]):
        plots.save(figure, tmp_path / f"{number}.png")
    assert plt.get_fignums() == [figures[0].number]
    again = plots.save(figures[1].axes[0], tmp_path / "again.png")
    assert again.read_bytes() == (tmp_path / "0.png").read_bytes()


def frames_of(file):
    with Image.open(file) as film:
        return [np.asarray(frame.convert("L")) for frame in ImageSequence.Iterator(film)]


@pytest.mark.nightly
def test_a_film_shows_contact_in_black_throughout(hertz, loop, tmp_path):
    # Half a second has room for seven frames.
    file = plots.animation(hertz, loop, tmp_path / "path.gif", seconds=0.5)
    frames = frames_of(file)
    assert len(frames) == 7
    states = np.linspace(0, len(loop.load.value) - 1, 7).round().astype(int)
    area = np.asarray(loop.equilibrium.contact_area)[states]
    black = [(frame[:, : frame.shape[1] // 2] < 10).sum() for frame in frames]
    assert np.ptp(area) > 0.05
    slope, rest = np.polyfit(area, black, 1)
    np.testing.assert_allclose(slope * area + rest, black, atol=0.02 * slope)


def test_a_film_is_also_an_mp4(hertz, loop, tmp_path):
    file = plots.animation(hertz, loop, tmp_path / "path.mp4", seconds=0.4)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(file)
    assert count == 6
    np.testing.assert_allclose(seconds, 0.4, atol=0.05)


def test_without_ffmpeg_both_cures_are_named(hertz, loop, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ImportError, match=r"on your system, or pip install 'jaxstab\[animation\]'"):
        plots.animation(hertz, loop, tmp_path / "path.mp4", seconds=0.2)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_filmed_is_told(hertz, loop, tmp_path):
    bare = eqx.tree_at(lambda x: x.equilibrium.gap, loop, None)
    file = tmp_path / "path.gif"
    with pytest.raises(ValueError, match="follow it with fields=True"):
        plots.animation(hertz, bare, file)
    with pytest.raises(ValueError, match=r"choose one of \.gif, \.mp4"):
        plots.animation(hertz, loop, tmp_path / "path.avi")
    with pytest.raises(ValueError, match="seconds is 0: it must be positive"):
        plots.animation(hertz, loop, file, seconds=0)
    with pytest.raises(TypeError, match="States is not a path"):
        plots.animation(hertz, loop.equilibrium, file)
    file.touch()
    with pytest.raises(FileExistsError, match="or give `overwrite=True`"):
        plots.animation(hertz, loop, file)


def test_by_default_a_wide_figure_fills_a_page_and_in_a_column_it_is_told_to_be_crowded(tmp_path):
    figure, _ = plt.subplots(1, 2, figsize=(10, 4))
    page = plots.save(figure, tmp_path / "page.png")
    with pytest.warns(UserWarning, match="figure of 254 mm is hard to read at 90 mm"):
        column = plots.save(figure, tmp_path / "column.png", width="single")
    widths = [plt.imread(file).shape[1] / 300 * 25.4 for file in (page, column)]
    np.testing.assert_allclose(widths, [190, 90], atol=0.2)


def test_a_figure_that_cannot_be_written_whole_leaves_no_file(drawn, tmp_path, monkeypatch):
    def fail(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="No space left"):
        plots.save(drawn, tmp_path / "figure.png")
    assert not list(tmp_path.iterdir())
