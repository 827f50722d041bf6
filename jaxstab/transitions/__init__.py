"""Minimum-energy paths between equilibria at one load, and the saddle points (passes) on them."""

from jaxstab.transitions.easiest_exit import easiest_exit
from jaxstab.transitions.transition import Transition, transition

__all__ = ["Transition", "easiest_exit", "transition"]
