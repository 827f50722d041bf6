"""Laws against their formulae, and laws that are cut off, loop or branch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import flat_contact, lennard_jones_force

import jaxstab as js
from jaxstab.potentials import curvature, energy_density, slope

GAPS = jnp.linspace(0.0, 3.0, 25).reshape(5, 5)
# The laws f, f' and f'' are written out by hand, at gamma = 2, rho = 0.7.
CLOSED_FORMS = {
    js.potentials.Exponential: (
        lambda s: -2 * np.exp(-s),
        lambda s: 2 / 0.7 * np.exp(-s),
        lambda s: -2 / 0.7**2 * np.exp(-s),
    ),
    js.potentials.Gaussian: (
        lambda s: -2 * np.exp(-(s**2) / 2),
        lambda s: 2 / 0.7 * s * np.exp(-(s**2) / 2),
        lambda s: 2 / 0.7**2 * (1 - s**2) * np.exp(-(s**2) / 2),
    ),
    js.potentials.Rational: (
        lambda s: -2 / (1 + s**2),
        lambda s: 2 / 0.7 * 2 * s / (1 + s**2) ** 2,
        lambda s: 2 / 0.7**2 * (2 - 6 * s**2) / (1 + s**2) ** 3,
    ),
}


@pytest.mark.parametrize("law", CLOSED_FORMS)
def test_laws_and_their_derivatives_match_the_formulae_of_the_paper(law):
    potential = law(surface_energy=2.0, length=0.7)
    scaled = np.asarray(GAPS) / 0.7
    derivatives = (energy_density, slope, curvature)
    for derivative, formula in zip(derivatives, CLOSED_FORMS[law], strict=True):
        np.testing.assert_allclose(derivative(potential, GAPS), formula(scaled), atol=1e-12)


SEPARATIONS = np.linspace(0.5, 3.0, 26)


def test_lennard_jones_matches_its_formula_and_is_least_where_it_says():
    law = js.potentials.LennardJones(2.0, 0.7)
    x = 0.7 / SEPARATIONS
    np.testing.assert_allclose(energy_density(law, SEPARATIONS), x**9 - 3 * x**3)
    np.testing.assert_allclose(slope(law, SEPARATIONS), lennard_jones_force(SEPARATIONS, 2.0, 0.7))
    stiffness = 9 * (10 * x**11 - 4 * x**5) / 0.7**2
    np.testing.assert_allclose(curvature(law, SEPARATIONS), stiffness)
    assert law(0.7) == pytest.approx(-2.0)
    assert slope(law, jnp.array([0.7]))[0] == pytest.approx(0, abs=1e-12)
    assert law(0.0) == np.inf


@pytest.mark.parametrize("strength", [1e-9, 1e9])
@pytest.mark.parametrize("law", [*CLOSED_FORMS, js.potentials.Dugdale, js.potentials.LennardJones])
def test_the_range_and_the_core_of_a_law_do_not_depend_on_its_strength(law, strength):
    one = flat_contact(law(1.0, 0.1)).profile
    other = flat_contact(law(strength, 0.1)).profile
    np.testing.assert_allclose(other.range, one.range, rtol=1e-9)
    np.testing.assert_allclose(other.max_attraction, strength * one.max_attraction, rtol=1e-9)
    assert other.has_core == one.has_core == (law is js.potentials.LennardJones)


# Hamaker constants [J] and surface energies [J/m^2] of the table of Israelachvili (2011), chapter
# 13: octane, polystyrene, PTFE. The work of adhesion of a solid is twice its surface energy.
@pytest.mark.parametrize(
    ("constant", "energy"), [(4.5e-20, 0.0219), (6.6e-20, 0.0321), (3.8e-20, 0.0185)]
)
def test_hamaker_constants_give_the_published_surface_energies(constant, energy):
    law = js.potentials.LennardJones.from_hamaker(constant, 0.165e-9)
    assert law.surface_energy / 2 == pytest.approx(energy, rel=3e-3)
    assert law.length == 0.165e-9
    # In other units, and in single precision, it is the same: here nm and GPa, of 1e-18 J.
    other = js.potentials.LennardJones.from_hamaker(np.float32(constant / 1e-18), np.float32(0.165))
    assert other.surface_energy == pytest.approx(float(law.surface_energy), rel=1e-6)
    single = js.potentials.LennardJones.from_hamaker(*np.float32([constant, 0.165e-9]))
    assert single.surface_energy == pytest.approx(float(law.surface_energy), rel=1e-6)
    assert single.surface_energy.dtype == np.float32


def test_dugdales_attraction_is_even_up_to_its_range_and_then_gone():
    law = js.potentials.Dugdale(2.0, 0.7, smoothing=0.01)
    assert law(0.0) == pytest.approx(-2.0)
    assert law(2.0) == pytest.approx(0.0, abs=1e-12)
    attraction = slope(law, jnp.array([0.0, 0.35, 0.63, 0.7, 0.77]))
    expected = 2 / 0.7 * np.array([1, 1, 1, 0.5, 0])
    np.testing.assert_allclose(attraction, expected, atol=2e-4)
    edge = jnp.array([0.6, 0.7, 0.8])
    step = 1e-4
    difference = (slope(law, edge + step) - slope(law, edge - step)) / (2 * step)
    np.testing.assert_allclose(curvature(law, edge), difference, rtol=1e-3, atol=1e-6)


def test_no_adhesion_has_no_energy_force_or_curvature():
    for derivative in (energy_density, slope, curvature):
        assert not derivative(js.potentials.NoAdhesion(), GAPS).any()


def test_a_law_that_is_cut_off_is_zero_beyond_and_twice_differentiable():
    whole, radius = js.potentials.Exponential(0.02, 0.05), 0.2
    law = js.potentials.CutOff(whole, radius)
    near, far = jnp.linspace(0, radius / 2, 9), jnp.linspace(1.001 * radius, 1, 9)
    for derivative in (energy_density, slope, curvature):
        np.testing.assert_allclose(derivative(law, near), derivative(whole, near), rtol=1e-12)
        assert (derivative(law, far) == 0).all()
    gaps, step = jnp.linspace(0.09, 0.21, 50), 1e-6
    for lower, upper in ((energy_density, slope), (slope, curvature)):
        difference = (lower(law, gaps + step) - lower(law, gaps - step)) / (2 * step)
        np.testing.assert_allclose(upper(law, gaps), difference, atol=3e-5)
    # Below its end the formula is S(x) f, beyond it is not asked.
    x = 0.4
    switch = 1 - 10 * x**3 + 15 * x**4 - 6 * x**5
    np.testing.assert_allclose(law(0.14), switch * whole(0.14), rtol=1e-12)
    table = js.potentials.CutOff(lambda gap: jnp.where(gap > radius, jnp.nan, whole(gap)), radius)
    assert (slope(table, far) == 0).all()
    assert flat_contact(
        js.potentials.CutOff(js.potentials.LennardJones(0.002, 0.05), 0.12)
    ).has_core
    with pytest.raises(ValueError, match="radius of the cut-off is 0"):
        js.potentials.CutOff(whole, 0.0)
    with pytest.raises(ValueError, match=r"The law is 3: give a function"):
        js.potentials.CutOff(3, 1.0)
    with pytest.raises(ValueError, match=r"The law is <class .*Rational'>: give a function"):
        js.potentials.CutOff(js.potentials.Rational, 1.0)


def test_a_law_with_a_loop_has_its_derivatives():
    def law(gap):
        def further(state):
            return state[0] + 1, state[1] * jnp.exp(-gap / 0.6)

        return (
            -0.02 * jax.lax.while_loop(lambda state: state[0] < 3, further, (0, 1.0 + 0 * gap))[1]
        )

    looped, closed = flat_contact(law).potential, js.potentials.Exponential(0.02, 0.2)
    for derivative in (energy_density, slope, curvature):
        np.testing.assert_allclose(derivative(looped, GAPS), derivative(closed, GAPS), rtol=1e-9)


def test_a_potential_may_branch_on_the_scalar_gap():
    def law(gap):
        return jax.lax.cond(gap < 1, lambda g: -((1 - g) ** 3), lambda g: 0 * g, gap)

    np.testing.assert_allclose(energy_density(law, GAPS), -(np.maximum(1 - GAPS, 0) ** 3))
    np.testing.assert_allclose(curvature(law, GAPS), -6 * np.maximum(1 - GAPS, 0), atol=1e-12)


@pytest.mark.nightly
def test_derivatives_of_a_voltage_do_not_underflow_at_nanometres_in_metres():
    law = js.potentials.Electrostatic(0.2, 8.854e-12, 1e-10)
    gap, derivative = jnp.array(1e-10, jnp.float32), law
    for power in range(1, 5):
        expected = -8.854e-12 * 0.02 * np.prod(-np.arange(1.0, power)) / 2e-10**power
        np.testing.assert_allclose(derivative(gap), expected, rtol=1e-5)
        derivative = jax.grad(derivative)
    # The dielectric is as good as a gap.
    steps = jax.grad(lambda d: js.potentials.Electrostatic(0.2, 8.854e-12, d)(gap))
    np.testing.assert_allclose(steps(1e-10), jax.grad(law)(gap), rtol=1e-5)
