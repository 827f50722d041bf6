"""Fits to a soft sphere on a plate and to two elastic bodies, whose laws are solved here."""

import numpy as np
import pytest
from scipy.optimize import brentq
from synthetic_curves import MODULUS, RADIUS, hertz, maugis_with_approach, recorded

import jaxstab as js

NU = 0.3


def within_three_errors(fit, modulus):
    return abs(fit.youngs_modulus - modulus) < 3 * fit.errors.youngs_modulus < 0.1 * modulus


@pytest.mark.parametrize("tip_radius", [30.0, np.inf])
def test_a_sphere_on_a_plate_deforms_at_both_contacts(tip_radius):
    sample_radius = 50.0
    upper = 1 / (1 / tip_radius + 1 / sample_radius)

    def total(force):
        depths = [(3 * force / (4 * MODULUS * np.sqrt(r))) ** (2 / 3) for r in (upper, 50.0)]
        return sum(depths)

    indentation = np.linspace(0, 8, 2000)
    force = np.array([brentq(lambda f, d=d: total(f) - d, 0, 1e3) for d in indentation])
    tip = js.lab.SphereOnPlate(tip_radius * 1e-9, sample_radius * 1e-9)
    fit = js.lab.fit_curve(recorded((indentation, force), 3), tip, NU)
    assert within_three_errors(fit, MODULUS * 1e9 * (1 - NU**2))
    again = js.lab.ForceCurveFit.from_dataset(fit.to_dataset())
    assert again.tip == tip


def test_an_elastic_tip_leaves_the_modulus_of_the_sample():
    # E* = 0.5 GPa of both, the tip alone has 2 GPa / (1 - 0.25^2).
    tip = js.lab.ElasticTip(js.lab.Paraboloid(RADIUS * 1e-9), 2e9, 0.25)
    own = 1 / MODULUS - (1 - 0.25**2) / 2
    fit = js.lab.fit_curve(recorded(hertz(), 3), tip, NU)
    assert within_three_errors(fit, (1 - NU**2) / own * 1e9)
    assert abs(fit.contact_modulus - MODULUS * 1e9) < 0.02 * MODULUS * 1e9
    rigid = js.lab.fit_curve(recorded(hertz(), 3), js.lab.Paraboloid(RADIUS * 1e-9), NU)
    # The relative error grows as the sample's part of the compliance falls.
    ratio = fit.errors.youngs_modulus / fit.youngs_modulus
    ratio /= rigid.errors.youngs_modulus / rigid.youngs_modulus
    assert ratio == pytest.approx(1 / (MODULUS * own), rel=0.02)
    again = js.lab.ForceCurveFit.from_dataset(fit.to_dataset())
    assert again.tip == tip
    soft = js.lab.ElasticTip(js.lab.Paraboloid(RADIUS * 1e-9), 0.3e9, 0.25)
    with pytest.raises(ValueError, match="The contact is stiffer"):
        js.lab.fit_curve(recorded(hertz(), 3), soft, NU)


def test_two_spheres_are_one_paraboloid():
    tip = js.lab.TwoSpheres(2 * RADIUS * 1e-9, 2 * RADIUS * 1e-9)
    one = js.lab.fit_curve(recorded(hertz(), 3), tip, 0.0)
    assert within_three_errors(one, MODULUS * 1e9)


def test_bodies_that_have_no_closed_form_are_refused():
    plate = js.lab.SphereOnPlate(np.inf, 50e-9)
    with pytest.raises(ValueError, match="shows an attraction"):
        js.lab.fit_curve(recorded(maugis_with_approach(1.0), 2), plate, 0.0, "retraction")
    with pytest.raises(ValueError, match="must be rigid"):
        js.lab.ElasticTip(plate, 1e9, 0.3)
    with pytest.raises(TypeError, match="The shape is"):
        js.lab.ElasticTip(js.lab.FlatPunch(1e-6), 1e9, 0.3)
    with pytest.raises(ValueError, match="give E > 0"):
        js.lab.ElasticTip(js.lab.Paraboloid(1e-6), -1e9, 0.3)
