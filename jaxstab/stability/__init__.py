"""Stability of equilibria: cones, eigensolvers, and `assess_stability`."""

from jaxstab.stability.assess import Eigenpair, Stability, assess_stability
from jaxstab.stability.proximal import ProximalIteration

__all__ = ["Eigenpair", "ProximalIteration", "Stability", "assess_stability"]
