"""Figures: each function draws into a Matplotlib `Axes`, its own or a given one, and returns it.

`summary` and `transition` draw a whole figure, `save` writes a figure for print, and `animation` a
film of a path.
"""

from jaxstab.plots.adhesion_map import adhesion_map
from jaxstab.plots.animation import animation
from jaxstab.plots.branches import branch, transition
from jaxstab.plots.calibrations import calibration
from jaxstab.plots.curves import convergence, force, potential, spectrum, stability_curve
from jaxstab.plots.detachments import detachment
from jaxstab.plots.evolutions import evolution
from jaxstab.plots.fields import contact_map, gap, mode, mode_cut, pressure, surface
from jaxstab.plots.force_curves import force_curve
from jaxstab.plots.observables import distribution, flow, observed, patches
from jaxstab.plots.paths import path
from jaxstab.plots.saving import save
from jaxstab.plots.summary import summary

__all__ = [
    "adhesion_map",
    "animation",
    "branch",
    "calibration",
    "contact_map",
    "convergence",
    "detachment",
    "distribution",
    "evolution",
    "flow",
    "force",
    "force_curve",
    "gap",
    "mode",
    "mode_cut",
    "observed",
    "patches",
    "path",
    "potential",
    "pressure",
    "save",
    "spectrum",
    "stability_curve",
    "summary",
    "surface",
    "transition",
]


def __dir__() -> list[str]:
    return __all__
