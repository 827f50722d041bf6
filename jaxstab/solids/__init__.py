"""Elastic solids: their interface, and one file per kind."""

from jaxstab.solids.axisymmetric import Axisymmetric, AxisymmetricHalfSpace, AxisymmetricSolid
from jaxstab.solids.free_half_space import FreeHalfSpace
from jaxstab.solids.half_space import HalfSpace
from jaxstab.solids.layers import CoatedHalfSpace, Layer
from jaxstab.solids.prony_fit import RelaxationWarning
from jaxstab.solids.solid import Altered, Solid, apart_from_mean
from jaxstab.solids.spectral import Spectral, SpectralSolid, Waves
from jaxstab.solids.surface_tension import Sheet, SurfaceTension
from jaxstab.solids.temperature_shift import (
    Arrhenius,
    ShiftTable,
    TemperatureShift,
    WilliamsLandelFerry,
)
from jaxstab.solids.viscoelastic import Viscoelastic

__all__ = [
    "Altered",
    "Arrhenius",
    "Axisymmetric",
    "AxisymmetricHalfSpace",
    "AxisymmetricSolid",
    "CoatedHalfSpace",
    "FreeHalfSpace",
    "HalfSpace",
    "Layer",
    "RelaxationWarning",
    "Sheet",
    "ShiftTable",
    "Solid",
    "Spectral",
    "SpectralSolid",
    "SurfaceTension",
    "TemperatureShift",
    "Viscoelastic",
    "Waves",
    "WilliamsLandelFerry",
    "apart_from_mean",
]
