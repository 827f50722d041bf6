"""Measured force curves: from files of instruments, in units, with their baseline removed.

`read` returns a `ForceCurve`, or `ForceCurves` for a file with several. Forces are positive in
compression; heights and tip positions grow away from the sample.
"""

from jaxstab.force_curves.correction import Baseline, Correction
from jaxstab.force_curves.curves import ForceCurves
from jaxstab.force_curves.force_curve import ForceCurve
from jaxstab.force_curves.force_curve import ForceCurveWarning as ForceCurveWarning
from jaxstab.force_curves.read import read
from jaxstab.force_curves.segment import Segment

__all__ = [
    "Baseline",
    "Correction",
    "ForceCurve",
    "ForceCurves",
    "Segment",
    "read",
]


def __dir__() -> list[str]:
    return __all__
