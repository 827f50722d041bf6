"""Properties of several closed forms: energy balances, limits, units, shapes and refusals."""

import numpy as np
import pytest
from closed_forms import PARABOLOID, SPHERE, WAVES, Profile, derivative, strength, wave
from numpy.testing import assert_allclose

from jaxstab.references import elastic_plastic, guduru, hertz, jkr, johnson, maugis, westergaard

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
    "pull_off",
    [lambda k: jkr.pull_off(*SPHERE, k), lambda k: maugis.pull_off(*SPHERE, strength(2.0), k)],
    ids=["jkr", "maugis"],
)
def test_a_soft_spring_is_dead_load_and_a_stiff_one_holds_the_displacement(pull_off):
    assert_allclose(pull_off(1e-12), pull_off(0), rtol=1e-10)
    assert_allclose(pull_off(1e12), pull_off(np.inf), rtol=1e-10)


# With the kinds of arguments and results: lengths, pressures, energies per area, stiffnesses, ...
SPHERICAL = (0.5, *SPHERE)
DUGDALE = (*SPHERE, 0.9)
JOHNSON = wave(0.4)
PLASTIC = (0.5, 2.0, 3.0, 0.4)
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
    "elastic_plastic.first_yield": (elastic_plastic.first_yield, (2.0, 3.0, 0.4), "LPP", "FLL"),
    "elastic_plastic.fully_plastic": (elastic_plastic.fully_plastic, PLASTIC, "LLPP", "FLL"),
    "elastic_plastic.unloading": (elastic_plastic.unloading, (*PLASTIC, 0.2), "LLPPW", "FLL"),
    "elastic_plastic.pull_off": (elastic_plastic.pull_off, (*PLASTIC[1:], 0.2), "LPPW", "FLL"),
    "elastic_plastic.area_fractions": (
        elastic_plastic.area_fractions,
        (0.1, 0.2, 3.0, 0.4),
        "P1PP",
        "11",
    ),
    "elastic_plastic.conductance": (
        elastic_plastic.conductance,
        (0.1, 0.4, 0.02, 0.1, 1.0),
        "PPL11",
        "C",
    ),
    "guduru.envelope_pull_off": (guduru.envelope_pull_off, (*SPHERE, *WAVES), "LPWLL", "FLL"),
}


@pytest.mark.parametrize("function, arguments, kinds, results", CASES.values(), ids=CASES)
def test_units_do_not_matter_and_arrays_are_taken_entry_by_entry(
    function, arguments, kinds, results
):
    length, pressure = 3.0, 7.0
    factor = {"1": 1, "L": length, "P": pressure, "W": length * pressure, "K": length * pressure}
    factor |= {"C": 1 / length, "F": length**2 * pressure, "E": length**3 * pressure}
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
        (
            lambda: jkr.curve([1.0, -2.0], *SPHERE),
            r"The contact radius is -2.0 at \(1,\): give",
        ),
        (lambda: jkr.units(1.0, 0.0, 1.0), "The contact modulus is 0.0: give a positive, finite"),
        (lambda: jkr.pull_off(1.0, 1.0, np.inf), "The work of adhesion is inf: give a positive"),
        (lambda: jkr.pull_off(*SPHERE, -1.0), "The stiffness is -1.0: give zero or a positive"),
        (lambda: jkr.loop_loss(*SPHERE, 0.0), "The stiffness is 0.0: give a positive"),
        (lambda: maugis.pull_off(*SPHERE, np.nan), "The strength is nan: give a positive"),
        (lambda: maugis.without_contact(9.0, *DUGDALE), "The outer radius is 9.0: give at most"),
        (lambda: johnson.curve(1.0, *JOHNSON), "The contact fraction is 1.0: give one below 1"),
        (
            lambda: johnson.pull_off(*wave(1.1)),
            "The adhesion parameter alpha is 1.1: give one up to 1.06",
        ),
        (lambda: guduru.curve(*SPHERICAL, -0.1, 1.0), "The amplitude is -0.1: give zero or"),
        (
            lambda: hertz.contact_radius(-1.0, 1.0, 1.0),
            "The force is -1.0: give zero or a positive",
        ),
        (lambda: hertz.peak_pressure(0.0, 1.0, 1.0), "The force is 0.0: give a positive"),
        (
            lambda: elastic_plastic.unloading(2.0, 1.0, 1.0, 1.0),
            "The contact radius is 2.0: give at most the largest radius",
        ),
        (
            lambda: elastic_plastic.area_fractions(2.0, 0.1, 1.0, 1.0),
            "The pressure is 2.0: give at most the hardness",
        ),
        (
            lambda: elastic_plastic.first_yield(1.0, 1.0, 0.0),
            "The hardness is 0.0: give a positive",
        ),
        (
            lambda: westergaard.contact_fraction(4.0, 1.0, 1.0, 1.0),
            "The mean pressure is 4.0: give one from 0 to 3.14159",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call()
