"""Elastic solids: what they all are, and one file per kind."""

from jaxstab.elasticity.half_space import HalfSpace
from jaxstab.elasticity.layers import CoatedHalfSpace, Layer
from jaxstab.elasticity.solid import Field, FieldMap, Solid, apart_from_mean
from jaxstab.elasticity.spectral import Spectral, SpectralSolid

__all__ = [
    "CoatedHalfSpace",
    "Field",
    "FieldMap",
    "HalfSpace",
    "Layer",
    "Solid",
    "Spectral",
    "SpectralSolid",
    "apart_from_mean",
]
