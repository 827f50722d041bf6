"""Closed-form solutions for comparison with numerical ones, in NumPy."""

from jaxstab.references import (
    elastic_plastic,
    guduru,
    hertz,
    jkr,
    johnson,
    materials,
    maugis,
    persson_brener,
    westergaard,
)
from jaxstab.references.adhesion_regime import AdhesionRegime, regime

__all__ = [
    "AdhesionRegime",
    "elastic_plastic",
    "guduru",
    "hertz",
    "jkr",
    "johnson",
    "materials",
    "maugis",
    "persson_brener",
    "regime",
    "westergaard",
]


def __dir__() -> list[str]:
    return __all__
