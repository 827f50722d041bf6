"""Elastic solids: their interface, and one file per kind."""

from jaxstab.solids.free_half_space import FreeHalfSpace
from jaxstab.solids.half_space import HalfSpace
from jaxstab.solids.layers import CoatedHalfSpace, Layer
from jaxstab.solids.solid import Altered, Solid, apart_from_mean
from jaxstab.solids.spectral import Spectral, SpectralSolid, Waves
from jaxstab.solids.surface_tension import Sheet, SurfaceTension
from jaxstab.solids.viscoelastic import Viscoelastic
from jaxstab.solids.williams_landel_ferry import WilliamsLandelFerry

__all__ = [
    "Altered",
    "CoatedHalfSpace",
    "FreeHalfSpace",
    "HalfSpace",
    "Layer",
    "Sheet",
    "Solid",
    "Spectral",
    "SpectralSolid",
    "SurfaceTension",
    "Viscoelastic",
    "Waves",
    "WilliamsLandelFerry",
    "apart_from_mean",
]
