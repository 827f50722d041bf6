"""Tables of a bounded size, within programs."""

from typing import Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.core.stack import nothing_like
from jaxstab.core.types import Flag

Row = TypeVar("Row")


class Table(eqx.Module, Generic[Row]):
    """Entries in order along a leading axis, in room for a number of them."""

    rows: Row
    count: Int[Array, ""]

    @classmethod
    def like(cls, entry: Row, size: int, fields: bool = True) -> "Table[Row]":
        """Return an empty table of entries like one, with or without their fields."""

        def rows(leaf: Array) -> Array:
            if leaf.ndim > 0 and not fields:
                return jnp.zeros((size, 0), leaf.dtype)
            return jnp.broadcast_to(nothing_like(leaf), (size, *leaf.shape))

        return cls(jax.tree.map(rows, entry), jnp.array(0))

    @property
    def is_full(self) -> Flag:
        """Return whether there is no room left."""
        return self.count >= len(jax.tree.leaves(self.rows)[0])

    def with_entry(self, entry: Row, is_kept: Flag) -> "Table[Row]":
        """Return the store with an entry, if it is kept."""

        def put(rows: Array, leaf: Array) -> Array:
            if rows.shape[1:] != leaf.shape:
                return rows
            return rows.at[jnp.where(is_kept, self.count, len(rows))].set(leaf, mode="drop")

        return Table(jax.tree.map(put, self.rows, entry), self.count + is_kept)
