from . import force_curves
from .contact_points import ContactPoints, contact_points
from .fit import FitErrors, ForceCurveFit
from .fit_curve import fit_curve
from .fit_each import Fits, fit_each
from .modulus_over_depth import ModulusOverDepth, modulus_over_depth
from .report import Wording, report
from .tips import Cone, FlatPunch, Paraboloid, Pyramid, Sphere, Tip

__all__ = [
    "Cone",
    "ContactPoints",
    "FitErrors",
    "Fits",
    "FlatPunch",
    "ForceCurveFit",
    "ModulusOverDepth",
    "Paraboloid",
    "Pyramid",
    "Sphere",
    "Tip",
    "Wording",
    "contact_points",
    "fit_curve",
    "fit_each",
    "force_curves",
    "modulus_over_depth",
    "report",
]
