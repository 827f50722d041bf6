"""Crystals, stacks and graded solids where the rest of the library takes a solid."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from depth_columns import barnett_lothe_stiffness, column_stiffness, isotropic, tensor_of

import jaxstab as js
from jaxstab.solids import Anisotropic, Crystal, Film, Graded, Layered

GRID = js.Grid((8, 6), (1.0, 2.0))
CUBIC = (3.0, 1.2, 1.5)
LAW = js.potentials.Exponential(0.002, 0.05)


def stack(base="rigid"):
    return Layered(GRID, [Film(Crystal(CUBIC), 0.05, slips=True), Film((1.0, 0.4), 0.1)], base)


SOLIDS = {
    "crystal": Anisotropic(GRID, CUBIC, ((0, 0, 1), (1, -1, 0), (1, 1, 0))),
    "stack": stack(),
    "stack on a crystal": stack(Crystal(CUBIC)),
    "graded": Graded(GRID, 1.0, 0.3, 0.1, 0.4),
}


@pytest.fixture(scope="module")
def heights():
    return js.surfaces.self_affine(GRID, jax.random.key(1), k_high=2, rms_height=0.02)


@pytest.mark.nightly
def test_the_effective_work_of_adhesion_counts_the_energy_of_each_wave():
    x, y = GRID.coordinates
    wave = 2 * np.pi * np.array([2.0, 0.5])
    amplitude = 0.01
    heights = amplitude * jnp.cos(wave[0] * x + wave[1] * y)
    layers = [(tensor_of(CUBIC), 0.05, True), (tensor_of(isotropic(1.0, 0.4)), 0.1, False)]
    axes = SOLIDS["crystal"].material.axes
    exact = {
        "crystal": barnett_lothe_stiffness(tensor_of(CUBIC, axes), wave),
        "stack": column_stiffness(layers, None, wave),
        "stack on a crystal": column_stiffness(layers, tensor_of(CUBIC), wave),
    }
    slopes = amplitude * np.linalg.norm(wave) * np.sin(np.arange(360) * np.pi / 180)
    area = np.mean(np.sqrt(1 + slopes**2))
    for name, stiffness in exact.items():
        found = js.surfaces.full_contact_energy(SOLIDS[name], heights)
        np.testing.assert_allclose(found, stiffness * amplitude**2 / 4, rtol=1e-6)
        effective = js.surfaces.effective_work_of_adhesion(SOLIDS[name], heights, 0.03)
        np.testing.assert_allclose(effective, 0.03 * area - found, rtol=1e-5)


def test_the_resolved_range_lies_between_those_of_the_softest_and_the_stiffest_direction(heights):
    def range_on(solid):
        return float(js.resolved_range(js.Contact(solid, heights, LAW)))

    crystal = SOLIDS["crystal"]
    ratios = 2 * crystal.waves.multiplier.ravel()[1:] / GRID.wavenumbers.ravel()[1:]
    low, high = sorted(range_on(js.HalfSpace(GRID, e)) for e in (ratios.min(), ratios.max()))
    assert low < range_on(crystal) < high
    alike = Anisotropic(GRID, isotropic(2.0, 0.3))
    np.testing.assert_allclose(range_on(alike), range_on(js.HalfSpace(GRID, 2.0, 0.3)), rtol=1e-9)


@pytest.mark.filterwarnings("ignore:fewer than 25 points")
def test_a_conductance_says_of_which_solids_it_is_known(heights):
    contact = js.Contact(SOLIDS["crystal"], heights, LAW)
    state = js.equilibrate(contact, js.MeanGap(0.02))
    with pytest.raises(TypeError, match=r"conductances are known for a HalfSpace"):
        js.conductance(contact, state)
    found = [
        js.conductance(js.Contact(js.HalfSpace(GRID, e), heights, LAW), state).conductance
        for e in (1.0, 7.0)
    ]
    assert found[0] > 0
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


def test_the_regime_of_a_sphere_takes_a_crystal_and_no_stack():
    crystal = SOLIDS["crystal"]
    regime = js.references.regime(1.0, crystal.contact_modulus, 0.01, 0.1)
    modulus = float(crystal.indentation.modulus)
    np.testing.assert_allclose(regime.tabor, (0.01**2 / modulus**2 / 0.1**3) ** (1 / 3))
    with pytest.raises(
        AttributeError, match=r"Layered has no contact modulus.*size of the contact"
    ):
        js.references.regime(1.0, SOLIDS["stack"].contact_modulus, 0.01, 0.1)


@pytest.mark.nightly
@pytest.mark.parametrize("name", SOLIDS)
def test_a_file_keeps_the_solid(name, heights, tmp_path):
    contact = js.Contact(SOLIDS[name], heights, LAW, unit="µm", pressure_unit="GPa")
    state = js.equilibrate(contact, js.MeanGap(0.02))
    found, same = js.load(js.save(tmp_path / "state.nc", contact, state))
    assert type(found.solid) is type(contact.solid)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(contact), strict=True):
        np.testing.assert_array_equal(one, other)
    again = js.equilibrate(found, js.MeanGap(0.02))
    np.testing.assert_array_equal(again.gap, state.gap)
    np.testing.assert_array_equal(same.gap, state.gap)


@pytest.mark.filterwarnings("ignore:state.nc holds values")
def test_a_function_of_wave_vectors_is_lost_in_a_file_and_said_to_be(heights, tmp_path):
    solid = js.solids.Spectral(GRID, lambda qx, qy: jnp.hypot(qx, 2 * qy))
    contact = js.Contact(solid, heights, LAW)
    state = js.equilibrate(contact, js.MeanGap(0.02))
    found, _ = js.load(js.save(tmp_path / "state.nc", contact, state))
    with pytest.raises(ValueError, match=r"holds values only, no formula.*build the contact anew"):
        js.equilibrate(found, js.MeanGap(0.02))


def test_every_wave_of_a_stack_relaxes_by_its_series():
    for solid in SOLIDS.values():
        aged = js.Viscoelastic(solid, (1.5, 0.5), (0.1, 1.0))
        np.testing.assert_allclose(aged.glassy.multiplier, 3 * solid.waves.multiplier, rtol=1e-12)
        young = js.Viscoelastic.from_moduli(solid, (0.5,), (1.0,))
        np.testing.assert_allclose(young.relaxed.multiplier, solid.waves.multiplier / 2)

    # A time for each thickness at once, and its derivative.
    def stiffness(thickness):
        return Layered(GRID, [Film(Crystal(CUBIC), thickness)], (1.0, 0.3)).waves.multiplier

    thicknesses = jnp.array([0.05, 0.2])
    both = jax.jit(jax.vmap(stiffness))(thicknesses)
    np.testing.assert_allclose(both[1], stiffness(0.2), rtol=1e-12)
    slope = jax.jit(jax.jacfwd(stiffness))(0.2)
    step = 1e-5
    difference = (stiffness(0.2 + step) - stiffness(0.2 - step)) / (2 * step)
    np.testing.assert_allclose(slope, difference, rtol=1e-6, atol=1e-6)
