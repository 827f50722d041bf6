"""Equilibria of surfaces that yield are among those that an enumeration of all sets finds."""

import jax
import numpy as np
import pytest
from brute_force import periodic_stiffness
from problems import TIGHT
from yielding_lines import Line, exponential, minima

import jaxstab as js


def check_problem(seed, largest):
    """Assert that the state found is a local minimum, judged as one; return whether it yields."""
    rng = np.random.default_rng(seed)
    size = rng.integers(3, largest + 1)
    heights = rng.normal(0, 0.1, size)
    energy, length = rng.uniform(0, 0.05), rng.uniform(0.1, 0.5)
    hardness = rng.uniform(0.1, 0.6)
    before = rng.exponential(0.05, size) * (rng.random(size) < 0.4)
    grid = js.Grid((size,), (1.0,))
    law = js.potentials.Exponential(energy, length)
    contact = js.Contact(js.HalfSpace(grid, 1.0), heights - before, law, hardness=hardness)
    stiffness = periodic_stiffness((size,), (1.0,), 1.0)
    problem = {"heights": heights, "hardness": hardness, "indentation": before}
    if seed % 2:
        pressure = rng.uniform(-0.2 * energy / length, 0.9 * hardness)
        load, condition = js.MeanPressure(pressure), {"mean_pressure": pressure}
    else:
        level = rng.uniform(-0.1, 0.1)
        load, condition = js.MeanDisplacement(level), {"mean_displacement": level}
    found = minima(Line(stiffness, law=exponential(energy, length), **problem, **condition))
    state = js.equilibrate(contact, load, TIGHT, throw=False)
    if state.result == "pulled_off":
        return False
    assert state.result == "successful"
    distances = [abs(other.w - np.asarray(state.signed_gap)).max() for other in found]
    assert min(distances) < 1e-9
    nearest = found[int(np.argmin(distances))]
    np.testing.assert_allclose(before + state.indentation, nearest.indentation, atol=1e-9)
    np.testing.assert_allclose(state.pressure, nearest.pressure, atol=1e-8)
    return bool(state.is_yielding.any())


def test_states_are_among_the_minima_of_all_sets():
    assert sum(check_problem(seed, largest=4) for seed in range(10)) > 3


@pytest.mark.nightly
def test_five_hundred_states_are_among_the_minima_of_all_sets():
    yields = 0
    for seed in range(1000, 1500):
        yields += check_problem(seed, largest=7)
        if seed % 100 == 0:
            jax.clear_caches()
    assert yields > 150
