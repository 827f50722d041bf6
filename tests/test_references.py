"""The closed forms, held against quadrature, each other's limits and known numbers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import struve

from jaxstab.references import guduru, hertz, jkr, johnson, maugis, westergaard

# R, E*, w without any unit of their own equal to one; A, L of waves and of a periodic surface.
SPHERE = 2.0, 3.0, 0.7
WAVES = 0.02, 0.15
UNITS = jkr.units(*SPHERE)
STIFFNESSES = 0.0, 0.3, 2.0, 30.0, np.inf


def wave(alpha, amplitude=0.3, length=2.0, contact_modulus=5.0):
    """Return Johnson's arguments of given alpha."""
    work = (alpha * np.pi * amplitude) ** 2 * contact_modulus / (2 * length)
    return amplitude, length, contact_modulus, work


def strength(parameter):
    """Return the tension of Maugis' sphere of given lambda."""
    return parameter / maugis.transition_parameter(*SPHERE, 1.0)


def derivative(function, x, step=1e-3):
    """Return f'(x) from six values, with an error of order step^6."""
    h = step * x
    differences = [(function(x + i * h) - function(x - i * h)) / (2 * i * h) for i in (1, 2, 3)]
    return np.dot([1.5, -0.6, 0.1], differences)


def slope(curve, x):
    """Return dF/dd of a curve where its parameter is x."""
    return derivative(lambda x: curve(x)[0], x) / derivative(lambda x: curve(x)[1], x)


class Profile:
    """Contact with any axisymmetric profile, by quadrature of its slope.

    A pressure whose transform is g(x), from the middle to x = a, has the force 2 int g and the
    elastic energy int g^2 / E*; over the contact g = E* (d - Hertz's displacement at radius x).
    """

    def __init__(self, slope, contact_modulus, work):
        self.slope, self.contact_modulus, self.work = slope, contact_modulus, work

    def smooth(self, x):
        """The displacement at which contact without adhesion has the radius x (Sneddon 1965)."""
        return x * quad(lambda phi: self.slope(x * np.sin(phi)), 0, np.pi / 2, epsabs=1e-13)[0]

    def transform(self, x, displacement):
        return self.contact_modulus * (displacement - self.smooth(x))

    def force(self, a, displacement):
        return 2 * quad(self.transform, 0, a, displacement, epsabs=1e-12, limit=200)[0]

    def energy(self, a, displacement):
        squares = quad(lambda x: self.transform(x, displacement) ** 2, 0, a, limit=200)[0]
        return squares / self.contact_modulus - np.pi * a**2 * self.work


PARABOLOID = Profile(lambda r: r / SPHERE[0], *SPHERE[1:])
WAVY = Profile(
    lambda r: r / SPHERE[0] + 2 * np.pi * WAVES[0] / WAVES[1] * np.sin(2 * np.pi * r / WAVES[1]),
    *SPHERE[1:],
)


@pytest.mark.parametrize(
    "curve, profile",
    [
        (lambda a: jkr.curve(a, *SPHERE), PARABOLOID),
        (lambda a: guduru.curve(a, *SPHERE, *WAVES), WAVY),
    ],
    ids=["jkr", "guduru"],
)
@pytest.mark.parametrize("a", [0.21, 0.9, 1.6])
def test_no_radius_of_contact_is_better_at_the_same_displacement(curve, profile, a):
    force, displacement, _ = curve(a)
    assert_allclose(force, profile.force(a, displacement), rtol=1e-10)
    change = derivative(lambda a: profile.energy(a, displacement), a)
    assert abs(change) < 1e-8 * 2 * np.pi * a * profile.work


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


@pytest.mark.parametrize(
    "pull_off",
    [lambda k: jkr.pull_off(*SPHERE, k), lambda k: maugis.pull_off(*SPHERE, strength(2.0), k)],
    ids=["jkr", "maugis"],
)
def test_a_soft_spring_is_dead_load_and_a_stiff_one_holds_the_displacement(pull_off):
    assert_allclose(pull_off(1e-12), pull_off(0), rtol=1e-10)
    assert_allclose(pull_off(1e12), pull_off(np.inf), rtol=1e-10)


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


