from . import (
    exceptions,
    lab,
    plots,
    potentials,
    references,
    results,
    solids,
    solvers,
    surfaces,
    units,
)
from .branches import continuation, critical_load, first_jump
from .calibration import calibrate
from .citations import cite
from .contact import Contact
from .contact.extrapolation import extrapolate
from .contact.resolution import resolved_range
from .core.grid import Grid
from .core.results import RESULTS
from .core.rings import Rings
from .core.units import Dimension
from .equilibrium import equilibrate
from .equilibrium.observables import conductance, leakage, patches
from .evolution import evolve, growth_rate, lifetime
from .files import load, save, to_dataset
from .loading import follow, pull_off, sealing_pressure
from .loading.sweep import sweep
from .loads import FarDisplacement, MeanDisplacement, MeanGap, MeanPressure, Spring
from .observation import observe
from .references.taylor_test import check_derivative
from .solids import (
    CoatedHalfSpace,
    FreeHalfSpace,
    HalfSpace,
    Layer,
    Sheet,
    SurfaceTension,
    Viscoelastic,
)
from .stability import ProximalIteration, assess_stability, lowest_modes, relax_along
from .stability.verdict import VERDICTS
from .studies import study
from .transitions import detachment, easiest_exit, transition

__version__: str

__all__ = [
    "RESULTS",
    "VERDICTS",
    "CoatedHalfSpace",
    "Contact",
    "Dimension",
    "FarDisplacement",
    "FreeHalfSpace",
    "Grid",
    "HalfSpace",
    "Layer",
    "MeanDisplacement",
    "MeanGap",
    "MeanPressure",
    "ProximalIteration",
    "Rings",
    "Sheet",
    "Spring",
    "SurfaceTension",
    "Viscoelastic",
    "assess_stability",
    "calibrate",
    "check_derivative",
    "cite",
    "conductance",
    "continuation",
    "critical_load",
    "detachment",
    "easiest_exit",
    "equilibrate",
    "evolve",
    "exceptions",
    "extrapolate",
    "first_jump",
    "follow",
    "growth_rate",
    "lab",
    "leakage",
    "lifetime",
    "load",
    "lowest_modes",
    "observe",
    "patches",
    "plots",
    "potentials",
    "pull_off",
    "references",
    "relax_along",
    "resolved_range",
    "results",
    "save",
    "sealing_pressure",
    "solids",
    "solvers",
    "study",
    "surfaces",
    "sweep",
    "to_dataset",
    "transition",
    "units",
]
