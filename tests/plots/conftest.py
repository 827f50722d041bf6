"""States that several tests draw."""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import pytest

import jaxstab as js


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


@pytest.fixture(scope="session")
def state(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.2))
    return hertz, equilibrium, js.assess_stability(hertz, equilibrium).cone


@pytest.fixture(scope="session")
def line_contact():
    grid = js.Grid((64,), (2.0,))
    heights = js.surfaces.sinusoid(grid, 0.1)
    return js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.NoAdhesion())


@pytest.fixture(scope="session")
def line(line_contact):
    contact = line_contact
    equilibrium = js.equilibrate(contact, js.MeanGap(0.05))
    return contact, equilibrium, js.assess_stability(contact, equilibrium).cone


@pytest.fixture(scope="session")
def sweep(hertz):
    return js.sweep(hertz, js.MeanDisplacement(jnp.array([1.2, 1.31, 1.4])))
