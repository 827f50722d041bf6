"""Dugdale's contact of any tip against closed forms: Maugis, JKR, DMT, Hertz and Sneddon."""

import numpy as np
import pytest

import jaxstab as js
from jaxstab.lab.dugdale import with_adhesion, without_adhesion
from jaxstab.references import jkr, maugis

RADIUS, MODULUS, WORK, DEPTH = 1e-6, 1e6, 1e-3, 2e-7
TIP = js.lab.Paraboloid(RADIUS)


@pytest.mark.parametrize("tabor", [0.01, 0.1, 0.5, 1.0, 3.0, 10.0, 1000.0])
def test_a_paraboloid_has_the_branch_of_maugis(tabor):
    length = np.cbrt(RADIUS * (WORK / MODULUS) ** 2) / tabor
    law = RADIUS, MODULUS, WORK, WORK / length
    found = with_adhesion(TIP, MODULUS, WORK, length, DEPTH, 0.0)
    touch = maugis.first_touch(*law)
    # Before contact the outer radius follows from the force.
    outer = np.sqrt(-found.force[:100] / (np.pi * law[3]))
    exact = maugis.without_contact(np.minimum(outer, touch.outer_radius), *law)
    np.testing.assert_allclose(found.indentation[:100], exact.displacement, atol=1e-9 * DEPTH)
    # In contact: the force at the displacement of the closed form, by its own contact radii.
    radii = np.sqrt(RADIUS * DEPTH) * np.linspace(0.2, 0.9, 30)
    exact = maugis.curve(radii, *law)
    stable = slice(100 + int(np.argmin(found.indentation[100:])), None)
    is_deep = exact.displacement > found.indentation[stable].min()
    force = np.interp(exact.displacement, found.indentation[stable], found.force[stable])
    np.testing.assert_allclose(force[is_deep], exact.force[is_deep], atol=1e-4 * force.max())


def test_short_ranges_end_in_jkr_and_long_ones_in_dmt():
    for length, limit in ((1e-12, 1.5), (1e-5, 2.0)):
        force = with_adhesion(TIP, MODULUS, WORK, length, DEPTH, 0.0).force
        assert -force.min() / (np.pi * WORK * RADIUS) == pytest.approx(limit, rel=2e-3)
    exact = float(jkr.pull_off(RADIUS, MODULUS, WORK).force)
    force = with_adhesion(TIP, MODULUS, WORK, 1e-12, DEPTH, 0.0).force
    assert force.min() == pytest.approx(exact, rel=2e-4)


def test_a_cone_of_short_range_has_maugis_and_barquins_pull_off():
    # F = pi a^2 E* s / 2 - sqrt(8 pi w E* a^3), with the slope s of the flank.
    slope = 1 / np.tan(np.radians(70.0))
    a = np.geomspace(1e-10, 1e-6, 200_000)
    exact = np.min(np.pi * a**2 * MODULUS * slope / 2 - np.sqrt(8 * np.pi * WORK * MODULUS * a**3))
    found = with_adhesion(js.lab.Cone(70.0), MODULUS, WORK, 1e-13, DEPTH, 0.0)
    assert found.force.min() == pytest.approx(exact, rel=1e-3)


def test_sneddons_forces_without_adhesion():
    d, force = without_adhesion(TIP, MODULUS, DEPTH, 0.0)
    np.testing.assert_allclose(force, 4 / 3 * MODULUS * np.sqrt(RADIUS) * d**1.5, rtol=1e-12)
    d, force = without_adhesion(js.lab.Cone(60.0), MODULUS, DEPTH, 0.0)
    np.testing.assert_allclose(
        force, 2 / np.pi * np.tan(np.radians(60)) * MODULUS * d**2, rtol=1e-12
    )
    for faces, factor in ((3, 0.8887), (4, 0.7453)):
        d, force = without_adhesion(js.lab.Pyramid(35.0, faces), MODULUS, DEPTH, 0.0)
        exact = factor * np.tan(np.radians(35)) * MODULUS * d**2
        np.testing.assert_allclose(force, exact, rtol=1e-12)
    d, force = without_adhesion(js.lab.FlatPunch(RADIUS), MODULUS, DEPTH, 0.0)
    np.testing.assert_allclose(force, 2 * MODULUS * RADIUS * d, rtol=1e-12)


def test_a_sphere_has_sneddons_closed_form():
    d, force = without_adhesion(js.lab.Sphere(RADIUS), MODULUS, RADIUS / 2, 0.0)
    a = np.linspace(0.2, 0.6, 20) * RADIUS
    logarithm = np.log((RADIUS + a) / (RADIUS - a))
    exact = MODULUS * ((a**2 + RADIUS**2) / 2 * logarithm - a * RADIUS)
    np.testing.assert_allclose(np.interp(a / 2 * logarithm, d, force), exact, rtol=1e-4)


def test_a_punch_is_pulled_off_at_kendalls_force():
    found = with_adhesion(js.lab.FlatPunch(RADIUS), MODULUS, WORK, 1e-9, DEPTH, 0.0)
    exact = -np.sqrt(8 * np.pi * WORK * MODULUS * RADIUS**3)
    assert found.force.min() == pytest.approx(exact, rel=1e-12)


def test_a_travel_includes_the_bending_of_the_spring():
    found = without_adhesion(TIP, MODULUS, DEPTH, 0.1)
    assert DEPTH < found.indentation[-1] + 0.1 * found.force[-1] < 1.05 * DEPTH


@pytest.mark.nightly
def test_rings_agree_with_the_closed_form():
    # A smooth edge of the attraction and rings of a finite width cost some per cent.
    units = 1e6  # µm and Pa
    length = np.cbrt(RADIUS * (WORK / MODULUS) ** 2) / 0.5
    law = js.potentials.Dugdale(WORK * units, length * units, smoothing=0.05)
    rings = js.Rings(400, 0.9)
    contact = js.Contact(
        js.solids.AxisymmetricHalfSpace(rings, MODULUS), js.surfaces.paraboloid(rings, 1.0), law
    )
    state = js.equilibrate(contact, js.FarDisplacement(-0.05))
    found = with_adhesion(TIP, MODULUS, WORK, length, DEPTH, 0.0)
    stable = slice(100 + int(np.argmin(found.indentation[100:])), None)
    exact = np.interp(0.05e-6, found.indentation[stable], found.force[stable])
    assert float(state.force) * 1e-12 == pytest.approx(exact, rel=0.02)
