"""Loads: their interface, and one file per kind.

A load prescribes the mean of the gap, or presses with a mean pressure p0 that may depend on it.
"""

from jaxstab.loads.held_gap import GapControl, MeanDisplacement, MeanGap
from jaxstab.loads.load import Control, Load, require_load, require_loads, require_same_machine
from jaxstab.loads.pressure import MeanPressure, PressingControl, PressureControl
from jaxstab.loads.spring import (
    FarDisplacement,
    MachineWarning,
    Spring,
    SpringControl,
)

__all__ = [
    "Control",
    "FarDisplacement",
    "GapControl",
    "Load",
    "MachineWarning",
    "MeanDisplacement",
    "MeanGap",
    "MeanPressure",
    "PressingControl",
    "PressureControl",
    "Spring",
    "SpringControl",
    "require_load",
    "require_loads",
    "require_same_machine",
]
