"""Closed forms of contacts that yield, against quadrature, Hertz, JKR and a diffusion in steps."""

import numpy as np
import pytest
from closed_forms import Profile
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.optimize import minimize_scalar
from scipy.special import ellipe, ellipk, erf, erfcinv

from jaxstab.references import elastic_plastic, hertz, jkr

# E*, H and the largest radius.
E, H, LARGEST = 3.0, 0.4, 0.7


def sunk(r):
    """Return the displacement of a uniform pressure H on a disc (Johnson 1985, eq. 3.29a)."""
    return 4 * H * LARGEST / (np.pi * E) * ellipe((r / LARGEST) ** 2)


def slope_left(r):
    """Return the slope of the surface that is flat under that pressure."""
    m = (r / LARGEST) ** 2
    if not m:
        return 0.0
    return -4 * H / (np.pi * E) * (ellipe(m) - ellipk(m)) / np.sqrt(m)


def test_the_first_point_yields_at_the_peak_pressure_of_hertz():
    force, displacement, a = elastic_plastic.first_yield(2.0, E, H)
    assert_allclose(force, np.pi**3 * 2.0**2 * H**3 / (6 * E**2))
    assert_allclose(hertz.peak_pressure(float(force), 2.0, E), H)
    assert_allclose(a, hertz.contact_radius(float(force), 2.0, E))
    assert_allclose(displacement, a**2 / 2.0)


def test_the_edge_of_a_plastic_contact_is_on_the_paraboloid():
    state = elastic_plastic.fully_plastic(LARGEST, 2.0, E, H)
    assert_allclose(state.displacement - sunk(LARGEST), LARGEST**2 / 4.0)
    assert_allclose(state.force, quad(lambda r: 2 * np.pi * r * H, 0, LARGEST)[0])


@pytest.mark.parametrize("x", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("work", [0.0, 0.3])
def test_unloading_is_the_contact_of_the_surface_left(x, work):
    profile = Profile(slope_left, E, work)
    a = x * LARGEST
    force, displacement, _ = elastic_plastic.unloading(a, LARGEST, E, H, work)
    approach = profile.smooth(a) - np.sqrt(2 * np.pi * work * a / E)
    assert_allclose(displacement, approach, rtol=1e-8)
    assert_allclose(force, profile.force(a, approach), rtol=1e-8)


def test_unloading_begins_at_the_load_and_the_displacement_of_the_uniform_pressure():
    state = elastic_plastic.unloading(LARGEST, LARGEST, E, H)
    assert_allclose(state.force, np.pi * LARGEST**2 * H)
    assert_allclose(state.displacement, sunk(0.0))


@pytest.mark.parametrize("work", [1e-4, 0.02, 3.0])
def test_pull_off_is_the_largest_tension_of_the_unloading(work):
    state = elastic_plastic.pull_off(LARGEST, E, H, work)
    found = minimize_scalar(
        lambda a: elastic_plastic.unloading(a, LARGEST, E, H, work).force,
        bounds=(1e-6 * LARGEST, LARGEST),
        method="bounded",
        options={"xatol": 1e-10},
    )
    assert_allclose(state.force, found.fun, rtol=1e-9)
    assert_allclose(state.contact_radius, found.x, rtol=1e-4)


def test_a_large_contact_is_pulled_off_as_a_flatter_sphere_and_a_small_one_as_a_punch():
    large = elastic_plastic.pull_off(1e9, E, H, 0.1)
    assert_allclose(large.force, jkr.pull_off(E * 1e9 / H, E, 0.1).force, rtol=1e-4)
    small = elastic_plastic.pull_off(1e-6, E, H, 0.1)
    assert_allclose(small.force, -np.sqrt(8 * np.pi * 0.1 * E * 1e-18), rtol=1e-2)


@pytest.mark.parametrize("hardness", [0.02, 0.05, 0.3])
def test_area_fractions_are_those_of_a_diffusion_that_ends_at_zero_and_at_the_hardness(hardness):
    slope, pressure, cells = 0.1, 0.3 * hardness, 600
    deviation = E * slope / 2
    width = hardness / cells
    # The mean pressure lies on a point, each of whose neighbours takes a half.
    start = np.zeros(cells - 1)
    start[round(pressure / width) - 1] = 1
    rates = np.eye(cells - 1, k=1) + np.eye(cells - 1, k=-1) - 2 * np.eye(cells - 1)
    density = expm(rates * (deviation / width) ** 2 / 2) @ start
    elastic, yielding = elastic_plastic.area_fractions(pressure, slope, E, hardness)
    assert_allclose(elastic, density.sum(), atol=1e-4)
    # The load is borne by what is in contact.
    borne = density @ (width * np.arange(1, cells)) + hardness * yielding
    assert_allclose(borne, pressure, rtol=1e-4)


def test_a_hard_surface_is_in_elastic_contact_and_a_soft_one_bears_its_hardness():
    elastic, yielding = elastic_plastic.area_fractions(0.01, 0.1, 1.0, 10.0)
    assert_allclose(elastic, erf(np.sqrt(2) * 0.01 / 0.1))
    assert yielding == 0
    elastic, yielding = elastic_plastic.area_fractions([1e-4, 9e-4], 0.1, 1.0, 1e-3)
    assert_allclose(yielding, [0.1, 0.9])
    assert_allclose(elastic, 0, atol=1e-12)


def test_conductance_fits_the_circular_spots_of_a_gaussian_surface_cut_at_its_height():
    # Cooper, Mikic & Yovanovich: the area fraction is half of erfc, and a spot conducts less by
    # (1 - sqrt(area fraction))^1.5 than in the middle of a large tube; Yovanovich fits it to 1.5 %.
    fractions = np.geomspace(1e-6, 2.3e-2, 30)
    level = erfcinv(2 * fractions)
    spots = np.exp(-(level**2)) / (2 * np.sqrt(2 * np.pi)) / (1 - np.sqrt(fractions)) ** 1.5
    found = elastic_plastic.conductance(fractions * 1e9, 1e9, 1e-6, 0.1, 200.0)
    assert_allclose(found, 200.0 * 0.1 / 1e-6 * spots, rtol=0.016)
