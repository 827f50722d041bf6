"""Newton's method for equilibria: against the minimiser, and where there is nothing to find."""

import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import check_optimality
from problems import rough_contact

import jaxstab as js

STRONG = js.potentials.Exponential(0.02, 0.1)


@pytest.mark.parametrize("factor", [0.9, 1.02, 1.3])
@pytest.mark.parametrize("mean_gap", [0.05, 0.1, 0.2])
def test_points_that_close_and_open_on_the_way_are_handled(mean_gap, factor):
    contact = rough_contact(32, STRONG)
    start = js.equilibrate(contact, js.MeanGap(mean_gap))
    load = js.MeanGap(factor * mean_gap)
    found = js.equilibrate(contact, load, js.solvers.SaddleNewton(), initial=start)
    minimum = js.equilibrate(contact, load, initial=start)
    assert (found.in_contact != start.in_contact).any()
    np.testing.assert_allclose(found.gap, minimum.gap, atol=1e-8)
    assert found.num_steps < minimum.num_steps


def test_it_works_under_a_pressure():
    contact = rough_contact(32, STRONG)
    start = js.equilibrate(contact, js.MeanGap(0.1))
    load = js.MeanPressure(1.01 * start.mean_pressure)
    found = js.equilibrate(contact, load, js.solvers.SaddleNewton(), initial=start)
    np.testing.assert_allclose(found.mean_pressure, load.value, rtol=1e-8)
    check_optimality(contact, found, 1e-8)


def test_where_there_is_no_equilibrium_it_fails_with_a_code(hertz):
    pulled = js.MeanPressure(-100.0)
    start = js.equilibrate(hertz, js.MeanDisplacement(1.2))
    found = js.equilibrate(hertz, pulled, js.solvers.SaddleNewton(), initial=start, throw=False)
    assert found.result != js.RESULTS.successful
    with pytest.raises(
        js.exceptions.SolverError, match=r"No equilibrium found.*MeanPressure\(-100\)"
    ):
        js.equilibrate(hertz, pulled, js.solvers.SaddleNewton(), initial=start)


@pytest.mark.nightly
def test_single_precision_finds_the_saddle_too(hertz):
    single = js.Contact(hertz.solid, hertz.heights.astype(jnp.float32), hertz.potential)
    load = js.MeanDisplacement(1.302)
    fold = js.equilibrate(hertz, js.MeanDisplacement(1.2976))
    stable = js.equilibrate(hertz, load)
    start = hertz.gap(2 * fold.displacement - stable.displacement)
    # Near the fold the state is soft: the default of 1e-4 would leave an error of 1e-3.
    found = js.equilibrate(single, load, js.solvers.SaddleNewton(tolerance=2e-5), initial=start)
    assert found.gap.dtype == jnp.float32
    exact = js.equilibrate(hertz, load, js.solvers.SaddleNewton(), initial=start)
    np.testing.assert_allclose(found.gap, exact.gap, atol=1e-3)
    stability = js.assess_stability(single, found)
    assert stability.verdict == js.VERDICTS.unstable
