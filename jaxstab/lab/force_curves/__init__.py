"""Measured force curves: from files of instruments, in units, with their baseline removed.

`read` returns a `ForceCurve`, or `ForceCurves` for a file with several. Forces are positive in
compression; heights and tip positions grow away from the sample.
"""

from jaxstab.lab.force_curves.baseline import Baseline
from jaxstab.lab.force_curves.correction import Correction
from jaxstab.lab.force_curves.curves import ForceCurves
from jaxstab.lab.force_curves.force_curve import ForceCurve, ForceCurveWarning
from jaxstab.lab.force_curves.means import Means, means
from jaxstab.lab.force_curves.read import read
from jaxstab.lab.force_curves.segment import Segment

__all__ = [
    "Baseline",
    "Correction",
    "ForceCurve",
    "ForceCurveWarning",
    "ForceCurves",
    "Means",
    "Segment",
    "means",
    "read",
]


def __dir__() -> list[str]:
    return __all__
