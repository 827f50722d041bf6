"""The fit of an interaction law and a modulus to a measured curve."""

from jaxstab.calibration.advice import FitWarning
from jaxstab.calibration.calibrate import calibrate
from jaxstab.calibration.result import Calibration, LossProfile

__all__ = ["Calibration", "FitWarning", "LossProfile", "calibrate"]
