"""The adhesion map of a sphere: where each closed form holds."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb

from jaxstab.core.checks import require_kind
from jaxstab.plots.style import (
    BLUE,
    GREEN,
    ORANGE,
    VERMILION,
    add_legend,
    axes_or_new,
    grey,
    plain_decades,
)
from jaxstab.references import AdhesionRegime
from jaxstab.references.adhesion_regime import contact_radius_errors

# Later zones lie over earlier ones: Hertz is the simplest form where several hold.
_ZONES = {"jkr": ("JKR", BLUE), "dmt": ("DMT", ORANGE), "hertz": ("Hertz", GREEN)}
_TOLERANCE = 0.05
# The ranges of lambda and of P / (pi w R).
_PARAMETERS, _LOADS = (1e-2, 1e2), (0.1, 1e3)


def adhesion_map(regime: AdhesionRegime, *, axes: Axes | None = None) -> Axes:
    """Draw the loads at which Hertz, JKR and DMT describe a sphere, and where the sphere lies.

    As the map of K. L. Johnson and J. A. Greenwood, J. Colloid Interface Sci. 192, 326 (1997). A
    zone is where the contact radius of a closed form is within 5 % of Maugis' at the same load;
    in the white zone only Maugis' solution holds. The marker lies at a load of the size of the
    pull-off force.

    Arguments:
        regime: a result of `jaxstab.references.regime`, for one sphere or several.
        axes: the axes to draw on; new ones by default.

    Raises:
        TypeError: for anything else.

    Example:
        >>> axes = js.plots.adhesion_map(js.references.regime(1.0, 1.0, 1e-3, 1e-2))
    """
    cure = "not a regime: give a result of jaxstab.references.regime."
    require_kind(regime, AdhesionRegime, cure)
    axes = axes_or_new(axes)
    spheres = np.ravel(regime.maugis)
    least, most = min(_PARAMETERS[0], spheres.min() / 3), max(_PARAMETERS[1], 3 * spheres.max())
    parameter, load = np.geomspace(least, most, 80), np.geomspace(*_LOADS, 120)
    errors = contact_radius_errors(parameter, load)
    paper = np.array(to_rgb(axes.get_facecolor()))
    for model, (name, colour) in _ZONES.items():
        pale = tuple(0.65 * paper + 0.35 * np.array(to_rgb(colour)))
        axes.contourf(parameter, load, errors[model].T, levels=[0, _TOLERANCE], colors=[pale])
        # Contours have no entry in a legend.
        axes.fill([], [], color=pale, label=f"{name} within {100 * _TOLERANCE:.0f} %")
    for each in spheres:
        axes.axvline(each, color=grey(axes, 0.4), linewidth=0.8)
    axes.plot(spheres, -np.ravel(regime.pull_off), "o", color=VERMILION, label="pull-off")
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(least, most),
        ylim=_LOADS,
        xlabel=r"Maugis' parameter $\lambda$ (1.127 times Tabor's $\mu$)",
        ylabel=r"load $P / (\pi w R)$",
    )
    for axis in (axes.xaxis, axes.yaxis):
        plain_decades(axis)
    add_legend(axes)
    return axes
