"""Equilibrium and stability of adhesive rough contacts, on JAX.

It implements V. Rey and J. Bleyer, *Stability analysis of rough surfaces in adhesive normal
contact*, whose equation numbers the documentation quotes.
"""

from importlib.metadata import version

from jaxstab import files, plots, potentials, surfaces
from jaxstab.contact import Contact
from jaxstab.elasticity import HalfSpace, Spectral
from jaxstab.equilibrium import (
    Equilibrium,
    PolonskyKeerRey,
    PreconditionedConjugateGradient,
    equilibrate,
)
from jaxstab.grid import Grid
from jaxstab.loads import MeanDisplacement, MeanGap, MeanPressure
from jaxstab.resolution import ResolutionWarning
from jaxstab.results import RESULTS, VERDICTS, SolverError
from jaxstab.stability import Eigenpair, ProximalIteration, Stability, assess_stability
from jaxstab.sweeps import Sweep, sweep

__version__ = version("jaxstab")

__all__ = [
    "RESULTS",
    "VERDICTS",
    "Contact",
    "Eigenpair",
    "Equilibrium",
    "Grid",
    "HalfSpace",
    "MeanDisplacement",
    "MeanGap",
    "MeanPressure",
    "PolonskyKeerRey",
    "PreconditionedConjugateGradient",
    "ProximalIteration",
    "ResolutionWarning",
    "SolverError",
    "Spectral",
    "Stability",
    "Sweep",
    "assess_stability",
    "equilibrate",
    "files",
    "plots",
    "potentials",
    "surfaces",
    "sweep",
]
