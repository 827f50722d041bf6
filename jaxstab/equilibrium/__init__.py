"""Equilibria of a contact under a load: one file per algorithm, and `equilibrate`."""

from jaxstab.equilibrium.equilibrate import equilibrate
from jaxstab.equilibrium.equilibrium import Equilibrium
from jaxstab.equilibrium.solvers.base import EquilibriumSolver
from jaxstab.equilibrium.solvers.conjugate_gradients import PreconditionedConjugateGradient
from jaxstab.equilibrium.solvers.polonsky_keer_rey import PolonskyKeerRey
from jaxstab.equilibrium.solvers.saddle_newton import SaddleNewton

__all__ = [
    "Equilibrium",
    "EquilibriumSolver",
    "PolonskyKeerRey",
    "PreconditionedConjugateGradient",
    "SaddleNewton",
    "equilibrate",
]
