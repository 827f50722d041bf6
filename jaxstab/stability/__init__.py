"""Stability of equilibria: cones, eigensolvers, and `assess_stability`."""

from jaxstab.stability.assess import assess_stability
from jaxstab.stability.davidson import Davidson
from jaxstab.stability.eigenpairs import Eigenpair
from jaxstab.stability.margins import Barrier
from jaxstab.stability.modes import lowest_modes
from jaxstab.stability.projected import ProjectedLOBPCG
from jaxstab.stability.proximal import ProximalIteration
from jaxstab.stability.release import release
from jaxstab.stability.solver import ConeSolver, SpaceSolver
from jaxstab.stability.verdict import Stability

__all__ = [
    "Barrier",
    "ConeSolver",
    "Davidson",
    "Eigenpair",
    "ProjectedLOBPCG",
    "ProximalIteration",
    "SpaceSolver",
    "Stability",
    "assess_stability",
    "lowest_modes",
    "release",
]
