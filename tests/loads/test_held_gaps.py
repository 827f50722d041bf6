"""A held mean gap: where a solve starts, in closed form."""

import jax.numpy as jnp
import numpy as np

import jaxstab as js


def test_it_starts_from_a_flat_solid_at_the_mean_gap():
    heights = 0.5 + jnp.outer(jnp.cos(jnp.arange(8) * jnp.pi / 4), jnp.ones(8))
    contact = js.Contact(js.HalfSpace(js.Grid(8), 1.0), heights, js.potentials.NoAdhesion())
    start = contact.control(js.MeanGap(0.3)).starting_gap(heights)
    np.testing.assert_allclose(jnp.mean(start), 0.3)
    np.testing.assert_allclose(start + heights, 0.3 + jnp.mean(heights))
