"""What all figures share: colours, markers, the names of quantities, and units."""

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import Formatter, ScalarFormatter

from jaxstab.contact import Contact
from jaxstab.files.labels import dimension_on, prefixed, with_unit
from jaxstab.loads import Load

# Okabe & Ito's, told apart by all kinds of colour vision; their yellow is too pale for a line.
BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, BLACK = "#56B4E9", "#CC79A7", "#000000"
PALETTE = (BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE, BLACK)

# Shape and fill alone tell verdicts apart; filled where the cone's eigenvalue is positive.
VERDICT_MARKERS: dict[str, dict[str, Any]] = {
    "stable": {"marker": "o", "facecolors": BLUE, "edgecolors": BLUE},
    "stable, locally": {"marker": "D", "facecolors": SKY, "edgecolors": BLUE},
    "held_by_contact": {"marker": "o", "facecolors": "white", "edgecolors": BLUE},
    "unstable": {"marker": "v", "facecolors": "white", "edgecolors": VERMILION},
    "undecided": {"marker": "s", "facecolors": "0.8", "edgecolors": "0.4"},
}

# The quantities that are one number for each state, and their dimensions.
QUANTITIES = {
    "mean_gap": ("mean gap $g_0$", "length"),
    "mean_pressure": ("mean pressure $p_0$", "pressure"),
    "contact_area": ("contact area", "1"),
    "energy": ("energy", "energy"),
}


def quantity_label(quantity: str, num_sides: int) -> str:
    """Return what one of the `QUANTITIES` is on a grid of one side or two, with its dimension."""
    name, dimension = QUANTITIES[quantity]
    return f"{name} [{dimension_on(num_sides, dimension)}]"


def load_label(load: Load) -> str:
    """Return what the value of a load is; of one of the user's own, the name of its class."""
    return f"{load.quantity} [{load.unit}]" if load.quantity else type(load).__name__


def figure_or_new(figure: Figure | None, size: tuple[float, float]) -> Figure:
    """Return a figure for several panels, or a new one of a size [inches]."""
    figure = plt.figure(figsize=size) if figure is None else figure
    if figure.get_layout_engine() is None:
        figure.set_layout_engine("constrained")
    return figure


def axes_or_new(axes: Axes | None) -> Axes:
    """Return the axes given or new ones, whose curves, if they are the first, have our colours."""
    axes = plt.subplots(layout="constrained")[1] if axes is None else axes
    if not axes.has_data():
        axes.set_prop_cycle(color=PALETTE)
    return axes


def scaled_label(unit: Contact | str | None, label: str, largest: float) -> tuple[float, str]:
    """Return by what to divide values, for the prefix of an SI unit, and a label with that unit."""
    name, bracket, dimension = with_unit(unit, label).removesuffix("]").rpartition("[")
    divisor, dimension = prefixed(dimension, largest)
    return divisor, f"{name}[{dimension}]".replace("^2", "²") if bracket else dimension


class _Prefixed(Formatter):
    def __init__(self, divisor: float):
        self.divisor = divisor

    def __call__(self, x: float, pos: int | None = None) -> str:
        # Ticks near zero are off it by rounding.
        return self.fix_minus(f"{round(x / self.divisor, 9) + 0.0:g}")


def label_axis(axis: Axis, label: str, unit: Contact | str | None) -> None:
    """Label an axis; an SI unit gets the prefix that suits its limits, and its ticks go with it."""
    divisor, text = scaled_label(unit, label, max(map(abs, axis.get_view_interval())))
    axis.set_label_text(text)
    if divisor != 1:
        axis.set_major_formatter(_Prefixed(divisor))
    elif isinstance(axis.get_major_formatter(), _Prefixed):
        axis.set_major_formatter(ScalarFormatter())


def label_axes(axes: Axes, x: str, y: str, unit: Contact | str | None) -> None:
    """Label both axes."""
    label_axis(axes.xaxis, x, unit)
    label_axis(axes.yaxis, y, unit)


def draw_zero(axes: Axes) -> None:
    """Draw a thin line at zero."""
    axes.axhline(0, color="0.6", linewidth=0.8)


def add_legend(axes: Axes, **options: Any) -> None:
    """Add a legend beside the axes, where the layout makes room for it, or else inside."""
    figure = axes.get_figure(root=True)
    if figure is not None and figure.get_layout_engine() is not None:
        options = {"loc": "upper left", "bbox_to_anchor": (1, 1), **options}
    axes.legend(**options)
