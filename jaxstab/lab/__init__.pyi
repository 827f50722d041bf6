from . import force_curves
from .contact_points import ContactPoints, contact_points
from .fit import FitErrors, ForceCurveFit
from .fit_curve import fit_curve
from .fit_each import Fits, fit_each
from .fit_viscoelastic import fit_viscoelastic
from .modulus_over_depth import ModulusOverDepth, modulus_over_depth
from .report import Wording, report
from .tips import (
    Cone,
    ElasticTip,
    FlatPunch,
    Paraboloid,
    Pyramid,
    Sphere,
    SphereOnPlate,
    Tip,
    TwoSpheres,
)
from .viscoelastic_fit import ViscoelasticErrors, ViscoelasticFit

__all__ = [
    "Cone",
    "ContactPoints",
    "ElasticTip",
    "FitErrors",
    "Fits",
    "FlatPunch",
    "ForceCurveFit",
    "ModulusOverDepth",
    "Paraboloid",
    "Pyramid",
    "Sphere",
    "SphereOnPlate",
    "Tip",
    "TwoSpheres",
    "ViscoelasticErrors",
    "ViscoelasticFit",
    "Wording",
    "contact_points",
    "fit_curve",
    "fit_each",
    "fit_viscoelastic",
    "force_curves",
    "modulus_over_depth",
    "report",
]
