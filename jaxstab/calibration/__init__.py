"""The fit of an interaction law and a modulus to a measured curve."""

from jaxstab.calibration.calibrate import Calibration, calibrate

__all__ = ["Calibration", "calibrate"]
