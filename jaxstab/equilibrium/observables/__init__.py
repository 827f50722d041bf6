"""What a contact does: its patches, what it conducts, what leaks through it."""

from jaxstab.observables.conductance import Conductance, conductance
from jaxstab.observables.leakage import Leakage, leakage
from jaxstab.observables.observe import (
    ConductanceNumbers,
    LeakageNumbers,
    Observed,
    PatchNumbers,
    observe,
)
from jaxstab.observables.patches import Patches, patches

__all__ = [
    "Conductance",
    "ConductanceNumbers",
    "Leakage",
    "LeakageNumbers",
    "Observed",
    "PatchNumbers",
    "Patches",
    "conductance",
    "leakage",
    "observe",
    "patches",
]
