"""Derivatives of eigenvalues and modes: against finite differences, and where none exist."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from conftest import TIGHT, rough_contact, with_parameters

import jaxstab as js


@pytest.fixture(scope="module")
def contact():
    return rough_contact(16, js.potentials.Exponential(0.02, 0.1))


@pytest.mark.parametrize("load", [js.MeanGap(0.1), js.MeanPressure(0.05)])
def test_eigenvalues_modes_and_barrier_agree_with_finite_differences(contact, load):
    solver = js.ProjectedLOBPCG(tolerance=1e-11)

    @jax.jit
    def judge(x):
        held = eqx.tree_at(lambda load: load.value, load, x[3])
        other = with_parameters(contact, *x[:3])
        equilibrium = js.equilibrate(other, held, TIGHT, throw=False)
        found = js.assess_stability(other, equilibrium, solver, throw=False)
        values = {name: pair.eigenvalue for name, pair in found.pairs.items()}
        values["mode"] = jnp.sum(jnp.sin(jnp.arange(256.0)).reshape(16, 16) * found.cone.mode)
        values["complementarity"] = found.complementarity
        values["height"] = found.barrier.height
        return values, found

    x = jnp.array([0.06, 0.1, 1.0, load.value])
    values, found = judge(x)
    assert found.result == js.RESULTS.successful
    forward = jax.jit(jax.jacfwd(lambda x: judge(x)[0]))(x)
    reverse = jax.jit(jax.jacrev(lambda x: judge(x)[0]))(x)
    for i, h in enumerate(1e-4 * x):
        above, below = judge(x.at[i].add(h))[0], judge(x.at[i].add(-h))[0]
        for name, value in values.items():
            if jnp.isnan(value):
                assert found.verdict != js.VERDICTS.held_by_contact
                assert jnp.isnan(forward[name][i]) and jnp.isnan(reverse[name][i])
                continue
            differences = (above[name] - below[name]) / (2 * h)
            rtol = 1e-3 if name == "mode" else 1e-5
            size = abs(value) / x[i]
            assert abs(forward[name][i] - differences) < rtol * max(abs(differences), size), name
            assert abs(forward[name][i] - reverse[name][i]) < 1e-8 * size, name


def test_a_multiple_eigenvalue_is_told():
    grid = js.Grid(16)
    law = js.potentials.Exponential(1e-3, 1.0)
    flat = js.Contact(js.HalfSpace(grid, 1.0), jnp.zeros(grid.shape), law)

    def lowest(modulus, throw):
        other = js.Contact(js.HalfSpace(grid, modulus), flat.heights, flat.potential)
        equilibrium = js.equilibrate(other, js.MeanGap(1.0))
        return js.assess_stability(other, equilibrium, throw=throw).lower_bound.eigenvalue

    with pytest.raises(Exception, match="eigenvalue is multiple"):
        jax.grad(lambda modulus: lowest(modulus, throw=True))(1.0)
    assert jnp.isnan(jax.grad(lambda modulus: lowest(modulus, throw=False))(1.0))


def test_modes_of_a_block_refuse_to_be_differentiated(contact):
    equilibrium = js.equilibrate(contact, js.MeanGap(0.1))

    def eigenvalue(energy):
        other = with_parameters(contact, energy, 0.1, 1.0)
        return js.lowest_modes(other, equilibrium, 2, throw=False).eigenvalue[1]

    with pytest.raises(NotImplementedError, match="cannot be differentiated"):
        jax.jvp(eigenvalue, (0.02,), (1.0,))
