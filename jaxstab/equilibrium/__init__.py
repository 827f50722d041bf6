"""Equilibria of a contact under a load: one file per algorithm, and `equilibrate`."""

from jaxstab.equilibrium.equilibrate import equilibrate
from jaxstab.equilibrium.polonsky_keer_rey import PolonskyKeerRey
from jaxstab.equilibrium.preconditioned import PreconditionedConjugateGradient
from jaxstab.equilibrium.saddle_newton import SaddleNewton
from jaxstab.equilibrium.solver import EquilibriumSolver
from jaxstab.equilibrium.state import Equilibrium

__all__ = [
    "Equilibrium",
    "EquilibriumSolver",
    "PolonskyKeerRey",
    "PreconditionedConjugateGradient",
    "SaddleNewton",
    "equilibrate",
]
