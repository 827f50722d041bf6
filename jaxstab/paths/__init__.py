"""Paths: what a contact goes through under a programme of loads, and where it ends."""

from jaxstab.paths.bracketed import critical_load
from jaxstab.paths.follow import follow
from jaxstab.paths.path import Jump, Path, States

__all__ = ["Jump", "Path", "States", "critical_load", "follow"]
