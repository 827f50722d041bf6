"""Conductance: discs, strips, dense algebra, transformations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import state_of
from programs import compilations

import jaxstab as js

NONE = js.potentials.NoAdhesion()


def touching(mask, kind=js.HalfSpace, lengths=1.0, dtype=jnp.float64, modulus=2.0):
    """Return a contact on a solid, and a state that touches where a mask is."""
    mask = jnp.asarray(mask)
    grid = js.Grid(mask.shape, lengths)
    zeros = jnp.zeros(mask.shape, dtype)
    contact = js.Contact(js.HalfSpace(grid, modulus), zeros, NONE)
    _, state = state_of(contact, jnp.where(mask, 0, zeros + 1))
    return js.Contact(kind(grid, modulus), zeros, NONE), state


def disc(n, radius):
    x, y = js.Grid(n).coordinates
    return (x - 0.5) ** 2 + (y - 0.5) ** 2 < radius**2


@pytest.mark.nightly
def test_a_disc_conducts_as_holm_says():
    radius, errors = 0.3, []
    for n in (64, 256):
        found = js.conductance(*touching(disc(n, radius), js.FreeHalfSpace), (1.0, 2.0))
        errors.append(abs(found.conductance / (4 * radius / 3) - 1))
    assert errors[1] < errors[0] < 1e-2
    assert errors[1] < 2.5e-3


def test_it_is_one_program():
    contact, state = touching(disc(8, 0.3))
    with compilations() as compiled:
        js.conductance(contact, state)
    assert compiled == ["jit(_conductance)"]


@pytest.mark.parametrize(
    "dtype", [pytest.param(jnp.float32, marks=pytest.mark.nightly), jnp.float64]
)
def test_periodic_strips_constrict_as_westergaard_says(dtype):
    errors = []
    for n in (64, 256):
        mask = jnp.arange(n) < n // 4
        found = js.conductance(*touching(mask, lengths=3.0, dtype=dtype), (1.0, 2.0))
        exact = np.pi / (2 * np.log(1 / np.sin(np.pi / 8)))
        errors.append(abs(2 / 3 * exact / found.conductance - 1))
    assert errors[1] < 0.3 * errors[0]
    assert errors[1] < 1e-2


@pytest.mark.parametrize("kind", [js.HalfSpace, js.FreeHalfSpace])
@pytest.mark.parametrize("shape", [(6, 5), (12,)])
def test_the_stiffness_is_that_of_dense_algebra(kind, shape):
    mask = np.random.default_rng(3).uniform(size=shape) < 0.4
    contact, state = touching(mask, kind, lengths=1.7)
    found = js.conductance(contact, state, (0.0, 0.3))
    unit = jnp.eye(mask.size).reshape(-1, *shape)
    columns = np.asarray(jax.vmap(contact.solid.displacement)(unit)).reshape(mask.size, -1)
    places = np.flatnonzero(mask)
    pressure = np.linalg.solve(columns[np.ix_(places, places)], np.ones(places.size))
    stiffness = pressure.sum() * float(contact.grid.cell_area)
    np.testing.assert_allclose(found.incremental_stiffness, stiffness, rtol=1e-8)
    np.testing.assert_allclose(found.conductance, 2 * stiffness / (2.0 * 0.3), rtol=1e-8)
    np.testing.assert_allclose(found.current[mask], pressure / pressure.sum(), rtol=1e-6)
    assert not found.current[~mask].any()
    soft = js.Contact(js.Viscoelastic(contact.solid, (1.0,), (1.0,)), contact.heights, NONE)
    relaxed = js.conductance(soft, state)
    np.testing.assert_allclose(relaxed.incremental_stiffness, stiffness, rtol=1e-8)


def test_without_contact_nothing_flows_and_in_full_contact_nothing_constricts():
    none = js.conductance(*touching(np.zeros((4, 4), bool)), (1.0, 1.0))
    assert none.conductance == none.incremental_stiffness == 0
    assert not none.current.any()
    full = js.conductance(*touching(np.ones((4, 4), bool)), (1.0, 1.0))
    assert full.conductance == full.incremental_stiffness == np.inf
    np.testing.assert_allclose(full.current, 1 / 16)
    window = js.conductance(*touching(np.ones((4, 4), bool), js.FreeHalfSpace), (1.0, 1.0))
    assert 0 < window.conductance < np.inf


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("kind", [js.HalfSpace, js.FreeHalfSpace])
def test_any_unit_of_length_gives_the_same(dtype, kind):
    mask = disc(16, 0.3)
    one = js.conductance(*touching(mask, kind, 1.0, dtype), (1.0, 1.0))
    assert one.conductance.dtype == dtype
    small = js.conductance(*touching(mask, kind, 1e-9, dtype, modulus=2e12), (1e-3, 1e-3))
    rtol = {jnp.float32: 1e-4, jnp.float64: 1e-10}[dtype]
    np.testing.assert_allclose(small.conductance, 1e-6 * one.conductance, rtol=rtol)
    large = js.conductance(*touching(mask, kind, 1e3, dtype), (1.0, 1.0))
    for found in (one, small, large):
        np.testing.assert_allclose(jnp.sum(found.current), 1, rtol=rtol)


@pytest.mark.nightly
def test_it_runs_in_programs_batches_and_derivatives():
    contact, state = touching(disc(16, 0.3))

    def of(rho, length=1.0, state=state):
        solid = js.HalfSpace(js.Grid(16, length), 2.0)
        return js.conductance(js.Contact(solid, contact.heights, NONE), state, (rho, 1.0))

    plain = of(2.0).conductance
    np.testing.assert_allclose(jax.jit(of)(2.0).conductance, plain, rtol=1e-9)
    # In one program: by a resistivity it falls, by the length it grows in proportion.
    slopes = jax.jit(jax.grad(lambda x, length: of(x, length).conductance, (0, 1)))(2.0, 1.0)
    np.testing.assert_allclose(slopes[0], -plain / 3, rtol=1e-9)
    np.testing.assert_allclose(slopes[1], plain, rtol=1e-6)
    _, other = touching(disc(16, 0.2))
    both = jax.tree.map(lambda *x: jnp.stack(x), state, other)
    found = jax.jit(jax.vmap(lambda state: of(2.0, state=state)))(both)
    np.testing.assert_allclose(found.conductance[0], plain, rtol=1e-9)
    assert len(found) == 2
    assert found[1].conductance < plain


def test_what_cannot_be_done_is_said():
    contact, state = touching(disc(8, 0.3))
    layer = js.Contact(js.Layer(contact.grid, 1.0, 0.3, 0.1), contact.heights, NONE)
    with pytest.raises(TypeError, match="Layer is a solid in which displacements do not spread"):
        js.conductance(layer, state, (1.0, 1.0))
    for rho, sentence in [
        ((1.0,), r"resistivities are \(1\.0,\): give two"),
        (3.0, r"resistivities are 3\.0: give two"),
        ((-1.0, 2.0), r"A resistivity is -1\.0: it must be finite and not negative"),
        ((0.0, 0.0), r"sum of the resistivities is 0\.0: one must be positive"),
    ]:
        with pytest.raises(ValueError, match=sentence):
            js.conductance(contact, state, rho)


def test_a_state_that_was_not_found_has_no_observables():
    grid = js.Grid(8)
    contact = js.Contact(js.HalfSpace(grid, 1.0), js.surfaces.paraboloid(grid, 2.0), NONE)
    gaps = jnp.array([0.02, -1.0])
    solve = jax.vmap(lambda gap: js.equilibrate(contact, js.MeanGap(gap), throw=False))
    states = jax.jit(solve)(gaps)
    for observable in (js.conductance, js.patches, js.leakage):
        with pytest.raises(ValueError, match=r"not found \(infeasible_load\)"):
            observable(contact, states[1])
    batch = jax.jit(jax.vmap(lambda state: js.conductance(contact, state)))(states)
    expected = js.conductance(contact, states[0]).conductance
    assert expected > 0
    np.testing.assert_allclose(batch.conductance, [expected, np.nan])
    assert np.isnan(batch.current[1]).all()
