"""Elastic solids: what they all are, and one file per kind."""

from jaxstab.elasticity.free import FreeHalfSpace, Padded, mirrored, padded, where_window
from jaxstab.elasticity.half_space import HalfSpace
from jaxstab.elasticity.layers import CoatedHalfSpace, Layer
from jaxstab.elasticity.solid import Field, FieldMap, Solid, apart_from_mean
from jaxstab.elasticity.spectral import Spectral, SpectralSolid

__all__ = [
    "CoatedHalfSpace",
    "Field",
    "FieldMap",
    "FreeHalfSpace",
    "HalfSpace",
    "Layer",
    "Padded",
    "Solid",
    "Spectral",
    "SpectralSolid",
    "apart_from_mean",
    "mirrored",
    "padded",
    "where_window",
]
