"""Solves in a batch against each alone, to the last bit: a script, which a test starts.

In a process of its own, for programs that are compiled as a user's are and not as the tests' are.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from descent import Descent
from problems import rough_contact

import jaxstab as js

jax.config.update("jax_enable_x64", True)


def assert_same(left, right):
    """Compare all but the histories, whose rounding may differ."""
    left, right = (replace(sweep.equilibrium, history=None) for sweep in (left, right))
    for a, b in zip(jax.tree.leaves(left), jax.tree.leaves(right), strict=True):
        np.testing.assert_array_equal(a, b)


def check_springs():
    """A vmapped solve agrees with a sweep."""
    contact = rough_contact(16, js.potentials.Exponential(0.01, 0.1))
    springs = js.Spring(jnp.linspace(0.0, 0.3, 4), 2.0)
    swept = js.sweep(contact, springs, stability=False)
    batch = jax.vmap(lambda load: js.equilibrate(contact, load, throw=False))(springs)
    np.testing.assert_array_equal(batch.gap, swept.equilibrium.gap)


def check_a_solver_of_ones_own():
    """A vmapped solve by it agrees with a sweep."""
    contact, solver = rough_contact(16, js.potentials.Exponential(0.01, 0.1)), Descent()
    loads = js.MeanGap(jnp.array([0.08, 0.1]))
    swept = js.sweep(contact, loads, equilibrium_solver=solver, stability=False)
    batch = jax.vmap(lambda load: js.equilibrate(contact, load, solver, throw=False))(loads)
    np.testing.assert_array_equal(batch.gap, swept.equilibrium.gap)


def check_an_accelerators_sweep():
    """All entries in one program, as on an accelerator, agree with each load alone."""
    contact = rough_contact(32, js.potentials.Exponential(1e-2, 1.0), youngs_modulus=1e-3)
    loads = js.MeanGap(jnp.linspace(1e-5, 2.0, 32)[:5])
    alone = js.sweep(contact, loads, stability=False)
    jax.default_backend = lambda: "gpu"
    together = js.sweep(contact, loads, stability=False)
    assert_same(together, alone)


if __name__ == "__main__":
    check_springs()
    check_a_solver_of_ones_own()
    check_an_accelerators_sweep()
