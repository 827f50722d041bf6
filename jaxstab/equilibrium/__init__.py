"""Equilibria of a contact under a load: one file per algorithm, and `equilibrate`."""

from jaxstab.equilibrium.equilibrate import Equilibrium, equilibrate
from jaxstab.equilibrium.polonsky_keer_rey import PolonskyKeerRey
from jaxstab.equilibrium.preconditioned import PreconditionedConjugateGradient
from jaxstab.equilibrium.saddle_newton import SaddleNewton

__all__ = [
    "Equilibrium",
    "PolonskyKeerRey",
    "PreconditionedConjugateGradient",
    "SaddleNewton",
    "equilibrate",
]
