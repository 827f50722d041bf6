"""Equilibrium and stability of adhesive rough contacts, on JAX.

It implements V. Rey and J. Bleyer, *Stability analysis of rough surfaces in adhesive normal
contact*, whose equation numbers the documentation quotes.
"""

from importlib.metadata import version

from jaxstab import files, plots, potentials, surfaces
from jaxstab.contact import Contact, MeanDisplacement, MeanGap
from jaxstab.elasticity import HalfSpace, Spectral
from jaxstab.equilibrium import Equilibrium, PolonskyKeerRey, equilibrate
from jaxstab.grid import Grid
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
    "PolonskyKeerRey",
    "ProximalIteration",
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