def test_maugis_folds_at_the_known_displacements():
    state = maugis.pull_off(*SPHERE, strength(np.array([1.0, 2, 5])), np.inf)
    assert_allclose(state.displacement / UNITS.displacement, [-0.9917, -0.9386, -0.9139], atol=6e-5)
    assert_allclose(state.force / UNITS.force, [-0.8917, -0.8402, -0.8347], atol=6e-5)


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


def test_contact_is_lost_before_the_fold_for_small_lambda():
    before, after = maugis.pull_off(
        *SPHERE, strength(np.array([0.937, 0.939])), np.inf
    ).contact_radius
    assert before == 0
    assert after > 0


def test_maugis_nears_jkr_with_the_square_of_lambda():
    a = np.geomspace(0.1, 5, 9)
    near, nearer = (np.array(maugis.curve(a, *SPHERE, strength(x))[:2]) for x in (1e2, 1e3))
    limit = np.array(jkr.curve(a, *SPHERE)[:2])
    assert_allclose((near - limit) / (nearer - limit), 100, rtol=1e-3)


@pytest.mark.parametrize("stiffness", STIFFNESSES)
def test_maugis_lets_go_like_jkr_without_range(stiffness):
    state = maugis.pull_off(*SPHERE, strength(1e5), stiffness)
    assert_allclose(state[:3], jkr.pull_off(*SPHERE, stiffness), rtol=1e-9)


def test_maugis_nears_dmt_with_lambda():
    a = np.geomspace(0.5, 2, 5)
    limit = 4 * SPHERE[1] * a**3 / (3 * SPHERE[0]) - 2 * np.pi * SPHERE[2] * SPHERE[0]
    near, nearer = (maugis.curve(a, *SPHERE, strength(x)).force for x in (1e-7, 1e-9))
    assert_allclose((near - limit) / (nearer - limit), 100, rtol=0.02)


def test_johnson_has_the_known_folds():
    waves = wave(np.array([0.1, 0.3, 0.5, 0.9]))
    unit = westergaard.full_contact_pressure(*waves[:3])
    leaving, entering = johnson.pull_off(*waves), johnson.jump_to_full_contact(*waves)
    known = [-0.02198, -0.09594, -0.19189, -0.43640]
    assert_allclose(leaving.mean_pressure / unit, known, atol=6e-6)
    assert_allclose(leaving.contact_fraction, [0.055, 0.117, 0.171, 0.293], atol=5e-4)
    known = [0.74141, 0.38773, 0.09390, -0.39563]
    assert_allclose(entering.mean_pressure / unit, known, atol=6e-6)


@pytest.mark.parametrize("fold", [johnson.pull_off, johnson.jump_to_full_contact])
@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_johnson_folds_where_the_pressure_no_longer_changes(fold, alpha):
    waves = wave(alpha)
    fraction = fold(*waves).contact_fraction
    change = derivative(lambda f: johnson.curve(f, *waves).mean_pressure, fraction)
    assert abs(fraction * change) < 1e-9 * westergaard.full_contact_pressure(*waves[:3])


def test_contact_is_full_by_itself_where_its_jump_needs_no_pressure():
    assert_allclose(3**0.75 / 4, 0.5699, atol=5e-5)
    for alpha in (0.569, 0.570):
        jump = johnson.jump_to_full_contact(*wave(alpha)).mean_pressure
        assert johnson.is_full_by_itself(*wave(alpha)) == (jump < 0)


def wave_fields(fraction, amplitude, length, contact_modulus, work):
    """Return mean pressure, mean gap and energy per area by quadrature of Johnson's pressure.

    sin(pi x / L) = sin(theta) sin(phi); Westergaard's pressure, and that of flat punches with the
    stress intensity sqrt(2 E* w) at the edge.
    """
    edge = np.pi / 2 * fraction
    tension = np.sqrt(2 * contact_modulus * work * np.tan(edge) / length)
    peak = np.pi * contact_modulus * amplitude / length

    def density(phi):
        return 2 * peak * (np.sin(edge) * np.cos(phi)) ** 2 - tension

    def mean(weight):
        integrand = lambda phi: density(phi) * weight(np.sin(edge) * np.sin(phi))  # noqa: E731
        return 2 / np.pi * quad(integrand, 0, np.pi / 2, epsabs=1e-13)[0]

    pressure = mean(lambda sine: 1.0)
    # Under a crest, by the displacement of a periodic line of force.
    raised = -2 * length / (np.pi * contact_modulus) * mean(lambda sine: np.log(2 * abs(sine)))
    gap = amplitude - raised
    elastic = (mean(lambda sine: amplitude * (1 - 2 * sine**2)) - gap * pressure) / 2
    return pressure, gap, elastic - work * fraction


