"""A held pressure: the gap beyond which surfaces have come apart, in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js

# Gaps of a profile lie 64 to the octave.
STEP = 2 ** (1 / 64) - 1


def escape_gap(law, pressure):
    contact = js.Contact(js.HalfSpace(js.Grid(8), 1.0), jnp.zeros((8, 8)), law)
    control = contact.control(js.MeanPressure(pressure))
    return float(control.escape_gap(contact.profile))


def test_under_a_tension_it_is_where_a_thousandth_of_it_is_the_attraction():
    law = js.potentials.Exponential(0.01, 0.1)
    for tension in (0.05, 0.005):
        expected = 0.1 * np.log(0.1 / (1e-3 * tension))
        assert escape_gap(law, -tension) == pytest.approx(expected, rel=STEP)
    assert escape_gap(law, 0.5) == np.inf


def test_without_a_pressure_it_is_where_a_law_begins_to_repel():
    def law(gap):
        return 0.01 * jnp.exp(-gap / 0.2) - 0.03 * jnp.exp(-gap / 0.1)

    assert escape_gap(law, 0.0) == pytest.approx(0.2 * np.log(6), rel=STEP)
