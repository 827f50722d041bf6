"""Fits to measured curves."""

from typing import Literal

import numpy as np
from matplotlib.axes import Axes

from jaxstab.calibration import Calibration
from jaxstab.core.checks import require_kind, require_one_of
from jaxstab.core.units import FORCE, LENGTH
from jaxstab.loads import FarDisplacement
from jaxstab.plots.style import (
    BLUE,
    VERMILION,
    add_legend,
    axes_or_new,
    draw_zero,
    label_axes,
    quantity_label,
    with_dimension,
)

_ORDINATES = {"force": "force", "residuals": "measured less fitted force"}


def calibration(
    fit: Calibration,
    quantity: Literal["force", "residuals"] = "force",
    *,
    axes: Axes | None = None,
) -> Axes:
    """Draw measured and fitted forces over the load, or the residuals, which should be noise.

    Arguments:
        fit: a result of `jaxstab.calibrate`.
        quantity: "force" or "residuals".
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for anything but a fit.
        ValueError: for another quantity, and for several fits.

    Example:
        >>> loads = js.MeanGap(jnp.linspace(0.08, 0.2, 6))
        >>> measured = js.sweep(contact, loads, stability=False).equilibrium.mean_pressure
        >>> fit = js.calibrate(contact, loads, measured, where=lambda c: c.potential.surface_energy)
        >>> axes = js.plots.calibration(fit)
    """
    require_kind(fit, Calibration, "no fit: give a result of jaxstab.calibrate.")
    require_one_of("quantity", quantity, _ORDINATES)
    if fit.loss.ndim:
        raise ValueError("These are several fits: draw one, as jax.tree.map(lambda x: x[0], fit).")
    axes = axes_or_new(axes)
    load = np.asarray(fit.load.value)
    if quantity == "residuals":
        axes.plot(load, np.asarray(fit.residuals), "o", markersize=4, color=BLUE)
        draw_zero(axes)
    else:
        measured = np.asarray(fit.measured * fit.area)
        axes.plot(load, measured, "o", markersize=4, color=BLUE, label="measured")
        axes.plot(load, np.asarray(fit.force), color=VERMILION, label="fit")
        draw_zero(axes)
        add_legend(axes)
    ordinate = f"{_ORDINATES[quantity]} [{FORCE}]"
    abscissa = quantity_label("load", fit.load)
    if isinstance(fit.load, FarDisplacement):
        # A curve is measured over the position of the tip, which is the load of the far side.
        abscissa = with_dimension("tip position", LENGTH)
    label_axes(axes, abscissa, ordinate, fit.contact.units)
    return axes
