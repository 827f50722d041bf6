"""Equilibrium and stability of adhesive rough contacts, on JAX.

It implements V. Rey and J. Bleyer, *Stability analysis of rough surfaces in adhesive normal
contact*, whose equation numbers the documentation quotes.
"""

from importlib.metadata import version

from jaxstab import files, plots, potentials, surfaces
from jaxstab.calibration import Calibration, calibrate
from jaxstab.contact import Contact
from jaxstab.elasticity import HalfSpace, Spectral
from jaxstab.equilibrium import (
    Equilibrium,
    PolonskyKeerRey,
    PreconditionedConjugateGradient,
    SaddleNewton,
    equilibrate,
)
from jaxstab.folds import CriticalLoad, critical_load
from jaxstab.grid import Grid
from jaxstab.loads import MeanDisplacement, MeanGap, MeanPressure
from jaxstab.resolution import ResolutionWarning
from jaxstab.results import RESULTS, VERDICTS, SolverError
from jaxstab.stability import (
    LOBPCG,
    Barrier,
    Eigenpair,
    ProjectedLOBPCG,
    ProximalIteration,
    Stability,
    assess_stability,
    lowest_modes,
    release,
)
from jaxstab.sweeps import Sweep, SweepInterrupted, sweep

__version__ = version("jaxstab")

__all__ = [
    "LOBPCG",
    "RESULTS",
    "VERDICTS",
    "Barrier",
    "Calibration",
    "Contact",
    "CriticalLoad",
    "Eigenpair",
    "Equilibrium",
    "Grid",
    "HalfSpace",
    "MeanDisplacement",
    "MeanGap",
    "MeanPressure",
    "PolonskyKeerRey",
    "PreconditionedConjugateGradient",
    "ProjectedLOBPCG",
    "ProximalIteration",
    "ResolutionWarning",
    "SaddleNewton",
    "SolverError",
    "Spectral",
    "Stability",
    "Sweep",
    "SweepInterrupted",
    "assess_stability",
    "calibrate",
    "critical_load",
    "equilibrate",
    "files",
    "lowest_modes",
    "plots",
    "potentials",
    "release",
    "surfaces",
    "sweep",
]
