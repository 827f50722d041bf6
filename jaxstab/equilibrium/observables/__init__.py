"""What a contact does in a state: its patches, what it conducts, what leaks through it."""

from jaxstab.equilibrium.observables.conductance import Conductance, conductance
from jaxstab.equilibrium.observables.leakage import Leakage, leakage
from jaxstab.equilibrium.observables.patches import Patches, patches

__all__ = ["Conductance", "Leakage", "Patches", "conductance", "leakage", "patches"]
