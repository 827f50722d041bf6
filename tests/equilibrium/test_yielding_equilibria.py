"""Equilibria of surfaces that yield are among those that an enumeration of all sets finds."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness
from problems import TIGHT
from scipy.optimize import brentq
from yielding_lines import Line, exponential, lennard_jones, minima, minimum_at

import jaxstab as js


class Walled(eqx.Module):
    """A law from a smallest distance on, at which there is a wall."""

    law: js.potentials.Law
    distance: jax.Array

    def __call__(self, gap):
        return self.law(self.distance + gap)


def random_line(rng, largest, least_energy):
    """Return a rough line of some points, indented before, and the numbers of a law."""
    size = rng.integers(3, largest + 1)
    heights = rng.normal(0, 0.1, size)
    energy, length = rng.uniform(least_energy, 0.05), rng.uniform(0.1, 0.5)
    hardness = rng.uniform(0.1, 0.6)
    before = rng.exponential(0.05, size) * (rng.random(size) < 0.4)
    return {"heights": heights, "hardness": hardness, "indentation": before}, energy, length


def check_problem(seed, largest):
    """Hold a state found against all minima, and a law without a core."""
    rng = np.random.default_rng(seed)
    line, energy, length = random_line(rng, largest, 0)
    hardness = line["hardness"]
    law = js.potentials.Exponential(energy, length)
    contact = contact_on(line["heights"] - line["indentation"], law, hardness)
    line["law"] = exponential(energy, length)
    if seed % 2:
        load, condition = pressed(rng.uniform(-0.2 * energy / length, 0.9 * hardness))
    else:
        load, condition = displaced(rng.uniform(-0.1, 0.1))
    return check_state(contact, load, line | condition)


def check_core(seed, largest):
    """Hold a state of a law with a core, walled where it repels by the hardness, against all."""
    rng = np.random.default_rng(seed)
    line, energy, length = random_line(rng, largest, 0.002)
    hardness = line["hardness"]
    law = lennard_jones(energy, length)
    # By hardly less than the hardness, so that there is contact at the wall.
    wall = brentq(
        lambda gap: law.slope(gap) + (1 - 1e-9) * hardness, length / 5, length, xtol=1e-15
    )
    own = Walled(js.potentials.LennardJones(energy, length), jnp.array(wall))
    contact = contact_on(line["heights"] - line["indentation"] + wall, own, hardness)
    line["law"] = law
    if seed % 2:
        load, condition = pressed(rng.uniform(-0.2 * energy / length, 0.9 * hardness))
    else:
        load, condition = displaced(rng.uniform(-0.1, 0.1) + 0.8 * length)
    return check_state(contact, load, line | condition, wall)


def contact_on(heights, law, hardness):
    grid = js.Grid(heights.shape, (1.0,))
    return js.Contact(js.HalfSpace(grid, 1.0), heights, law, hardness=hardness)


def pressed(pressure):
    return js.MeanPressure(pressure), {"mean_pressure": pressure}


def displaced(level):
    return js.MeanDisplacement(level), {"mean_displacement": level}


def check_state(contact, load, line, wall=0.0):
    """Assert that the state found is a local minimum of a line; return whether it yields."""
    line = Line(periodic_stiffness(contact.grid.shape, (1.0,), 1.0), **line)
    found = minima(line)
    state = js.equilibrate(contact, load, TIGHT, throw=False)
    if state.result == "pulled_off":
        return False
    assert state.result == "successful"
    gap = np.asarray(state.signed_gap)
    if not found:
        # Searches on all sets have missed it, as one of a steep core in a hundred.
        found = [minimum_at(line, gap + wall, np.sign(gap))]
    distances = [abs(other.w - wall - gap).max() for other in found]
    assert min(distances) < 1e-9
    nearest = found[int(np.argmin(distances))]
    indentation = line.indentation + state.indentation
    np.testing.assert_allclose(indentation, nearest.indentation, atol=1e-9)
    np.testing.assert_allclose(state.pressure, nearest.pressure, atol=1e-8)
    return bool(state.is_yielding.any())


def test_states_are_among_the_minima_of_all_sets():
    assert sum(check_problem(seed, largest=4) for seed in range(10)) > 3


@pytest.mark.nightly
def test_states_of_a_walled_core_are_among_the_minima_of_the_core():
    assert sum(check_core(seed, largest=4) for seed in (0, 1, 2, 3, 4, 6)) > 2


def test_a_core_is_refused_with_the_cure():
    law = js.potentials.LennardJones(0.01, 0.1)
    with pytest.raises(ValueError, match=r"repels without bound.* lambda gap: law\(z0 \+ gap\)"):
        contact_on(np.zeros(3), law, 0.1)


@pytest.mark.nightly
def test_five_hundred_states_are_among_the_minima_of_all_sets():
    yields = 0
    for seed in range(1000, 1500):
        yields += check_problem(seed, largest=7)
        if seed % 100 == 0:
            jax.clear_caches()
    assert yields > 150


@pytest.mark.nightly
def test_two_hundred_states_of_walled_cores_are_among_the_minima_of_the_core():
    assert sum(check_core(seed, largest=6) for seed in range(2000, 2200)) > 50
