"""Closed-form solutions that the numerical ones are held against; NumPy only."""

from jaxstab.references import hertz, westergaard

__all__ = ["hertz", "westergaard"]
