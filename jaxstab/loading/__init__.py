"""Loading: the states of a contact along a load path, its jumps, and its pull-off."""

from jaxstab.loading.follow import follow
from jaxstab.loading.observe import Observed, observe
from jaxstab.loading.path import Jump, Path
from jaxstab.loading.pull_off import pull_off

__all__ = [
    "Jump",
    "Observed",
    "Path",
    "follow",
    "observe",
    "pull_off",
]
