"""What a contact does: its patches, what it conducts, what leaks through it."""

from jaxstab.observables.conductance import Conductance, conductance
from jaxstab.observables.leakage import Leakage, leakage
from jaxstab.observables.patches import Patches, patches

__all__ = ["Conductance", "Leakage", "Patches", "conductance", "leakage", "patches"]
