"""Guduru's wavy sphere: against Struve functions, JKR and a known number."""

import numpy as np
import pytest
from closed_forms import SPHERE, WAVES
from numpy.testing import assert_allclose
from scipy.special import struve

from jaxstab.references import guduru, jkr


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
