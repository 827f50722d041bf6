"""Equality of loads and results, of which some rows may hold nothing, and of other pytrees."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxstab.core.checks import is_traced


class Comparable(eqx.Module):
    """A module that equals another if both hold the same, where NaN is as good as NaN."""

    __hash__ = eqx.Module.__hash__

    def __eq__(self, other: object) -> Any:
        return eqx.tree_equal(*(jax.tree.map(_with_nan_apart, x) for x in (self, other)))


def _with_nan_apart(leaf: Any) -> Any:
    """Return an array as one without NaN, and where it has them."""
    if not eqx.is_inexact_array(leaf):
        return leaf
    return jnp.nan_to_num(leaf, nan=0.0, posinf=jnp.inf, neginf=-jnp.inf), jnp.isnan(leaf)


def are_same(one: object, other: object) -> bool:
    """Return whether two pytrees are equal, as far as their numbers are known."""
    if jax.tree.structure(one) != jax.tree.structure(other):
        return False
    leaves = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(is_traced(pair) or np.array_equal(*pair) for pair in leaves)
