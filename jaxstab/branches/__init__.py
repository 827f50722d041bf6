"""Branches of equilibria, stable or not: the curve, its folds and active-set changes, its ends."""

from jaxstab.branches.barrier_law import BarrierLaw
from jaxstab.branches.branch import Branch, Turn
from jaxstab.branches.continuation import continuation
from jaxstab.branches.critical_load import critical_load
from jaxstab.branches.differentiable_limit import CriticalLoad
from jaxstab.branches.first_jump import FirstJump, first_jump

__all__ = [
    "BarrierLaw",
    "Branch",
    "CriticalLoad",
    "FirstJump",
    "Turn",
    "continuation",
    "critical_load",
    "first_jump",
]
