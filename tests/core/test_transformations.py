"""Everything public under plain `jax.jit` and `jax.vmap`, and without needless compilation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from programs import compilations

import jaxstab as js

LOAD = js.MeanGap(0.1)
ENERGIES = jnp.array([0.005, 0.01, 0.02])


@pytest.fixture(scope="module")
def solid():
    return js.HalfSpace(js.Grid(16), 1.0)


@pytest.fixture(scope="module")
def heights(solid):
    return js.surfaces.self_affine(solid.grid, jax.random.key(0), k_high=4, rms_height=0.1)


def named_law(energy):
    return js.potentials.Exponential(energy, 0.1)


def bare_law(energy):
    return lambda gap: -energy * jnp.exp(-gap / 0.1)


def solve(contact, load=LOAD):
    equilibrium = js.equilibrate(contact, load, throw=False)
    solver = js.ProximalIteration(tolerance=1e-5)
    return equilibrium, js.assess_stability(contact, equilibrium, solver, throw=False)


def check_solution(result, contact, load=LOAD):
    equilibrium, stability = result
    expected_equilibrium, expected_stability = solve(contact, load)
    assert expected_equilibrium.result == js.RESULTS.successful
    np.testing.assert_allclose(equilibrium.gap, expected_equilibrium.gap, atol=1e-9)
    expected = expected_stability.cone.eigenvalue
    np.testing.assert_allclose(stability.cone.eigenvalue, expected, rtol=1e-6)
    assert equilibrium.result == js.RESULTS.successful


def entry(tree, i):
    return jax.tree.map(lambda leaf: leaf[i], tree)


@pytest.mark.nightly
def test_surfaces_loads_and_moduli_can_be_vmapped(solid, heights):
    surfaces = jnp.stack([heights, heights[::-1], heights.T * 0.8])
    by_surface = jax.vmap(lambda h: solve(js.Contact(solid, h, named_law(0.01))))(surfaces)
    check_solution(entry(by_surface, 2), js.Contact(solid, surfaces[2], named_law(0.01)))

    contact = js.Contact(solid, heights, named_law(0.01))
    loads = js.MeanGap(jnp.array([0.05, 0.1, 0.2]))
    by_load = jax.vmap(solve, in_axes=(None, 0))(contact, loads)
    check_solution(entry(by_load, 0), contact, js.MeanGap(0.05))

    def with_modulus(modulus):
        stiff = js.HalfSpace(solid.grid, modulus, 0.3)
        return solve(js.Contact(stiff, heights, bare_law(0.01)))

    by_modulus = jax.vmap(with_modulus)(jnp.array([1.0, 2.0]))
    stiff = js.HalfSpace(solid.grid, 2.0, 0.3)
    check_solution(entry(by_modulus, 1), js.Contact(stiff, heights, named_law(0.01)))


@pytest.mark.nightly
def test_a_failed_entry_leaves_the_others_identical(solid, heights):
    contact = js.Contact(solid, heights, bare_law(0.01))
    solve = jax.jit(jax.vmap(lambda load: js.equilibrate(contact, load, throw=False)))
    good, bad = (solve(js.MeanGap(jnp.array([0.05, value, 0.2]))) for value in (0.1, -0.1))
    assert entry(bad, 1).result == js.RESULTS.infeasible_load
    alone = js.equilibrate(js.Contact(solid, heights, named_law(0.01)), LOAD)
    np.testing.assert_allclose(good.gap[1], alone.gap, atol=1e-9)
    for i in (0, 2):
        np.testing.assert_array_equal(bad.gap[i], good.gap[i])


@pytest.mark.nightly
@pytest.mark.parametrize("law", [named_law, bare_law])
def test_a_contact_is_an_argument_of_plain_jit_and_a_failed_entry_leaves_the_others_identical(
    solid, heights, law
):
    contact = js.Contact(solid, heights, law(0.01))
    good, bad = (js.MeanGap(jnp.array([0.05, value, 0.2])) for value in (0.1, -0.1))
    run = jax.jit(jax.vmap(solve, in_axes=(None, 0)))
    expected, (actual, stability) = run(contact, good), run(contact, bad)
    check_solution(entry(expected, 1), js.Contact(solid, heights, named_law(0.01)))
    assert entry(actual, 1).result == js.RESULTS.infeasible_load
    assert entry(stability, 1).cone.result == js.RESULTS.no_equilibrium
    for i in (0, 2):
        np.testing.assert_array_equal(actual.gap[i], expected[0].gap[i])


def test_throw_works_under_jit(solid, heights):
    contact = js.Contact(solid, heights, named_law(0.01))
    run = jax.jit(lambda value: js.equilibrate(contact, js.MeanGap(value)).mean_pressure)
    assert jnp.isfinite(run(0.1))
    with pytest.raises(Exception, match="infeasible_load"):
        run(-0.1).block_until_ready()


@pytest.mark.nightly
def test_new_values_compile_nothing_and_a_bare_function_compiles_once(solid, heights):
    def run(energy, modulus, load, tolerance):
        stiff = js.HalfSpace(solid.grid, modulus)
        contact = js.Contact(stiff, heights * load, named_law(energy))
        equilibrium = js.equilibrate(
            contact, js.MeanGap(load), js.solvers.PolonskyKeerRey(tolerance)
        )
        solver = js.ProximalIteration(tolerance, max_steps=50)
        js.assess_stability(contact, equilibrium, solver, throw=False)
        js.sweep(contact, js.MeanGap(load * jnp.ones(2)), stability_solver=solver)

    def pressure(law, gap):
        return js.equilibrate(js.Contact(solid, heights, law), js.MeanGap(gap)).mean_pressure

    run(0.01, 1.0, 0.1, 1e-6)
    bare = bare_law(0.01)
    with compilations() as compiled:
        found = pressure(bare, 0.1)
    assert any("_find" in name for name in compiled), compiled
    with compilations() as compiled:
        run(0.02, 2.0, 0.2, 1e-5)
        again = pressure(bare, 0.2)
    assert compiled == []
    expected = [pressure(named_law(0.01), gap) for gap in (0.1, 0.2)]
    np.testing.assert_allclose([found, again], expected, rtol=1e-9)


@pytest.mark.nightly
def test_a_bare_function_of_a_value_is_mapped_and_differentiated_by_it(solid, heights):
    def pressure(make, energy):
        return js.equilibrate(js.Contact(solid, heights, make(energy)), LOAD).mean_pressure

    rates = jax.jit(jax.vmap(jax.value_and_grad(lambda energy: pressure(bare_law, energy))))
    found = rates(ENERGIES[:2])
    expected = [pressure(named_law, energy) for energy in ENERGIES[:2]]
    np.testing.assert_allclose(found[0], expected, rtol=1e-7)
    sides = [pressure(named_law, energy) for energy in (0.00999, 0.01001)]
    np.testing.assert_allclose(found[1][1], (sides[1] - sides[0]) / 2e-5, rtol=1e-4)


@pytest.mark.nightly
def test_fields_that_need_no_solver_can_be_differentiated(heights):
    def energy(length):
        return js.HalfSpace(js.Grid(16, length), 1.0).energy(heights)

    # The energy of a given displacement grows with area over length.
    np.testing.assert_allclose(jax.grad(energy)(2.0), energy(1.0), rtol=1e-9)