@pytest.mark.parametrize("alpha", [0.1, 0.9])
@pytest.mark.parametrize("fraction", [0.05, 0.4, 0.9])
def test_johnson_balances_elastic_and_adhesive_energy(alpha, fraction):
    waves = wave(alpha)
    pressure, gap, _ = wave_fields(fraction, *waves)
    state = johnson.curve(fraction, *waves)
    assert_allclose(state.mean_pressure, pressure, rtol=1e-10, atol=1e-12)
    assert_allclose(state.mean_gap, gap, rtol=1e-9)
    energy = derivative(lambda f: wave_fields(f, *waves)[2], fraction)
    gap = derivative(lambda f: johnson.curve(f, *waves).mean_gap, fraction)
    assert_allclose(energy, -pressure * gap, rtol=1e-6)


def test_johnson_without_adhesion_is_westergaard():
    waves = wave(1e-10)
    for fraction in (0.1, 0.5, 0.9):
        pressure = float(johnson.curve(fraction, *waves).mean_pressure)
        assert_allclose(westergaard.contact_fraction(pressure, *waves[:3]), fraction, rtol=1e-8)
    full = westergaard.full_contact_pressure(*waves[:3])
    assert_allclose(johnson.jump_to_full_contact(*waves).mean_pressure, full, rtol=1e-6)


@pytest.mark.parametrize("a", [1e-3, 0.3, 2.0, 40.0])
def test_guduru_is_what_struve_functions_give(a):
    amplitude, length = WAVES
    q = 2 * np.pi * a / length
    depth = np.pi**2 * amplitude * a / length
    state, smooth = guduru.curve(a, *SPHERE, *WAVES), jkr.curve(a, *SPHERE)
    force = 2 * SPHERE[1] * a * depth * (struve(0, q) - struve(1, q) / q)
    assert_allclose(state.force, smooth.force + force, rtol=1e-13)
    assert_allclose(state.displacement, smooth.displacement + depth * struve(0, q), rtol=1e-13)


def test_guduru_without_waves_is_jkr():
    a = np.geomspace(0.01, 5, 9)
    assert_allclose(guduru.curve(a, *SPHERE, 0.0, 0.15), jkr.curve(a, *SPHERE), rtol=1e-15)
    assert_allclose(guduru.envelope_pull_off(*SPHERE, 0.0, 0.15), jkr.pull_off(*SPHERE))


@pytest.mark.parametrize("alpha", [0.5, 2.0])
def test_short_waves_pull_off_at_the_known_force(alpha):
    radius, contact_modulus, work = SPHERE
    length = 2e-3
    amplitude = np.sqrt(2 * work * length / contact_modulus) / (np.pi * alpha)
    lowest = guduru.envelope_pull_off(*SPHERE, amplitude, length)
    known = -1.5 * np.pi * work * radius * (1 + 1 / (np.sqrt(np.pi) * alpha)) ** 2
    assert_allclose(lowest.force, known, rtol=1e-13)

    a = lowest.contact_radius + np.linspace(-1, 1, 1001) * length
    state = guduru.curve(a, *SPHERE, amplitude, length)
    assert_allclose(state.force.min(), known, rtol=1e-5)
    envelope = guduru.envelope(a, *SPHERE, amplitude, length)
    distance = state.displacement - envelope.displacement
    assert_allclose(distance.min(), 0, atol=1e-4 * np.ptp(distance))


