"""States in order, as branches and load paths hold them, and the kinds of events between them."""

from jaxstab.states.kinds import ENDS, KINDS
from jaxstab.states.sequence import PathInterrupted, PathState, States

__all__ = ["ENDS", "KINDS", "PathInterrupted", "PathState", "States"]
