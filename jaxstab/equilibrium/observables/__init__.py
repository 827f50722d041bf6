"""Observables of a state: patches, conductance, leakage, a file for each."""

from jaxstab.equilibrium.observables.conductance import Conductance, conductance
from jaxstab.equilibrium.observables.leakage import Leakage, leakage
from jaxstab.equilibrium.observables.observable import Observable
from jaxstab.equilibrium.observables.patches import Patches, patches

__all__ = ["Conductance", "Leakage", "Observable", "Patches", "conductance", "leakage", "patches"]
