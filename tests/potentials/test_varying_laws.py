"""Laws whose parameters vary over the surface."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js


@pytest.mark.nightly
def test_a_law_may_vary_from_nothing_on():
    kind = js.potentials.Exponential
    energies = jnp.where(jnp.arange(8) % 2 == 0, 0.02, 0.0) * jnp.ones((8, 1))
    law = js.potentials.Varying(kind(energies, 0.07))
    contact = js.Contact(js.HalfSpace(js.Grid(8), 1.0), jnp.zeros((8, 8)), law)
    state = js.equilibrate(contact, js.MeanGap(0.1))
    waves = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(8, 1 / 8)]))
    elastic = np.fft.ifft2(np.pi * waves * np.fft.fft2(state.displacement)).real
    attraction = np.stack(
        [
            jax.vmap(jax.grad(kind(energy, 0.07)))(gaps)
            for energy, gaps in zip(energies[0], state.gap.T, strict=True)
        ]
    ).T
    assert (attraction[:, 1::2] == 0).all()
    np.testing.assert_allclose(elastic + state.mean_pressure + attraction, 0, atol=1e-9)


def varying(energies):
    grid = js.Grid((24, 16), (1.0, 0.8))
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=7, rms_height=0.1)
    law = js.potentials.Varying(js.potentials.Exponential(energies, 0.2))
    return js.Contact(js.HalfSpace(grid, 0.05), heights, law)


def stripes():
    x, _ = js.Grid((24, 16)).coordinates
    return 0.01 + 0.008 * jnp.cos(4 * jnp.pi * x)


@pytest.mark.nightly
def test_a_law_that_varies_balances_at_every_point_by_its_own_parameters():
    energies = stripes()
    contact = varying(energies)
    state = js.equilibrate(contact, js.MeanGap(0.12))
    n, m = contact.grid.shape
    waves = np.hypot(np.fft.fftfreq(n, 1 / n)[:, None], np.fft.fftfreq(m, 0.8 / m))
    elastic = np.fft.ifft2(0.05 * np.pi * waves * np.fft.fft2(state.displacement)).real
    net = elastic + float(state.mean_pressure) + energies / 0.2 * np.exp(-state.gap / 0.2)
    assert state.in_contact.any() and not state.in_contact.all()
    assert np.abs(np.where(state.in_contact, np.minimum(net, 0), net)).max() < 1e-8 * 0.09
    # The stickiest point has the largest curvature.
    stiffest = contact.solid.max_stiffness
    expected = stiffest / (energies.max() / 0.2**2)
    np.testing.assert_allclose(contact.resolution, expected, rtol=1e-6)


@pytest.mark.nightly
def test_a_law_that_varies_has_a_derivative_by_each_of_its_numbers():
    def pressure(energies):
        return js.equilibrate(varying(energies), js.MeanGap(0.12)).mean_pressure

    energies = stripes()
    move = 1e-7 * jax.random.normal(jax.random.key(1), energies.shape)
    slope = jnp.sum(jax.jit(jax.grad(pressure))(energies) * move)
    difference = (pressure(energies + move) - pressure(energies - move)) / 2
    np.testing.assert_allclose(slope, difference, rtol=1e-4)
    batch = jax.vmap(pressure)(jnp.stack([energies, energies + move]))
    np.testing.assert_allclose(batch, [pressure(energies), pressure(energies + move)], rtol=1e-9)


def test_a_law_that_varies_over_other_points_is_refused():
    with pytest.raises(ValueError, match=r"varies has shape \(4, 16\), the grid"):
        varying(jnp.full((4, 16), 0.01))
    law = js.potentials.Varying(js.potentials.Exponential(stripes(), 0.2))
    with pytest.raises(ValueError, match=r"shape \(24, 16\), but the gaps have shape \(5,\)"):
        js.plots.force(law, jnp.linspace(0, 1, 5))
    np.testing.assert_allclose(law(0.0), -0.01)


def test_a_function_cannot_vary_and_says_so():
    field = jnp.full((8, 8), 0.03)
    with pytest.raises(TypeError, match="A function has no parameters that can vary"):
        js.potentials.Varying(lambda gap: -field * jnp.exp(-gap))


class WithAnother(eqx.Module):
    first: Callable
    second: Callable

    def __call__(self, gap):
        return self.first(gap) + self.second(gap)


def test_a_law_that_hides_that_it_varies_is_refused_and_one_that_shows_it_is_not():
    law = js.potentials.Varying(js.potentials.Exponential(stripes(), 0.2))
    grid = js.Grid((24, 16))
    flat = jnp.zeros(grid.shape)

    def contact(potential):
        return js.Contact(js.HalfSpace(grid, 0.05), flat, potential)

    for hidden in (lambda gap: law(gap), WithAnother(law, lambda gap: -1e-3 * jnp.exp(-gap))):
        with pytest.raises(ValueError, match="would be its mean everywhere: make all of it one"):
            contact(hidden)
    shown = contact(WithAnother(law, js.potentials.Exponential(1e-3, 1.0)))
    expected = -np.mean(stripes() * np.exp(-0.5) + 1e-3 * np.exp(-0.1))
    np.testing.assert_allclose(shown.energy(jnp.full(grid.shape, 0.1)), expected)
