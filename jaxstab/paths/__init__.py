"""Paths: the states of a contact along a load path, and the ends of its branches."""

from jaxstab.paths.barrier_law import BarrierLaw
from jaxstab.paths.barriers.easiest_exit import easiest_exit
from jaxstab.paths.barriers.transition import Transition, transition
from jaxstab.paths.critical_load import critical_load
from jaxstab.paths.curve.continuation import continuation
from jaxstab.paths.evolution.evolution import Evolution, Internal
from jaxstab.paths.evolution.evolve import evolve
from jaxstab.paths.evolution.growth_rate import growth_rate
from jaxstab.paths.evolution.lifetime import lifetime
from jaxstab.paths.follow import follow
from jaxstab.paths.kinds import KINDS
from jaxstab.paths.observe import Observed, observe
from jaxstab.paths.path import Branch, Jump, Path, PathInterrupted, PathState, States, Turn
from jaxstab.paths.pull_off import pull_off

__all__ = [
    "KINDS",
    "BarrierLaw",
    "Branch",
    "Evolution",
    "Internal",
    "Jump",
    "Observed",
    "Path",
    "PathInterrupted",
    "PathState",
    "States",
    "Transition",
    "Turn",
    "continuation",
    "critical_load",
    "easiest_exit",
    "evolve",
    "follow",
    "growth_rate",
    "lifetime",
    "observe",
    "pull_off",
    "transition",
]
