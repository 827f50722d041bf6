"""Closed-form solutions that the numerical ones are held against; NumPy only."""

from jaxstab.references import (
    guduru,
    hertz,
    jkr,
    johnson,
    maugis,
    persson_brener,
    westergaard,
)

__all__ = ["guduru", "hertz", "jkr", "johnson", "maugis", "persson_brener", "westergaard"]


def __dir__() -> list[str]:
    return __all__
