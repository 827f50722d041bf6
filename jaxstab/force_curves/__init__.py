"""Measured force curves: from files of instruments, in units, with their baseline removed.

`read` returns a `ForceCurve`, or `ForceCurves` for a file with several. Forces are positive in
compression; heights and tip positions grow away from the sample.
"""

from jaxstab.force_curves.curves import ForceCurves
from jaxstab.force_curves.force_curve import ForceCurve, ForceCurveWarning, Segment
from jaxstab.force_curves.read import read

__all__ = ["ForceCurve", "ForceCurveWarning", "ForceCurves", "Segment", "read"]


def __dir__() -> list[str]:
    return __all__
