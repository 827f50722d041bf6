"""Loading: the states of a contact along a load path, its jumps, and its pull-off."""

from jaxstab.loading.follow import follow
from jaxstab.loading.path import Jump, Path
from jaxstab.loading.pull_off import pull_off
from jaxstab.loading.sealing_pressure import SealingPressure, sealing_pressure

__all__ = [
    "Jump",
    "Path",
    "SealingPressure",
    "follow",
    "pull_off",
    "sealing_pressure",
]
