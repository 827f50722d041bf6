"""Rough surfaces, generated and measured, and their statistics.

A surface is an array of heights on a grid [length]; summits point towards the elastic solid. A
measured surface is a `Topography`, read from a file by `read`, with its grid, its unit and
methods to prepare it for a contact.
"""

from jaxstab.core.text import text_of
from jaxstab.surfaces.faults import SurfaceWarning as SurfaceWarning
from jaxstab.surfaces.generated import self_affine, sinusoid
from jaxstab.surfaces.power_law import PowerLaw, power_law
from jaxstab.surfaces.read import read
from jaxstab.surfaces.shapes import (
    cone,
    flat_punch,
    hyperboloid,
    paraboloid,
    sphere,
    tip,
    wavy_sphere,
)
from jaxstab.surfaces.statistics import (
    Autocorrelation,
    PowerSpectrum,
    autocorrelation,
    effective_work_of_adhesion,
    full_contact_energy,
    power_spectrum,
    rms_curvature,
    rms_height,
    rms_slope,
)
from jaxstab.surfaces.topography import Topography

__all__ = [
    "Autocorrelation",
    "PowerLaw",
    "PowerSpectrum",
    "Topography",
    "autocorrelation",
    "cone",
    "effective_work_of_adhesion",
    "flat_punch",
    "full_contact_energy",
    "hyperboloid",
    "paraboloid",
    "power_law",
    "power_spectrum",
    "read",
    "rms_curvature",
    "rms_height",
    "rms_slope",
    "self_affine",
    "sinusoid",
    "sphere",
    "text_of",
    "tip",
    "wavy_sphere",
]


def __dir__() -> list[str]:
    return __all__
