"""Equilibria of a contact under a load: one file per algorithm, and `equilibrate`."""

from jaxstab.equilibrium.equilibrate import Equilibrium, equilibrate
from jaxstab.equilibrium.polonsky_keer_rey import PolonskyKeerRey
from jaxstab.equilibrium.preconditioned import PreconditionedConjugateGradient

__all__ = ["Equilibrium", "PolonskyKeerRey", "PreconditionedConjugateGradient", "equilibrate"]
