"""Elastic solids: their interface, and one file per kind."""

from jaxstab.solids.anisotropic import Anisotropic, Indentation
from jaxstab.solids.axisymmetric import Axisymmetric, AxisymmetricHalfSpace, AxisymmetricSolid
from jaxstab.solids.free_half_space import FreeHalfSpace
from jaxstab.solids.graded import Graded
from jaxstab.solids.half_space import HalfSpace
from jaxstab.solids.layered import CoatedHalfSpace, Layer, Layered
from jaxstab.solids.materials import Crystal, Film, Isotropic
from jaxstab.solids.relaxation_data import RelaxationWarning as RelaxationWarning
from jaxstab.solids.solid import Altered as Altered
from jaxstab.solids.solid import Solid
from jaxstab.solids.spectral import Spectral, SpectralSolid
from jaxstab.solids.spectral import Waves as Waves
from jaxstab.solids.surface_tension import Sheet, SurfaceTension
from jaxstab.solids.temperature_shift import (
    Arrhenius,
    ShiftTable,
    TemperatureShift,
    WilliamsLandelFerry,
)
from jaxstab.solids.viscoelastic import Viscoelastic

__all__ = [
    "Anisotropic",
    "Arrhenius",
    "Axisymmetric",
    "AxisymmetricHalfSpace",
    "AxisymmetricSolid",
    "CoatedHalfSpace",
    "Crystal",
    "Film",
    "FreeHalfSpace",
    "Graded",
    "HalfSpace",
    "Indentation",
    "Isotropic",
    "Layer",
    "Layered",
    "Sheet",
    "ShiftTable",
    "Solid",
    "Spectral",
    "SpectralSolid",
    "SurfaceTension",
    "TemperatureShift",
    "Viscoelastic",
    "WilliamsLandelFerry",
]


def __dir__() -> list[str]:
    return __all__
