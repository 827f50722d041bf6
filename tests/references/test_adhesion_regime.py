"""Which closed form describes a sphere: against known numbers and the curve of Maugis."""

import jax.numpy as jnp
import numpy as np
import pytest
from closed_forms import SPHERE, UNITS
from numpy.testing import assert_allclose

from jaxstab import references
from jaxstab.references import maugis
from jaxstab.references.adhesion_regime import contact_radius_errors


def test_the_parameters_are_those_of_tabor_and_of_maugis():
    # A tip of 20 nm on a solid of 1 GPa; R w^2 / (E*^2 z0^3) = 20e-9 * 1e-2 / (1e18 * 1e-27).
    found = references.regime(20e-9, 1e9, 0.1, 1e-9)
    assert found.tabor == pytest.approx(0.2 ** (1 / 3))
    strength = 0.1 / 1e-9
    assert found.maugis == pytest.approx(maugis.transition_parameter(20e-9, 1e9, 0.1, strength))
    # With the tension of Lennard-Jones' peak it is the factor of Maugis' paper.
    peak = 16 / (9 * np.sqrt(3)) * strength
    assert maugis.transition_parameter(20e-9, 1e9, 0.1, peak) / found.tabor == pytest.approx(
        1.157, abs=1e-3
    )


@pytest.mark.parametrize("parameter, known", [(0.2, 1.8805), (1.0, 1.6007), (5.0, 1.5063)])
def test_errors_of_the_pull_off_are_those_of_known_forces(parameter, known):
    work = SPHERE[2]
    strength = parameter / maugis.transition_parameter(*SPHERE, 1.0)
    found = references.regime(*SPHERE, work / strength)
    assert found.pull_off == pytest.approx(-known, abs=6e-5)
    assert found.errors["jkr"] == pytest.approx(1 - 1.5 / known, abs=5e-5)
    assert found.errors["dmt"] == pytest.approx(2 / known - 1, abs=5e-5)
    assert (found.errors["hertz"], found.errors["maugis"]) == (1, 0)
    # The dimensional solution gives the same.
    force = maugis.pull_off(*SPHERE, strength).force
    assert found.pull_off == pytest.approx(force / UNITS.force, rel=1e-12)


def test_short_ranges_are_jkrs_and_long_ones_dmts():
    found = references.regime(1e-6, 1e9, 0.05, [1e-14, 1e-2])
    assert_allclose(found.errors["jkr"], [0, 1 / 4], atol=1e-6)
    assert_allclose(found.errors["dmt"], [1 / 3, 0], atol=1e-6)
    single = references.regime(*np.float32([1e-6, 1e9, 0.05, 1e-9]))
    double = references.regime(1e-6, 1e9, jnp.asarray(0.05), 1e-9)
    assert_allclose(single.tabor, double.tabor, rtol=1e-6)


def test_it_prints_the_forms_within_one_five_and_twenty_per_cent():
    text = str(references.regime(1e-6, 1e9, 0.05, 1e-9))
    assert "within 1 %: maugis." in text and "within 5 %: jkr, maugis." in text
    assert " 3.47%" in text and "100.00%" in text
    dmt = str(references.regime(1e-6, 1e11, 0.05, 1e-9))
    assert "within 1 %: maugis." in dmt and "within 5 %: dmt, maugis." in dmt
    assert len(str(references.regime(1e-6, [1e9, 1e10, 1e11], 0.05, 1e-9)).splitlines()) == 5


def test_a_range_of_zero_or_less_is_named():
    for wrong in (0.0, -1e-9, np.nan, np.inf):
        with pytest.raises(ValueError, match=f"The range is {wrong}"):
            references.regime(1e-6, 1e9, 0.05, wrong)


def test_errors_of_the_contact_radius_are_those_on_maugis_curve():
    parameter, load = np.array([0.03, 0.7, 40.0]), np.array([0.2, 3.0, 400.0])
    errors = contact_radius_errors(parameter, load)
    # Hertz' radius is the smallest.
    radius = np.cbrt(load) / (1 - errors["hertz"])
    strength = parameter[:, None] / maugis.transition_parameter(*SPHERE, 1.0)
    force = maugis.curve(radius * UNITS.contact_radius, *SPHERE, strength).force / UNITS.force
    assert_allclose(force, np.broadcast_to(load, force.shape), rtol=2e-3)
    assert errors["dmt"][0, 0] < 0.02 < 0.2 < errors["jkr"][0, 0]
    assert errors["jkr"][2, 0] < 0.001 < 0.2 < errors["dmt"][2, 0]
