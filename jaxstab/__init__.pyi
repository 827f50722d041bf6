from . import files, force_curves, lab, plots, potentials, references, surfaces
from .branches import (
    BarrierLaw,
    Branch,
    FirstJump,
    Turn,
    continuation,
    critical_load,
    first_jump,
)
from .branches.differentiable_limit import CriticalLoad
from .calibration import (
    Calibration,
    Calibrations,
    FitWarning,
    calibrate,
    calibrate_each,
    first_guess,
)
from .citations import cite
from .contact import Contact
from .contact.extrapolation import Extrapolation, extrapolate
from .contact.resolution import ResolutionWarning, resolved_range
from .core.grid import Grid
from .core.history import History
from .core.results import RESULTS, SolverError
from .core.rings import Rings
from .core.units import Dimension
from .equilibrium import (
    Equilibrium,
    EquilibriumSolver,
    PolonskyKeerRey,
    PreconditionedConjugateGradient,
    SaddleNewton,
    equilibrate,
)
from .equilibrium.observables import (
    Conductance,
    Leakage,
    Observable,
    Patches,
    conductance,
    leakage,
    patches,
)
from .equilibrium.posing import WindowWarning
from .equilibrium.validity import ContactWarning
from .evolution import (
    Evolution,
    Internal,
    evolve,
    growth_rate,
    lifetime,
)
from .files import load, save, to_dataset
from .loading import (
    Jump,
    Observed,
    Path,
    SealingPressure,
    follow,
    observe,
    pull_off,
    sealing_pressure,
)
from .loading.sweep import Sweep, SweepInterrupted, sweep
from .loads import (
    FarDisplacement,
    MachineWarning,
    MeanDisplacement,
    MeanGap,
    MeanPressure,
    Spring,
)
from .references.taylor_test import TaylorTest, check_derivative
from .solids import (
    Axisymmetric,
    AxisymmetricHalfSpace,
    CoatedHalfSpace,
    FreeHalfSpace,
    HalfSpace,
    Layer,
    Sheet,
    Solid,
    Spectral,
    SurfaceTension,
    Viscoelastic,
)
from .stability import (
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
from .stability.symmetry import SymmetryWarning
from .stability.verdict import VERDICTS
from .states import KINDS, PathInterrupted, PathState, States
from .studies import StudyInterrupted, study
from .surfaces import SurfaceWarning
from .transitions import (
    Detachment,
    Transition,
    detachment,
    easiest_exit,
    transition,
)

__version__: str

__all__ = [
    "KINDS",
    "RESULTS",
    "VERDICTS",
    "Axisymmetric",
    "AxisymmetricHalfSpace",
    "Barrier",
    "BarrierLaw",
    "Branch",
    "Calibration",
    "Calibrations",
    "CoatedHalfSpace",
    "Conductance",
    "ConeSolver",
    "Contact",
    "ContactWarning",
    "CriticalLoad",
    "Davidson",
    "Detachment",
    "Dimension",
    "Eigenpair",
    "Equilibrium",
    "EquilibriumSolver",
    "Evolution",
    "Extrapolation",
    "FarDisplacement",
    "FirstJump",
    "FitWarning",
    "FreeHalfSpace",
    "Grid",
    "HalfSpace",
    "History",
    "Internal",
    "Jump",
    "Layer",
    "Leakage",
    "MachineWarning",
    "MeanDisplacement",
    "MeanGap",
    "MeanPressure",
    "Minimum",
    "Observable",
    "Observed",
    "Patches",
    "Path",
    "PathInterrupted",
    "PathState",
    "PolonskyKeerRey",
    "PreconditionedConjugateGradient",
    "ProjectedLOBPCG",
    "ProximalIteration",
    "ResolutionWarning",
    "Rings",
    "SaddleNewton",
    "SealingPressure",
    "Sheet",
    "Solid",
    "SolverError",
    "SpaceSolver",
    "Spectral",
    "Spring",
    "Stability",
    "States",
    "StudyInterrupted",
    "SurfaceTension",
    "SurfaceWarning",
    "Sweep",
    "SweepInterrupted",
    "SymmetryWarning",
    "TaylorTest",
    "Transition",
    "Turn",
    "Viscoelastic",
    "WindowWarning",
    "assess_stability",
    "calibrate",
    "calibrate_each",
    "check_derivative",
    "cite",
    "conductance",
    "continuation",
    "critical_load",
    "detachment",
    "easiest_exit",
    "equilibrate",
    "evolve",
    "extrapolate",
    "files",
    "first_guess",
    "first_jump",
    "follow",
    "force_curves",
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
    "release",
    "resolved_range",
    "save",
    "sealing_pressure",
    "study",
    "surfaces",
    "sweep",
    "to_dataset",
    "transition",
]
