"""Closed-form solutions for comparison with numerical ones, in NumPy."""

from jaxstab.references import guduru, hertz, jkr, johnson, maugis, persson_brener, westergaard

__all__ = ["guduru", "hertz", "jkr", "johnson", "maugis", "persson_brener", "westergaard"]


def __dir__() -> list[str]:
    return __all__
