"""Contacts of viscoelastic solids in time."""

from jaxstab.evolution.evolution import Evolution, Memory
from jaxstab.evolution.evolve import evolve
from jaxstab.evolution.growth_rate import growth_rate
from jaxstab.evolution.lifetime import lifetime

__all__ = ["Evolution", "Memory", "evolve", "growth_rate", "lifetime"]
