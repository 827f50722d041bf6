"""Paths: what a contact goes through under a programme of loads, and where it ends."""

from jaxstab.paths.critical_load import critical_load
from jaxstab.paths.follow import PathInterrupted, follow
from jaxstab.paths.path import Jump, Path, States
from jaxstab.paths.pull_off import pull_off

__all__ = ["Jump", "Path", "PathInterrupted", "States", "critical_load", "follow", "pull_off"]
