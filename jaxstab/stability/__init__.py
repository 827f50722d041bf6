"""Stability of equilibria: cones, eigensolvers, and `assess_stability`."""

from jaxstab.stability.assess import assess_stability
from jaxstab.stability.barrier import Barrier
from jaxstab.stability.eigenpair import Eigenpair, Minimum
from jaxstab.stability.lowest_modes import lowest_modes
from jaxstab.stability.perturb import relax_along
from jaxstab.stability.solvers.base import ConeSolver, SpaceSolver
from jaxstab.stability.solvers.cone_lobpcg import ProjectedLOBPCG
from jaxstab.stability.solvers.davidson import Davidson
from jaxstab.stability.solvers.proximal import ProximalIteration
from jaxstab.stability.verdict import Stability

__all__ = [
    "Barrier",
    "ConeSolver",
    "Davidson",
    "Eigenpair",
    "Minimum",
    "ProjectedLOBPCG",
    "ProximalIteration",
    "SpaceSolver",
    "Stability",
    "assess_stability",
    "lowest_modes",
    "relax_along",
]
