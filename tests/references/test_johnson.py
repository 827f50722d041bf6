"""Johnson's wave: against quadrature of his pressure, Westergaard and known numbers."""

import numpy as np
import pytest
from closed_forms import derivative, wave
from numpy.testing import assert_allclose
from scipy.integrate import quad

from jaxstab.references import johnson, westergaard


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


def test_westergaards_pressure_has_the_given_mean():
    x = np.linspace(-0.5, 0.5, 20_001)
    for mean in (0.0, 0.3, 0.9):
        pressure = westergaard.pressure(x, mean, 0.2, 1.0, 2.0)
        assert_allclose(np.trapezoid(pressure, x), mean, rtol=1e-5)
