"""The errors that searches raise, and the warnings that they give."""

from jaxstab.calibration import FitWarning
from jaxstab.contact.resolution import ResolutionWarning
from jaxstab.core.results import SolverError
from jaxstab.equilibrium.posing import WindowWarning
from jaxstab.equilibrium.validity import ContactWarning
from jaxstab.loading.sweep import SweepInterrupted
from jaxstab.loads import MachineWarning
from jaxstab.solids import RelaxationWarning
from jaxstab.stability.symmetry import SymmetryWarning
from jaxstab.states import PathInterrupted
from jaxstab.studies import StudyInterrupted
from jaxstab.surfaces import SurfaceWarning

__all__ = [
    "ContactWarning",
    "FitWarning",
    "MachineWarning",
    "PathInterrupted",
    "RelaxationWarning",
    "ResolutionWarning",
    "SolverError",
    "StudyInterrupted",
    "SurfaceWarning",
    "SweepInterrupted",
    "SymmetryWarning",
    "WindowWarning",
]


def __dir__() -> list[str]:
    return __all__
