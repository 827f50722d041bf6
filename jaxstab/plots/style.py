"""The style of all figures: colours, markers, the names of quantities, and units."""

from collections.abc import Sequence
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis, YAxis
from matplotlib.colors import to_hex, to_rgb
from matplotlib.ticker import Formatter, LogFormatterSciNotation, ScalarFormatter

from jaxstab.core.checks import require_kind
from jaxstab.core.units import (
    FORCE,
    LENGTH,
    NUMBER,
    PRESSURE,
    Units,
    dimensions,
    in_brackets,
    readable_unit,
)
from jaxstab.loads import Load
from jaxstab.states import States

# Okabe & Ito's palette is distinct for all kinds of colour vision; their yellow is too pale.
BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN = "#009E73"
ORANGE = "#E69F00"
SKY = "#56B4E9"
PURPLE = "#CC79A7"
BLACK = "#000000"
PALETTE = (BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE)

# Properties of lines and markers, by their names in Matplotlib.
Style = dict[str, Any]
# The panels of a figure by name, row by row.
Panels = list[Any]
# A quantity spans decades if all of its values are positive, its median is less than this part
# of the largest one, and the least value this part of it.
_MEDIAN = 0.03
_LEAST = 1e-3

# The quantities that are one number for each state.
QUANTITIES = {
    "mean_gap": "mean gap $g_0$",
    "mean_pressure": "mean pressure $p_0$",
    "force": "force",
    "contact_area": "contact area",
    "energy": "energy",
    "indentation": r"indentation $\delta$",
}


def quantity_label(quantity: str, load: Load) -> str:
    """Return the label of one of the `QUANTITIES`, or of the "load", with its dimension."""
    if quantity != "load":
        dimension = {**dimensions(States), "force": FORCE, "indentation": LENGTH}[quantity]
        return with_dimension(QUANTITIES[quantity], dimension)
    if not load.quantity:
        return type(load).__name__
    return f"{load.quantity} [{load.unit}]"


def with_dimension(label: str, dimension: str) -> str:
    """Return a label with a dimension in brackets, which a number does not have."""
    if dimension == NUMBER:
        return label
    return f"{label} [{dimension}]"


def default_ordinate(
    load: Load, is_window: bool, abscissa: str
) -> Literal["mean_gap", "mean_pressure", "force"]:
    """Return the quantity that answers to a load: under a dead load the gap, else the pressure."""
    if load.unit == PRESSURE and abscissa in ("load", "time"):
        return "mean_gap"
    return "force" if is_window else "mean_pressure"


def grey(axes: Axes, darkness: float) -> str:
    """Return a grey from the background of axes, at 0, to the colour of their text, at 1."""
    paper, ink = (np.array(to_rgb(x)) for x in (axes.get_facecolor(), axes.xaxis.label.get_color()))
    mixed: Any = paper + darkness * (ink - paper)
    return to_hex(mixed)


def verdict_markers(axes: Axes) -> dict[str, Style]:
    """Return the marker of each verdict.

    They differ by shape and fill; a filled marker means a positive eigenvalue of the cone.
    """
    empty = grey(axes, 0)
    return {
        "stable": {"marker": "o", "facecolors": BLUE, "edgecolors": BLUE},
        "stable, locally": {"marker": "D", "facecolors": SKY, "edgecolors": BLUE},
        "held_by_contact": {"marker": "o", "facecolors": empty, "edgecolors": BLUE},
        "unstable": {"marker": "v", "facecolors": empty, "edgecolors": VERMILION},
        "undecided": {"marker": "s", "facecolors": grey(axes, 0.2), "edgecolors": grey(axes, 0.6)},
    }


def axes_or_new(axes: Axes | None) -> Axes:
    """Return the given axes or new ones; empty axes get the palette."""
    if axes is None:
        axes = plt.subplots(layout="constrained")[1]
    require_kind(axes, Axes, "not axes: give the axes of a figure, as plt.subplots()[1].")
    if not axes.has_data():
        axes.set_prop_cycle(color=[*PALETTE, grey(axes, 1)])
    return axes


def scaled_label(units: Units, label: str, largest: float) -> tuple[float, str]:
    """Return a divisor of values for a readable unit, and the label with this unit."""
    name, bracket, dimension = label.removesuffix("]").rpartition("[")
    if not bracket:
        return 1.0, label
    divisor, unit = readable_unit(units, dimension, largest)
    return divisor, name + in_brackets(unit)


class _Plain(LogFormatterSciNotation):
    def __call__(self, x: float, pos: int | None = None) -> str:
        text = super().__call__(x, pos)
        return f"{x:g}" if text and 1e-3 <= x < 1e4 else text


def plain_decades(axis: Axis) -> None:
    """Label a logarithmic axis by plain numbers, as 6 and not 6×10⁰, if they are short."""
    axis.set_major_formatter(_Plain())
    axis.set_minor_formatter(_Plain(labelOnlyBase=False))


class _Prefixed(Formatter):
    # Of a class of its own, so that a formatter of the user is left alone.
    def __init__(self, divisor: float):
        self.divisor = divisor

    def __call__(self, x: float, pos: int | None = None) -> str:
        # Rounding moves ticks off zero.
        return self.fix_minus(f"{round(x / self.divisor, 9) + 0.0:g}")


def label_axis(axis: Axis, label: str, units: Units) -> None:
    """Label an axis and its ticks in a unit with a prefix that suits its limits."""
    divisor, text = scaled_label(units, label, max(map(abs, axis.get_view_interval())))
    axis.set_label_text(text)
    if divisor != 1:
        axis.set_major_formatter(_Prefixed(divisor))
    elif isinstance(axis.get_major_formatter(), _Prefixed):
        axis.set_major_formatter(ScalarFormatter())


def scale_decades(axis: XAxis | YAxis, values: np.ndarray) -> None:
    """Make an axis logarithmic if its values span decades."""
    known = values[np.isfinite(values)]
    if not known.size or known.min() <= 0:
        return
    parts = np.array([np.median(known), known.min()]) / known.max()
    if np.all(parts < (_MEDIAN, _LEAST)):
        axis.axes.set(**{f"{axis.axis_name}scale": "log"})
        plain_decades(axis)


def label_axes(axes: Axes, x: str, y: str, units: Units) -> None:
    """Label both axes."""
    label_axis(axes.xaxis, x, units)
    label_axis(axes.yaxis, y, units)


def labels_or_none(labels: Sequence[str] | None, number: int) -> Sequence[str | None]:
    """Return the labels of so many curves, `None` for each if there are none."""
    if labels is None:
        return [None] * number
    if isinstance(labels, str) or len(labels) != number:
        raise ValueError(f"The labels are {labels!r}: give a list of {number}, one for each curve.")
    return labels


def draw_zero(axes: Axes) -> None:
    """Draw a thin line at zero."""
    axes.axhline(0, color=grey(axes, 0.4), linewidth=0.8)


def add_legend(axes: Axes, **options: Any) -> None:
    """Add a legend, if it has entries, beside the axes if the layout makes room, else inside."""
    if not axes.get_legend_handles_labels()[0]:
        return
    figure = axes.get_figure(root=True)
    if figure is not None and figure.get_layout_engine() is not None:
        options = {"loc": "upper left", "bbox_to_anchor": (1, 1), **options}
    axes.legend(**options)
