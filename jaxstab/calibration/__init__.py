"""The fit of an interaction law and a modulus to a measured curve."""

from jaxstab.calibration.advice import FitWarning
from jaxstab.calibration.calibrate import calibrate
from jaxstab.calibration.calibrate_each import Calibrations, calibrate_each
from jaxstab.calibration.first_guess import first_guess
from jaxstab.calibration.result import Calibration, LossProfile

__all__ = [
    "Calibration",
    "Calibrations",
    "FitWarning",
    "LossProfile",
    "calibrate",
    "calibrate_each",
    "first_guess",
]
