"""Johnson, Kendall & Roberts: against quadrature, Hertz and known numbers."""

import numpy as np
import pytest
from closed_forms import PARABOLOID, SPHERE, STIFFNESSES, UNITS, derivative
from numpy.testing import assert_allclose
from scipy.integrate import quad

from jaxstab.references import hertz, jkr


def force(a, *sphere):
    return jkr.curve(a, *sphere).force


def displacement_at(a):
    return jkr.curve(a, *SPHERE).displacement


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
        stage = derivative(displacement_at, a)
        return force(a, *SPHERE) * (stage + derivative(lambda a: force(a, *SPHERE), a) / stiffness)

    assert_allclose(jkr.loop_loss(*SPHERE, stiffness), quad(power, a_in, a_out)[0], rtol=1e-10)


@pytest.mark.parametrize("a", [0.1, 0.5, 2.0])
def test_the_energy_of_jkr_is_elastic_less_that_of_the_contact(a):
    assert_allclose(jkr.energy(a, *SPHERE), PARABOLOID.energy(a, displacement_at(a)), rtol=1e-10)
    work = force(a, *SPHERE) * derivative(displacement_at, a)
    assert_allclose(derivative(lambda a: jkr.energy(a, *SPHERE), a), work, rtol=1e-9)


def test_jkr_has_the_contact_that_its_authors_give_for_a_force():
    radius, contact_modulus, work = SPHERE
    a = jkr.pull_off(*SPHERE).contact_radius * np.array([1, 1.3, 2, 5])
    load, unit = force(a, *SPHERE), 3 * np.pi * work * radius
    apparent = load + unit + np.sqrt(np.maximum(2 * unit * load + unit**2, 0))
    # At pull-off the root turns a rounding error into its square root.
    assert_allclose(a[1:] ** 3, 3 * radius / (4 * contact_modulus) * apparent[1:], rtol=1e-12)
    assert_allclose(a[0] ** 3, 3 * radius / (4 * contact_modulus) * apparent[0], rtol=1e-7)


def test_jkr_without_adhesion_is_hertz():
    radius, contact_modulus, _ = SPHERE
    load = force(0.8, radius, contact_modulus, 1e-24)
    assert_allclose(hertz.contact_radius(load, radius, contact_modulus), 0.8, rtol=1e-11)


@pytest.mark.parametrize(
    "displacement, detach, jump_in",
    [
        (-0.9, 0.00156, 0.11479),
        (-0.8, 0.06788, 0.06518),
        (-0.6, 0.30015, 0.01905),
        (-0.4, 0.58296, 0.00364),
        (-0.2, 0.87518, 0.00023),
    ],
)
def test_the_barriers_of_jkr_are_known_and_the_area_below_the_curve(displacement, detach, jump_in):
    unit = UNITS.force * UNITS.displacement
    found = jkr.barriers(displacement * UNITS.displacement, *SPHERE)
    assert_allclose(np.array(found) / unit, [detach, jump_in], atol=5.1e-6)
    stable, top = jkr.states_at(displacement * UNITS.displacement, *SPHERE)
    assert_allclose([stable.displacement, top.displacement], displacement * UNITS.displacement)

    def power(root):
        """F dd/da along the curve, over the square root of a."""
        a = root**2
        return force(a, *SPHERE) * derivative(displacement_at, a) * 2 * root

    ends = np.sqrt([stable.contact_radius, top.contact_radius])
    assert_allclose(found.detach, quad(power, *ends)[0], rtol=1e-8)
    assert_allclose(found.jump_in, quad(power, 0, ends[1])[0], rtol=1e-8)


def test_beyond_pull_off_and_after_first_touch_there_is_no_pass():
    ends = jkr.barriers(np.array([-0.92, -0.5, 0.1]) * UNITS.displacement, *SPHERE)
    assert np.isfinite(ends.detach).tolist() == [False, True, False]
    at_pull_off = jkr.barriers(jkr.pull_off(*SPHERE, np.inf).displacement * (1 - 1e-9), *SPHERE)
    assert_allclose(at_pull_off.detach, 0, atol=1e-9)
