"""The distribution of pull-off loads under thermal motion."""

import numpy as np
from matplotlib.axes import Axes

from jaxstab.core.checks import require_kind
from jaxstab.core.units import PRESSURE
from jaxstab.plots.style import PALETTE, add_legend, axes_or_new, grey, scaled_label
from jaxstab.transitions import Detachment

_POINTS = 400
# Loads are drawn from where this part has detached.
_FIRST = 1e-3


def detachment(detachment: Detachment, *, axes: Axes | None = None) -> Axes:
    """Draw the part of the contacts that survives a growing tension, a line for each rate.

    A dot marks each median. The grey line is the pull-off without thermal motion.

    Arguments:
        detachment: a result of `jaxstab.detachment` with `rate`.
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for anything else.
        ValueError: for a load that is held.

    Example:
        >>> energies = {"thermal_energy": 1e-4, "attempt_rate": 1e6}
        >>> life = js.detachment(contact, js.MeanPressure(-0.15), rate=1e-3, **energies)
        >>> axes = js.plots.detachment(life)
    """
    cure = "not a detachment: give a result of jaxstab.detachment."
    require_kind(detachment, Detachment, cure)
    first = -float(np.max(detachment.quantile(_FIRST)))
    last = -float(detachment.pull_off.load.value)
    tension = np.linspace(first, last, _POINTS)
    alive = np.asarray(detachment.survival(-tension)).reshape(-1, _POINTS)
    medians = -np.ravel(detachment.median)
    axes = axes_or_new(axes)
    divisor, label = scaled_label(detachment.pull_off.units, f"tension [{PRESSURE}]", last)
    axes.axvline(last / divisor, color=grey(axes, 0.4), linewidth=0.8)
    for i, rate in enumerate(np.ravel(np.asarray(detachment.rate))):
        colour = PALETTE[i % len(PALETTE)]
        axes.plot(tension / divisor, alive[i], color=colour, label=f"rate {rate:.3g}")
        axes.plot(medians[i] / divisor, 0.5, "o", color=colour)
    axes.set(xlabel=label, ylabel="part that survives", ylim=(0, 1))
    add_legend(axes)
    return axes
