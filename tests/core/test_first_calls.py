"""First calls compile the programs of searches, and no single operation of `jax.numpy` beside."""

import jax.numpy as jnp
import numpy as np
import pytest
from programs import compilations, on_the_cpu

import jaxstab as js

NAMES = {*dir(jnp), *dir(jnp.ndarray), "select_n", "dynamic_slice", "broadcast_in_dim", "add_any"}
# Sizes of a grid that nothing before has asked for.
OWN = {"area", "cell_area", "spacing"}


@on_the_cpu
@pytest.mark.nightly
@pytest.mark.parametrize("call", ["continuation", "evolve", "follow"])
def test_a_first_call_compiles_no_single_operation(call):
    # A number of points of its own, for which nothing has been compiled before.
    grid = js.Grid((26,), (1.0,))
    heights = np.cos(2 * np.pi * np.arange(26) / 26) / 10
    law = js.potentials.Exponential(0.02, 0.1)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), np.array([1.0]), np.array([1.0]))
    contact = js.Contact(solid.relaxed, heights, law)
    viscous = js.Contact(solid, heights, law)
    load = js.MeanGap(np.array([0.3, 0.1]))
    calls = {
        "continuation": lambda: js.continuation(contact, load),
        "evolve": lambda: js.evolve(viscous, load, np.array([0.0, 1.0])),
        "follow": lambda: js.follow(contact, load),
    }
    with compilations() as compiled:
        calls[call]()
    names = {name.removeprefix("jit(").removesuffix(")").lstrip("_") for name in compiled}
    assert compiled
    assert names & NAMES <= OWN
