"""What input must satisfy, wherever its value is known: eagerly always, under a JAX trace never."""

from typing import Any

import jax
import jax.core
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float


def is_traced(value: Any) -> bool:
    """Whether any leaf of `value` is a JAX tracer, so that its numbers are not known yet."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))


def parameter(value: ArrayLike) -> Float[Array, "..."]:
    """Return `value` as a floating-point array, so that it can be vmapped and differentiated."""
    array = jnp.asarray(value)
    return array if jnp.issubdtype(array.dtype, jnp.floating) else array.astype(float)


def cast(tree: Any, dtype: Any) -> Any:
    """Return `tree` with its floating-point leaves in `dtype`."""

    def cast_leaf(leaf: Any) -> Any:
        is_float = isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return leaf.astype(dtype) if is_float else leaf

    return jax.tree.map(cast_leaf, tree)


def require(name: str, value: Any, holds: Any, cure: str) -> None:
    """Raise `ValueError` naming `value` and the `cure` where `holds`, if known, is false."""
    if not is_traced(holds) and not jnp.all(holds):
        raise ValueError(f"{name} is {_describe(value)}: {cure}")


def require_positive(name: str, value: Float[Array, "..."]) -> None:
    """Raise `ValueError` where `value`, if known, is not positive and finite."""
    require(name, value, (value > 0) & jnp.isfinite(value), "it must be positive and finite.")


def require_finite(name: str, value: Float[Array, "..."]) -> None:
    """Raise `ValueError` naming the first point where `value`, if known, is NaN or infinite."""
    finite = jnp.isfinite(value)
    if is_traced(finite) or finite.all():
        return
    index = tuple(int(i) for i in jnp.argwhere(~finite)[0])
    raise ValueError(
        f"{name} has {int((~finite).sum())} NaN or infinite values, the first at {index}: "
        f"{float(value[index])}. Mask or interpolate them before use."
    )


def _describe(value: Any) -> str:
    array = isinstance(value, jax.Array)
    return repr(value.item()) if array and value.ndim == 0 else str(value)
