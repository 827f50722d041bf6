"""Quantities at ranges that a grid does not resolve, beside closed forms and finer grids."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.references import jkr, johnson, maugis

# Its grid resolves all ranges here.
FLAT = js.Contact(js.HalfSpace(js.Grid((8,)), 1e5), jnp.zeros(8), js.potentials.Gaussian(0.1, 0.1))


def pull_off(contact):
    return js.pull_off(contact).load.value


@pytest.mark.parametrize("power", [-0.5, 0.5, 1.0, 2.3])
@pytest.mark.parametrize("ranges", [[2, 1, 3], [1, 1.3, 2, 2.5, 4]])
def test_a_power_law_is_found_with_its_power(power, ranges):
    def law(contact):
        return 3 - 0.01 * contact.potential.length**power

    found = js.extrapolate(law, FLAT, ranges=ranges)
    np.testing.assert_allclose(found.value, 3 - 0.01 * 0.1**power, rtol=1e-12)
    np.testing.assert_allclose(found.power, power, rtol=1e-9)
    np.testing.assert_array_equal(found.ranges, np.sort(ranges))
    assert found.range == FLAT.potential.length
    if power > 0:
        np.testing.assert_allclose(js.extrapolate(law, FLAT, ranges=ranges, to=0).value, 3)
    else:
        with pytest.raises(
            js.exceptions.SolverError, match=r"go on with the power -0.5 .* no limit at the"
        ):
            js.extrapolate(law, FLAT, ranges=ranges, to=0)


@pytest.mark.parametrize("shortest", [0.05, 0.07, 0.1])
def test_a_sphere_comes_to_jkr_within_a_percent(shortest):
    sphere = 1.0, 1.0, 0.1

    def force(contact):
        return maugis.pull_off(*sphere, 0.1 / float(contact.potential.length)).force

    expected = jkr.pull_off(*sphere).force
    found = js.extrapolate(force, FLAT, ranges=shortest * 1.3 ** np.arange(4), to=0)
    assert found.values[-1] / expected > 1.01
    np.testing.assert_allclose(found.value, expected, rtol=1e-2)
    assert abs(found.value - expected) < found.error
    assert 1.5 < found.power < 2.1


@pytest.mark.nightly
def test_johnsons_wave_comes_to_his_pull_off_within_a_percent():
    wave = 0.01, 1.0, 1.0, 8e-5
    grid = js.Grid((256,), (1.0,))
    heights = wave[0] * (np.cos(2 * np.pi * np.arange(256) / 256) - 1)
    law = js.potentials.Gaussian(wave[3], 1e-4)
    contact = js.Contact(js.HalfSpace(grid, wave[2]), jnp.asarray(heights), law)
    expected = johnson.pull_off(*wave).mean_pressure
    found = js.extrapolate(pull_off, contact, to=0)
    np.testing.assert_allclose(found.resolutions[0], 8)
    assert found.values[0] / expected < 0.98
    np.testing.assert_allclose(found.value, expected, rtol=1e-2)
    assert abs(found.value - expected) < found.error < 0.06 * abs(expected)


def from_the_coarser_of_two_grids(grids, seed, work):
    """Return the extrapolation from the coarser grid, and the pull-off on the finer one."""
    coarse, fine = (
        js.Contact(
            js.HalfSpace(grid, 1.0),
            js.surfaces.self_affine(grid, jax.random.key(seed), k_high=4, rms_height=0.02),
            js.potentials.Gaussian(work, 1.0),
        )
        for grid in grids
    )
    shortest = js.resolved_range(fine, 8)
    found = js.extrapolate(pull_off, coarse, to=shortest)
    law = js.potentials.Gaussian(work, shortest)
    return found, pull_off(js.Contact(fine.solid, fine.heights, law))


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [1, 2])
def test_a_rough_line_meets_a_grid_twice_as_fine(seed):
    lines = js.Grid((128,), (1.0,)), js.Grid((256,), (1.0,))
    found, expected = from_the_coarser_of_two_grids(lines, seed, 1e-4)
    assert abs(found.value - expected) < found.error < 0.05 * abs(expected)
    assert abs(found.values[0] - expected) > 2 * found.error


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_rough_surface_meets_a_grid_twice_as_fine(seed):
    found, expected = from_the_coarser_of_two_grids((js.Grid(64), js.Grid(128)), seed, 4e-3)
    assert abs(found.value - expected) < found.error < 0.1 * abs(expected)
    assert abs(found.value - expected) < abs(found.values[0] - expected)


def test_the_error_is_at_least_the_distance_from_a_straight_line():
    # The grid resolves the ranges, and the power is the same everywhere.
    def law(contact):
        return 3 - 0.01 * contact.potential.length**2

    found = js.extrapolate(law, FLAT, ranges=[1, 1.5, 2, 3], to=0)
    np.testing.assert_allclose(found.value, 3)
    np.testing.assert_allclose(found.error, 0.01 * 1.5, rtol=1e-3)


@pytest.mark.parametrize(("target", "continued"), [(0.5**0.5, 0.5), (0.8, 0.36), (0.0, 1.0)])
def test_an_extrapolation_that_a_shorter_range_belies_has_a_larger_error(target, continued):
    # From the shortest range on the quantity falls less steeply: 3 - r^2 / 100 up to there.
    def law(kink, contact):
        length = float(contact.potential.length)
        return 3 - 0.01 * length**2 if length >= 1 else 2.99 - kink * (1 - length**2)

    errors = []
    for kink in (-0.01, 0.03):
        found = js.extrapolate(partial(law, kink), FLAT, ranges=[1, 1.5, 2, 3], to=target)
        np.testing.assert_allclose(found.value, 3 - 0.01 * target**2)
        errors.append(float(found.error))
    # The trial is missed by 0.04 of the change to there.
    np.testing.assert_allclose(errors[1] - errors[0], 0.04 * continued, rtol=1e-3)


def test_within_its_ranges_an_extrapolation_needs_no_trial():
    lengths = []

    def law(contact):
        lengths.append(float(contact.potential.length))
        return lengths[-1] ** 2

    js.extrapolate(law, FLAT, ranges=[1, 2, 3], to=1)
    assert sorted(lengths) == [1, 2, 3]
    js.extrapolate(law, FLAT, ranges=[1, 2, 3], to=0.9)
    np.testing.assert_allclose(lengths[3:], [1, 2, 3, 0.9])


def test_a_limit_is_told_where_only_the_longest_ranges_rise_with_a_low_power():
    # Pull-offs of a sphere on 128² points, over that of Johnson, Kendall and Roberts.
    values = iter([1.04721, 1.06602, 1.08812, 1.11116, 1.0312])
    found = js.extrapolate(lambda contact: next(values), FLAT, to=0)
    np.testing.assert_allclose(found.value, 1, atol=0.02)
    assert abs(found.value - 1) < found.error < 0.26


def test_a_quantity_without_an_effect_of_the_range_has_no_power():
    found = js.extrapolate(lambda contact: 2.0, FLAT, to=0)
    assert found.value == 2 and np.isnan(found.power)
    # The error of the grid is left: 20 % over the square of the resolution.
    np.testing.assert_allclose(found.error, 2 * 0.2 / 8**2, rtol=1e-6)


def test_an_extrapolation_prints_a_line_for_each_range():
    found = js.extrapolate(lambda c: 1 + c.potential.length**2, FLAT, ranges=[0.1, 0.2, 0.3], to=0)
    head, columns, _, *rows = repr(found).splitlines()
    assert head.startswith("Extrapolation: 1 ± ") and head.endswith("with the power 2")
    assert columns.split() == ["range", "resolution", "value"] and len(rows) == 3


def test_what_tells_of_no_limit_is_refused_with_the_cure():
    for waving in ([1.0, 1.2, 1.1, 1.3, 1.0], [1.0, 1.2, 1.2, 1.3, 1.0]):
        given = partial(next, iter(waving))
        with pytest.raises(js.exceptions.SolverError, match=r"rise and fall.*finer grid"):
            js.extrapolate(lambda contact, given=given: given(), FLAT, to=0)
    # As of a rough contact of 48² points.
    for jumping in ([1.27, 2.53, 2.6, 2.61, 1.2], [1.0, 1.01, 2.0, 2.1, 1.0]):
        given = partial(next, iter(jumping))
        with pytest.raises(
            js.exceptions.SolverError, match="follow no power of the range from -2 to 6"
        ):
            js.extrapolate(lambda contact, given=given: given(), FLAT, to=1e-4)
    shortest = js.resolved_range(FLAT, 8)
    falling = iter([0.79e-4, 1.59e-4, 2.4e-4, 3.15e-4, 0.4e-4])
    with pytest.raises(js.exceptions.SolverError, match=r"change so much.*above 25 % of the first"):
        js.extrapolate(lambda contact: next(falling), FLAT, to=0.7 * shortest)
    with pytest.raises(js.exceptions.SolverError, match=r"nan.*must be finite"):
        js.extrapolate(lambda contact: np.nan, FLAT, to=0)
    with pytest.raises(ValueError, match=r"function returns has shape \(2,\): give one number"):
        js.extrapolate(lambda contact: np.ones(2), FLAT, to=0)


def test_ranges_that_cannot_be_are_refused_with_the_cure():
    def length(contact):
        return contact.potential.length

    for bad in ([0.1, 0.2], [0.1, 0.1, 0.2]):
        with pytest.raises(ValueError, match=r"The ranges.*give 3 different ones or more"):
            js.extrapolate(length, FLAT, ranges=bad)
    for bad in ([-0.1, 0.2, 0.3], [0.1, 0.2, 0.3, 0.3], [0.1, 0.2, np.inf]):
        with pytest.raises(ValueError, match="must be positive, finite and different"):
            js.extrapolate(length, FLAT, ranges=bad)
    with pytest.raises(ValueError, match=r"longest that is computed is 0.3, give `ranges` up"):
        js.extrapolate(length, FLAT, ranges=[0.1, 0.2, 0.3], to=0.4)
    with pytest.raises(ValueError, match=r"range is -1.0: it must be finite and not negative"):
        js.extrapolate(length, FLAT, to=-1.0)
    own = js.Contact(FLAT.solid, FLAT.heights, lambda gap: -jnp.exp(-gap))
    with pytest.raises(TypeError, match="without one range"):
        js.extrapolate(length, own, to=0)
    with pytest.raises(TypeError, match="extrapolate works on known numbers"):
        jax.jit(lambda to: js.extrapolate(length, FLAT, to=to).value)(0.0)


def of_window(side, law, modulus=1.0, depth=2.0, points=16):
    """Return a paraboloid whose edges are so far below its summit."""
    grid = js.Grid(points, side)
    # The last point lies a step before the end of the period.
    heights = js.surfaces.paraboloid(grid, (side / 2 - side / points) ** 2 / (2 * depth))
    return js.Contact(js.FreeHalfSpace(grid, modulus), heights, law)


@pytest.mark.parametrize("law", [js.potentials.Exponential, js.potentials.Gaussian])
@pytest.mark.parametrize("ranges", [None, [10.0, 13.0, 17.0]])
def test_a_window_that_the_longest_range_outgrows_is_named_before_anything_is_computed(law, ranges):
    contact = of_window(1000.0, law(0.1, 0.3))

    def computed(contact):
        raise AssertionError

    with pytest.raises(ValueError, match=r"edges of the window lie only 2 below .*larger window"):
        js.extrapolate(computed, contact, ranges=ranges)


def test_a_window_within_which_all_laws_end_is_extrapolated():
    # f' of an exponential law has fallen to one percent at 4.6 ranges.
    contact = of_window(1000.0, js.potentials.Exponential(0.1, 0.3), modulus=1e8)

    def law(contact):
        return contact.potential.length**2

    for length, fits in ((2 / 4.8, True), (2 / 4.4, False)):
        ranges = length * np.array([0.8, 0.9, 1.0])
        if fits:
            found = js.extrapolate(law, contact, ranges=ranges)
            np.testing.assert_allclose(found.value, 0.3**2, rtol=1e-6)
        else:
            with pytest.raises(ValueError, match="edges of the window"):
                js.extrapolate(law, contact, ranges=ranges)
    # The edges of a flat surface are within reach of any law.
    flat = js.Contact(contact.solid, jnp.zeros(contact.grid.shape), contact.potential)
    np.testing.assert_allclose(
        js.extrapolate(law, flat, ranges=[1, 2, 3], to=1).value, 1, rtol=1e-6
    )
