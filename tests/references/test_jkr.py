"""Johnson, Kendall & Roberts: against quadrature, Hertz and known numbers."""

import numpy as np
import pytest
from closed_forms import PARABOLOID, SPHERE, STIFFNESSES, UNITS, derivative
from numpy.testing import assert_allclose
from scipy.integrate import quad

from jaxstab.references import hertz, jkr


def slope(curve, x):
    """Return dF/dd of a curve where its parameter is x."""
    return derivative(lambda x: curve(x)[0], x) / derivative(lambda x: curve(x)[1], x)


@pytest.mark.parametrize(
    "stiffness, force, displacement", [(0, -3 / 2, -0.43679), (np.inf, -5 / 6, -0.90856)]
)
def test_jkr_lets_go_at_the_known_forces(stiffness, force, displacement):
    state = jkr.pull_off(*SPHERE, stiffness)
    assert_allclose(state.force, force * np.pi * SPHERE[2] * SPHERE[0], rtol=1e-14)
    assert_allclose(state.displacement / UNITS.displacement, displacement, atol=5e-6)


@pytest.mark.parametrize("stiffness", STIFFNESSES[1:-1])
def test_jkr_lets_go_where_its_slope_is_that_of_the_spring(stiffness):
    a = jkr.pull_off(*SPHERE, stiffness).contact_radius
    assert_allclose(slope(lambda a: jkr.curve(a, *SPHERE), a), -stiffness, rtol=1e-9)


def test_jkr_jumps_into_contact_where_the_spring_pulls_back():
    state = jkr.jump_in(*SPHERE, np.array(STIFFNESSES))
    assert_allclose(state.force[-1], -4 / 3 * np.pi * SPHERE[2] * SPHERE[0], rtol=1e-14)
    assert_allclose(state.displacement[-1], 0, atol=1e-14)
    assert_allclose(
        state.force[:-1], -np.array(STIFFNESSES[:-1]) * state.displacement[:-1], atol=1e-13
    )
    radius, contact_modulus, work = SPHERE
    assert_allclose(state.contact_radius[-1] ** 3, 2 * np.pi * work * radius**2 / contact_modulus)


@pytest.mark.parametrize("stiffness", STIFFNESSES[1:])
def test_the_loop_loses_the_area_that_it_encloses(stiffness):
    a_in = jkr.jump_in(*SPHERE, stiffness).contact_radius
    a_out = jkr.pull_off(*SPHERE, stiffness).contact_radius

    def power(a):
        """F dD/da, where D is the end of the spring."""
        force = jkr.force(a, *SPHERE)
        stage = derivative(lambda a: jkr.displacement(a, *SPHERE), a)
        return force * (stage + derivative(lambda a: jkr.force(a, *SPHERE), a) / stiffness)

    assert_allclose(jkr.loop_loss(*SPHERE, stiffness), quad(power, a_in, a_out)[0], rtol=1e-10)


def test_the_loop_under_held_displacement_loses_the_known_energy():
    loss = jkr.loop_loss(*SPHERE)
    radius, contact_modulus, work = SPHERE
    assert_allclose(loss / (UNITS.force * UNITS.displacement), 1.27494, atol=5e-6)
    assert_allclose(loss / np.cbrt(work**5 * radius**4 / contact_modulus**2), 7.0922, atol=5e-5)


@pytest.mark.parametrize("a", [0.1, 0.5, 2.0])
def test_the_energy_of_jkr_is_elastic_less_that_of_the_contact(a):
    displacement = jkr.displacement(a, *SPHERE)
    assert_allclose(jkr.energy(a, *SPHERE), PARABOLOID.energy(a, displacement), rtol=1e-10)
    work = jkr.force(a, *SPHERE) * derivative(lambda a: jkr.displacement(a, *SPHERE), a)
    assert_allclose(derivative(lambda a: jkr.energy(a, *SPHERE), a), work, rtol=1e-9)


def test_jkr_has_the_contact_that_its_authors_give_for_a_force():
    radius, contact_modulus, work = SPHERE
    a = jkr.pull_off(*SPHERE).contact_radius * np.array([1, 1.3, 2, 5])
    force = jkr.force(a, *SPHERE)
    unit = 3 * np.pi * work * radius
    apparent = force + unit + np.sqrt(np.maximum(2 * unit * force + unit**2, 0))
    # At pull-off the root of what rounding leaves is the square root of rounding.
    assert_allclose(a[1:] ** 3, 3 * radius / (4 * contact_modulus) * apparent[1:], rtol=1e-12)
    assert_allclose(a[0] ** 3, 3 * radius / (4 * contact_modulus) * apparent[0], rtol=1e-7)


def test_jkr_without_adhesion_is_hertz():
    radius, contact_modulus, _ = SPHERE
    force = jkr.force(0.8, radius, contact_modulus, 1e-24)
    assert_allclose(hertz.contact_radius(force, radius, contact_modulus), 0.8, rtol=1e-11)
