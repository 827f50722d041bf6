"""Equilibrium and stability of adhesive rough contacts, on JAX.

It implements V. Rey and J. Bleyer, *Stability analysis of rough surfaces in adhesive normal
contact*, whose equation numbers the documentation quotes.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from jaxstab import files, potentials, surfaces
from jaxstab.calibration import Calibration, calibrate
from jaxstab.citations import cite
from jaxstab.contact import Contact
from jaxstab.contact.resolution import ResolutionWarning
from jaxstab.core.cache import keep_programs
from jaxstab.core.grid import Grid
from jaxstab.core.history import History
from jaxstab.core.results import RESULTS, SolverError
from jaxstab.equilibrium import (
    Equilibrium,
    EquilibriumSolver,
    PolonskyKeerRey,
    PreconditionedConjugateGradient,
    SaddleNewton,
    equilibrate,
)
from jaxstab.equilibrium.observables import (
    Conductance,
    Leakage,
    Patches,
    conductance,
    leakage,
    patches,
)
from jaxstab.equilibrium.window import WindowWarning
from jaxstab.files import load, save, to_dataset
from jaxstab.loads import (
    FarDisplacement,
    MachineWarning,
    MeanDisplacement,
    MeanGap,
    MeanPressure,
    Spring,
)
from jaxstab.paths import (
    ENDS,
    TURNS,
    BarrierLaw,
    Branch,
    ConductanceNumbers,
    Jump,
    LeakageNumbers,
    Observed,
    PatchNumbers,
    Path,
    PathInterrupted,
    States,
    Transition,
    Turn,
    continuation,
    critical_load,
    easiest_exit,
    follow,
    observe,
    pull_off,
    transition,
)
from jaxstab.paths.branch_end.critical_load import CriticalLoad
from jaxstab.paths.branch_end.kind import KINDS
from jaxstab.paths.sweep import Sweep, SweepInterrupted, sweep
from jaxstab.solids import (
    CoatedHalfSpace,
    FreeHalfSpace,
    HalfSpace,
    Layer,
    Solid,
    Spectral,
)
from jaxstab.stability import (
    Barrier,
    ConeSolver,
    Davidson,
    Eigenpair,
    Minimum,
    ProjectedLOBPCG,
    ProximalIteration,
    SpaceSolver,
    Stability,
    assess_stability,
    lowest_modes,
    release,
)
from jaxstab.stability.verdict import VERDICTS
from jaxstab.studies import StudyInterrupted, cases, study
from jaxstab.surfaces import SurfaceWarning

if TYPE_CHECKING:
    from jaxstab import plots, references

    __version__: str

__all__ = [
    "ENDS",
    "KINDS",
    "RESULTS",
    "TURNS",
    "VERDICTS",
    "Barrier",
    "BarrierLaw",
    "Branch",
    "Calibration",
    "CoatedHalfSpace",
    "Conductance",
    "ConductanceNumbers",
    "ConeSolver",
    "Contact",
    "CriticalLoad",
    "Davidson",
    "Eigenpair",
    "Equilibrium",
    "EquilibriumSolver",
    "FarDisplacement",
    "FreeHalfSpace",
    "Grid",
    "HalfSpace",
    "History",
    "Jump",
    "Layer",
    "Leakage",
    "LeakageNumbers",
    "MachineWarning",
    "MeanDisplacement",
    "MeanGap",
    "MeanPressure",
    "Minimum",
    "Observed",
    "PatchNumbers",
    "Patches",
    "Path",
    "PathInterrupted",
    "PolonskyKeerRey",
    "PreconditionedConjugateGradient",
    "ProjectedLOBPCG",
    "ProximalIteration",
    "ResolutionWarning",
    "SaddleNewton",
    "Solid",
    "SolverError",
    "SpaceSolver",
    "Spectral",
    "Spring",
    "Stability",
    "States",
    "StudyInterrupted",
    "SurfaceWarning",
    "Sweep",
    "SweepInterrupted",
    "Transition",
    "Turn",
    "WindowWarning",
    "assess_stability",
    "calibrate",
    "cases",
    "cite",
    "conductance",
    "continuation",
    "critical_load",
    "easiest_exit",
    "equilibrate",
    "files",
    "follow",
    "leakage",
    "load",
    "lowest_modes",
    "observe",
    "patches",
    "plots",
    "potentials",
    "pull_off",
    "references",
    "release",
    "save",
    "study",
    "surfaces",
    "sweep",
    "to_dataset",
    "transition",
]


keep_programs()


def __getattr__(name: str) -> Any:
    # Late, since Matplotlib takes longer to import than all the rest.
    if name in ("plots", "references"):
        return import_module(f"jaxstab.{name}")
    if name == "__version__":
        return import_module("importlib.metadata").version("jaxstab")
    raise AttributeError(f"module 'jaxstab' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