# With the kinds of arguments and results: lengths, pressures, energies per area, stiffnesses, ...
SPHERICAL = (0.5, *SPHERE)
DUGDALE = (*SPHERE, 0.9)
JOHNSON = wave(0.4)
CASES = {
    "jkr.units": (jkr.units, SPHERE, "LPW", "FLL"),
    "jkr.curve": (jkr.curve, SPHERICAL, "LLPW", "FLL"),
    "jkr.energy": (jkr.energy, SPHERICAL, "LLPW", "E"),
    "jkr.pull_off": (jkr.pull_off, (*SPHERE, 2.0), "LPWK", "FLL"),
    "jkr.jump_in": (jkr.jump_in, (*SPHERE, 2.0), "LPWK", "FLL"),
    "jkr.loop_loss": (jkr.loop_loss, (*SPHERE, 2.0), "LPWK", "E"),
    "maugis.transition_parameter": (maugis.transition_parameter, DUGDALE, "LPWP", "1"),
    "maugis.curve": (maugis.curve, (0.5, *DUGDALE), "LLPWP", "FLLL"),
    "maugis.without_contact": (maugis.without_contact, (0.1, *DUGDALE), "LLPWP", "FLLL"),
    "maugis.first_touch": (maugis.first_touch, DUGDALE, "LPWP", "FLLL"),
    "maugis.pull_off": (maugis.pull_off, (*DUGDALE, 2.0), "LPWPK", "FLLL"),
    "johnson.adhesion_parameter": (johnson.adhesion_parameter, JOHNSON, "LLPW", "1"),
    "johnson.curve": (johnson.curve, (0.3, *JOHNSON), "1LLPW", "PL1"),
    "johnson.pull_off": (johnson.pull_off, JOHNSON, "LLPW", "PL1"),
    "johnson.jump_to_full_contact": (johnson.jump_to_full_contact, JOHNSON, "LLPW", "PL1"),
    "guduru.curve": (guduru.curve, (*SPHERICAL, *WAVES), "LLPWLL", "FLL"),
    "guduru.envelope": (guduru.envelope, (*SPHERICAL, *WAVES), "LLPWLL", "FLL"),
    "guduru.envelope_work": (guduru.envelope_work, (*SPHERE[1:], *WAVES), "PWLL", "W"),
    "guduru.envelope_pull_off": (guduru.envelope_pull_off, (*SPHERE, *WAVES), "LPWLL", "FLL"),
}


@pytest.mark.parametrize("function, arguments, kinds, results", CASES.values(), ids=CASES)
def test_units_do_not_matter_and_arrays_are_taken_entry_by_entry(
    function, arguments, kinds, results
):
    length, pressure = 3.0, 7.0
    factor = {"1": 1, "L": length, "P": pressure, "W": length * pressure, "K": length * pressure}
    factor |= {"F": length**2 * pressure, "E": length**3 * pressure}
    arrays = [np.array([x, x * factor[kind]]) for x, kind in zip(arguments, kinds, strict=True)]
    both = np.reshape(function(*arrays), (len(results), 2))
    assert_allclose(both[:, 0], np.ravel(function(*arguments)), rtol=1e-13)
    scales = [factor[result] for result in results]
    assert_allclose(both[:, 1], both[:, 0] * scales, rtol=1e-11)


@pytest.mark.parametrize("function, arguments, kinds, results", CASES.values(), ids=CASES)
def test_every_field_has_the_shape_of_all_arguments_together(function, arguments, kinds, results):
    for varied in range(len(arguments)):
        shaped = list(arguments)
        shaped[varied] = np.full((2, 3), arguments[varied])
        assert np.shape(function(*shaped))[-2:] == (2, 3)


@pytest.mark.parametrize(
    "call, sentence",
    [
        (lambda: jkr.curve([1.0, -2.0], *SPHERE), "The contact radius is -2: give a positive"),
        (lambda: jkr.units(1.0, 0.0, 1.0), "The contact modulus is 0: give a positive, finite"),
        (lambda: jkr.pull_off(1.0, 1.0, np.inf), "The work of adhesion is inf: give a positive"),
        (lambda: jkr.pull_off(*SPHERE, -1.0), "The stiffness is -1: give zero or a positive"),
        (lambda: jkr.loop_loss(*SPHERE, 0.0), "The stiffness is 0: give a positive"),
        (lambda: maugis.pull_off(*SPHERE, np.nan), "The strength is nan: give a positive"),
        (lambda: maugis.without_contact(9.0, *DUGDALE), "The outer radius is 9: give at most"),
        (lambda: johnson.curve(1.0, *JOHNSON), "The contact fraction is 1: give a number below 1"),
        (
            lambda: johnson.pull_off(*wave(1.1)),
            "The adhesion parameter alpha is 1.1: give one up to 1.06",
        ),
        (lambda: guduru.curve(*SPHERICAL, -0.1, 1.0), "The amplitude is -0.1: give zero or"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call()
