"""The work to open a crack in a viscoelastic solid, against the integral as published."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

import jaxstab as js
from jaxstab.references import persson_brener

RATIOS, TIMES, RADIUS = (4.0, 2.0), (0.1, 3.0), 0.02
SOLID = js.Viscoelastic(js.HalfSpace(js.Grid(4), 1.0), RATIOS, TIMES)


@pytest.mark.parametrize("turns", [0.02, 1.0, 50.0])
def test_work_is_that_of_the_integral_over_the_loss(turns):
    def integrand(y):
        q = turns * np.exp(-y)
        storage, loss = map(float, SOLID.storage_and_loss(q))
        return np.sqrt(1 - np.exp(-2 * y)) * loss / (storage**2 + loss**2)

    expected = 1 / (1 - 2 / np.pi * quad(integrand, 0, 40, limit=400)[0])
    # The tip's radius grows with the work: v = W a / (2 pi).
    speed = turns * RADIUS * expected / (2 * np.pi)
    assert_allclose(persson_brener.work(speed, RATIOS, TIMES, RADIUS), expected, rtol=1e-6)


def test_work_goes_from_that_of_the_law_to_the_ratio_of_the_moduli():
    slow, fast = persson_brener.work([1e-9, 1e9], RATIOS, TIMES, RADIUS)
    assert_allclose([slow, fast], [1, 1 + sum(RATIOS)], rtol=1e-5)


def test_the_stress_at_the_tip_radius_is_the_strength():
    intensity = np.sqrt(2 * 3.0 * 0.7)
    radius = persson_brener.tip_radius(0.7, 5.0, 3.0)
    assert_allclose(intensity / np.sqrt(2 * np.pi * radius), 5.0)


def test_mistakes_are_named():
    with pytest.raises(ValueError, match="ratio is -1"):
        persson_brener.work(1.0, (-1.0,), (1.0,), 1.0)
    with pytest.raises(ValueError, match="speed is 0"):
        persson_brener.work(0.0, (1.0,), (1.0,), 1.0)
    with pytest.raises(ValueError, match="give a time for each ratio"):
        persson_brener.work(1.0, (1.0,), (1.0, 2.0), 1.0)
    with pytest.raises(ValueError, match="ratio is inf"):
        persson_brener.work(1.0, (np.inf,), (1.0,), 1.0)


def test_one_ratio_and_time_may_be_numbers():
    expected = persson_brener.work(1.0, (2.0,), (3.0,), RADIUS)
    assert_allclose(persson_brener.work(1.0, 2.0, 3.0, RADIUS), expected)
