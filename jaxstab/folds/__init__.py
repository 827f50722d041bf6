"""Folds, where stable branches of equilibria end."""

from jaxstab.folds.critical_load import CriticalLoad, critical_load

__all__ = ["CriticalLoad", "critical_load"]
