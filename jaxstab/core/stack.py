"""Stacks: the results of many solves in one pytree, along leading axes of its arrays."""

from collections.abc import Iterator, Sequence
from typing import Self, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from jaxstab.core.checks import concrete, is_readable, where_known

Entry = TypeVar("Entry")


class Stackable:
    """A pytree that is a sequence where its arrays have a leading axis, as after `jax.vmap`.

    At least one leaf of a single entry must be a scalar.
    """

    @property
    def stack_shape(self) -> tuple[int, ...]:
        """The leading axes that all arrays share: () for a single entry."""
        return min((np.shape(leaf) for leaf in jax.tree.leaves(self)), key=len, default=())

    def __len__(self) -> int:
        return self._leading_axes()[0]

    def __bool__(self) -> bool:
        # A single one is something; several are, like a list, unless they are none.
        return self.stack_shape == () or len(self) > 0

    def __getitem__(self, index: PyTree) -> Self:
        shape = self._leading_axes()
        if isinstance(index, list):
            index = np.asarray(index)
            if index.size == 0:
                # NumPy takes an empty list for one of floats.
                index = index.astype(int)
        _require_entry(shape, index)
        return jax.tree.map(lambda leaf: entry_at(leaf, index), self)

    def __iter__(self) -> Iterator[Self]:
        return (self[i] for i in range(len(self)))

    def _leading_axes(self) -> tuple[int, ...]:
        if self.stack_shape == ():
            raise TypeError(f"This is a single {type(self).__name__}, without entries to choose.")
        return self.stack_shape


@where_known
def _require_entry(shape: tuple[int, ...], index: PyTree) -> None:
    """Raise `IndexError` for an index beyond the end, for which JAX would take the last entry."""
    _ = np.broadcast_to(False, shape)[index]


def entry_at(leaf: Array, index: PyTree) -> Array:
    """Return the entry of a stacked array, or several, at an index of NumPy."""
    if not is_readable((leaf, index)) or jax.default_backend() != "cpu":
        return leaf[index]
    # NumPy indexes it, since JAX would compile for every shape.
    return jax.device_put(np.asarray(leaf)[index])


def stack_of(entries: Sequence[Entry], like: Entry) -> Entry:
    """Stack results along a leading axis; `like` gives the shapes where there are none."""

    def stack(one: Array, *leaves: Array) -> Array:
        if not leaves:
            return jax.device_put(np.zeros((0, *one.shape), one.dtype))
        if not is_readable(leaves[0]):
            return jnp.stack(leaves)
        # NumPy stacks them, since JAX would compile for every number of entries.
        return jax.device_put(np.stack(leaves))

    return jax.tree.map(stack, like, *entries)


def nothing_like(leaf: Array) -> Array:
    """Return NaN in place of floating-point numbers, zero in place of others."""
    if leaf.dtype.kind == "f":
        return jnp.full_like(leaf, jnp.nan)
    return jnp.zeros_like(leaf)


def first_entries(tree: Entry, number: int) -> Entry:
    """Return the first entries of a stack with known values."""
    return jax.tree.map(lambda leaf: jax.device_put(concrete(leaf)[:number]), tree)


def require_single(value: Stackable) -> None:
    """Raise `ValueError` if `value` is a stack."""
    if value.stack_shape:
        raise ValueError(
            f"This {type(value).__name__} is a stack of shape {value.stack_shape}: choose one: "
            "sweep[3], path[-1], or map the call by jax.vmap."
        )
