"""Contacts and states that tests of files save, and the comparison with the loaded ones."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from problems import state_of

import jaxstab as js
from jaxstab.core.checked_netcdf import Content, read, write

SHAPE, LENGTHS = (16, 12), (1.0, 0.7)


class Bumpy(eqx.Module):
    """A law of one's own: with a list, a static part and a plain number."""

    depths: list
    length: jax.Array
    power: int = eqx.field(static=True)
    share: float = 0.5

    def __call__(self, gap):
        first, second = self.depths
        near = first * jnp.exp(-((gap / self.length) ** self.power))
        return -near - self.share * second * jnp.exp(-gap / self.length)


BUMPY = Bumpy([jnp.array(0.008), jnp.array(0.004)], jnp.array(0.2), 2)


def contact_of(potential, dtype=float):
    grid = js.Grid(SHAPE, jnp.array(LENGTHS, dtype))
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=5, rms_height=0.1)
    solid = js.HalfSpace(grid, jnp.array(0.05, dtype), jnp.array(0.3, dtype))
    return js.Contact(solid, heights.astype(dtype), potential)


def contact_and_state(potential, dtype=float):
    """Return a contact of any law and an equilibrium of it, found without a solver."""
    gap = jnp.linspace(0, 0.3, np.prod(SHAPE), dtype=dtype).reshape(SHAPE)
    return state_of(contact_of(potential, dtype), gap)


def assert_same_bits(one, other):
    leaves, structure = jax.tree.flatten(one)
    others, other_structure = jax.tree.flatten(other)
    assert structure == other_structure
    for x, y in zip(leaves, others, strict=True):
        x, y = np.asarray(x), np.asarray(y)
        assert (x.dtype, x.shape, x.tobytes()) == (y.dtype, y.shape, y.tobytes())


def rewrite(path, old, new, name="structure"):
    """Change an attribute of a file, the structure for one, as another program could; sign it."""
    variables, attrs = read(path, may_be_renamed=True)
    assert old in attrs[name]
    attrs[name] = attrs[name].replace(old, new)
    write(path, Content(variables, attrs), may_be_renamed=True)
