"""Observables beside the states of paths, branches, sweeps and evolutions."""

from jaxstab.observation.observe import Observed, observe

__all__ = ["Observed", "observe"]
