"""What all figures share: colours, markers, the names of quantities, and units."""

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from jaxstab.loads import Load

# Okabe & Ito's, told apart by all kinds of colour vision; their yellow is too pale for a line.
BLUE, VERMILION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, BLACK = "#56B4E9", "#CC79A7", "#000000"
PALETTE = (BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE, BLACK)

# Shape and fill alone tell verdicts apart; filled where the cone's eigenvalue is positive.
VERDICT_MARKERS: dict[str, dict[str, Any]] = {
    "stable": {"marker": "o", "facecolors": BLUE, "edgecolors": BLUE},
    "held_by_contact": {"marker": "o", "facecolors": "white", "edgecolors": BLUE},
    "unstable": {"marker": "v", "facecolors": "white", "edgecolors": VERMILION},
    "undecided": {"marker": "s", "facecolors": "0.8", "edgecolors": "0.4"},
}

# The quantities that are one number for each state.
QUANTITIES = {
    "mean_gap": "mean gap $g_0$ [length]",
    "mean_pressure": "mean pressure $p_0$ [pressure]",
    "contact_area": "contact area [1]",
    "energy": "energy [energy]",
}


def load_label(load: Load) -> str:
    """Return what the value of a load is; of one of the user's own, the name of its class."""
    return f"{load.quantity} [{load.unit}]" if load.quantity else type(load).__name__


def axes_or_new(axes: Axes | None) -> Axes:
    """Return the axes given or new ones, whose curves, if they are the first, have our colours."""
    axes = plt.subplots(layout="constrained")[1] if axes is None else axes
    if not axes.has_data():
        axes.set_prop_cycle(color=PALETTE)
    return axes
