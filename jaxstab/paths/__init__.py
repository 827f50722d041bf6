"""Paths: what a contact goes through under a programme of loads."""

from jaxstab.paths.follow import follow
from jaxstab.paths.path import KINDS, Jump, Path, States

__all__ = ["KINDS", "Jump", "Path", "States", "follow"]
