"""The axes of the laboratory's figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def axes_or_new(axes: Axes | None) -> Axes:
    """Return the given axes, or those of a new figure."""
    if axes is not None:
        return axes
    from matplotlib import pyplot as plt

    return plt.figure(layout="constrained").add_subplot()
