from .fit import FitErrors, ForceCurveFit
from .fit_curve import fit_curve
from .report import Wording, report
from .tips import Cone, FlatPunch, Paraboloid, Pyramid, Sphere, Tip

__all__ = [
    "Cone",
    "FitErrors",
    "FlatPunch",
    "ForceCurveFit",
    "Paraboloid",
    "Pyramid",
    "Sphere",
    "Tip",
    "Wording",
    "fit_curve",
    "report",
]
