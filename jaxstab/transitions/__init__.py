"""Minimum-energy paths between equilibria at one load, and the saddle points (passes) on them."""

from jaxstab.transitions.detachment import Detachment, detachment
from jaxstab.transitions.easiest_exit import easiest_exit
from jaxstab.transitions.result import Transition
from jaxstab.transitions.transition import transition

__all__ = ["Detachment", "Transition", "detachment", "easiest_exit", "transition"]
