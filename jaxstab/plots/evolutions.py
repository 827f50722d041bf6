"""Viscoelastic contacts in time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from matplotlib.axes import Axes

from jaxstab.core.checks import require_kind, require_one_of
from jaxstab.evolution import Evolution
from jaxstab.plots.style import (
    add_legend,
    axes_or_new,
    default_ordinate,
    label_axes,
    labels_or_none,
    plain_decades,
    quantity_label,
)

Quantity = Literal["mean_gap", "mean_pressure", "force", "contact_area"]


def evolution(
    *evolutions: Evolution,
    x: Literal["load", "time"] = "load",
    y: Quantity | None = None,
    labels: Sequence[str] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Draw contacts in time: pressure or force over the load, or over the logarithm of time.

    Arguments:
        evolutions: one or more of the same contact, for instance at several speeds.
        x: "load", or "time" on a logarithmic axis without the first state.
        y: a quantity of the states; by default the mean pressure, or on a window the force; under a
            dead load the mean gap.
        labels: one for each evolution, for a legend.
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for something that is not an evolution.
        ValueError: for a quantity that cannot be drawn, another number of labels,
            a single state or a batch, and without any state that was found.

    Example:
        >>> rubber = js.Contact(js.Viscoelastic(solid, (1.0,), (0.1,)), heights, law)
        >>> axes = js.plots.evolution(js.evolve(rubber, js.MeanGap([0.3, 0.05]), [0.0, 1.0]))
    """
    for each in evolutions or [None]:
        require_kind(each, Evolution, "no evolution: give a result of jaxstab.evolve.")
    if any(each.times.ndim != 1 or each.is_batch for each in evolutions):
        raise ValueError(
            "A single state has no times to draw, and a batch has several evolutions: give whole "
            "evolutions, as batch[0]."
        )
    contact = evolutions[0].contact
    y = y or default_ordinate(evolutions[0].load, contact.solid.is_window, x)
    require_one_of("x", x, ["load", "time"])
    require_one_of("y", y, Quantity.__args__)
    names = labels_or_none(labels, len(evolutions))
    axes = axes_or_new(axes)
    for each, label in zip(evolutions, names, strict=True):
        across = np.asarray(each.load.value)
        values = np.asarray(getattr(each, y))
        if x == "time":
            # The logarithm of the first time may be infinite.
            across = np.asarray(each.times)[1:]
            values = values[1:]
        if not np.isfinite(values).any():
            ended = each.result.name[-1] if len(each) else "none"
            raise ValueError(f"No state to draw was found ({ended}).")
        axes.plot(across, values, ".-", label=label)
    load = evolutions[0].load
    name = "time"
    if x == "load":
        name = quantity_label(x, load)
    label_axes(axes, name, quantity_label(y, load), contact.units)
    if x == "time":
        axes.set_xscale("log")
        plain_decades(axes.xaxis)
    if labels is not None:
        add_legend(axes)
    return axes
