"""The classes of the results that functions of `jaxstab` return."""

from jaxstab.branches import BarrierLaw, Branch, FirstJump, Turn
from jaxstab.branches.differentiable_limit import CriticalLoad
from jaxstab.calibration import Calibration
from jaxstab.contact.extrapolation import Extrapolation
from jaxstab.core.history import History
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.observables import Conductance, Leakage, Observable, Patches
from jaxstab.evolution import Evolution, Memory
from jaxstab.loading import Jump, Path, SealingPressure
from jaxstab.loading.sweep import Sweep
from jaxstab.observation import Observed
from jaxstab.references.taylor_test import TaylorTest
from jaxstab.stability import Barrier, Eigenpair, Stability
from jaxstab.states import ENDS, KINDS, PathState, States
from jaxstab.transitions import Detachment, Transition

__all__ = [
    "ENDS",
    "KINDS",
    "Barrier",
    "BarrierLaw",
    "Branch",
    "Calibration",
    "Conductance",
    "CriticalLoad",
    "Detachment",
    "Eigenpair",
    "Equilibrium",
    "Evolution",
    "Extrapolation",
    "FirstJump",
    "History",
    "Jump",
    "Leakage",
    "Memory",
    "Observable",
    "Observed",
    "Patches",
    "Path",
    "PathState",
    "SealingPressure",
    "Stability",
    "States",
    "Sweep",
    "TaylorTest",
    "Transition",
    "Turn",
]


def __dir__() -> list[str]:
    return __all__
