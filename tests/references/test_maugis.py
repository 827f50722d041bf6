"""Maugis: against quadrature of his pressure, the limits of JKR and DMT, and known numbers."""

import numpy as np
import pytest
from closed_forms import SPHERE, STIFFNESSES, UNITS, derivative, strength
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import brentq

from jaxstab.references import jkr, maugis


def dugdale(a, tension):
    """Return F, d and c of Maugis' sphere by quadrature of the transform of its pressure.

    It is E* (d - x^2 / R) in contact and -2 s sqrt(c^2 - x^2) around it, without a step between.
    """
    radius, contact_modulus, work = SPHERE

    def displacement(c):
        return a**2 / radius - 2 * tension * np.sqrt(c**2 - a**2) / contact_modulus

    def excess(c):
        def inner(phi):
            return displacement(c) - (c * np.sin(phi)) ** 2 / radius

        lift = quad(inner, 0, np.arcsin(a / c), epsabs=1e-14)[0]
        lift = 2 / np.pi * (lift - 2 * tension * (c - a) / contact_modulus)
        return c**2 / (2 * radius) - displacement(c) + lift - work / tension

    c = brentq(excess, a * (1 + 1e-12), a + 50, xtol=1e-15, rtol=1e-14)
    d = displacement(c)
    contact = quad(lambda x: contact_modulus * (d - x**2 / radius), 0, a)[0]
    ring = quad(lambda phi: -2 * tension * (c * np.cos(phi)) ** 2, np.arcsin(a / c), np.pi / 2)[0]
    return 2 * (contact + ring), d, c


@pytest.mark.parametrize("parameter", [0.1, 1.0, 4.0])
@pytest.mark.parametrize("a", [0.05, 0.6, 2.0])
def test_maugis_balances_the_edge_and_opens_to_the_range_at_the_outer_radius(parameter, a):
    tension = strength(parameter)
    force, displacement, contact_radius, outer_radius = maugis.curve(a, *SPHERE, tension)
    assert contact_radius == a
    assert_allclose((force, displacement, outer_radius), dugdale(a, tension), rtol=1e-9)


def test_maugis_pulls_off_at_the_known_forces():
    state = maugis.pull_off(*SPHERE, strength(np.array([0.2, 0.5, 1, 2, 5])))
    known = [-1.8805, -1.7182, -1.6007, -1.5346, -1.5063]
    assert_allclose(state.force / UNITS.force, known, atol=6e-5)


@pytest.mark.parametrize("parameter", [1.0, 2.0, 5.0])
def test_the_fold_of_maugis_is_that_of_the_quadrature(parameter):
    tension = strength(parameter)
    fold = maugis.pull_off(*SPHERE, tension, np.inf)
    a = brentq(
        lambda a: derivative(lambda a: dugdale(a, tension)[1], a),
        0.8 * fold.contact_radius,
        1.2 * fold.contact_radius,
        xtol=1e-12,
    )
    assert_allclose((fold.force, fold.displacement), dugdale(a, tension)[:2], rtol=1e-8)


@pytest.mark.parametrize("parameter", [0.2, 0.9, 1.0, 3.0])
@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_maugis_lets_go_where_its_slope_is_that_of_the_spring(parameter, stiffness):
    tension = strength(parameter)
    state = maugis.pull_off(*SPHERE, tension, stiffness)

    if state.contact_radius > 0:
        branch, x = lambda a: maugis.curve(a, *SPHERE, tension), state.contact_radius
    else:
        branch, x = lambda c: maugis.without_contact(c, *SPHERE, tension), state.outer_radius
    force, displacement = (derivative(lambda x, i=i: branch(x)[i], x) for i in (0, 1))
    share = 1 / (1 + stiffness)
    missed = share * force + (1 - share) * displacement
    assert abs(missed) < 1e-8 * (share * abs(force) + abs(displacement) + UNITS.displacement)


@pytest.mark.parametrize("parameter", [0.1, 0.9, 1.0, 20.0])
def test_the_branch_of_maugis_goes_on_without_contact(parameter):
    tension = strength(parameter)
    touch = maugis.first_touch(*SPHERE, tension)
    last = maugis.curve(1e-9, *SPHERE, tension)
    assert_allclose(last, touch, rtol=1e-8, atol=2e-9)
    # In the middle the tension's displacement, 2 s c / E*, closes the gap.
    assert_allclose(-touch.displacement, 2 * tension * touch.outer_radius / SPHERE[1], rtol=1e-12)
    end = maugis.without_contact(0.0, *SPHERE, tension)
    assert_allclose(end, (0, -SPHERE[2] / tension, 0, 0))


@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_maugis_lets_go_like_jkr_without_range(stiffness):
    state = maugis.pull_off(*SPHERE, strength(1e5), stiffness)
    assert_allclose(state[:3], jkr.pull_off(*SPHERE, stiffness), rtol=1e-9)


def test_maugis_nears_dmt_with_lambda():
    a = np.geomspace(0.5, 2, 5)
    limit = 4 * SPHERE[1] * a**3 / (3 * SPHERE[0]) - 2 * np.pi * SPHERE[2] * SPHERE[0]
    near, nearer = (maugis.curve(a, *SPHERE, strength(x)).force for x in (1e-7, 1e-9))
    assert_allclose((near - limit) / (nearer - limit), 100, rtol=0.02)
