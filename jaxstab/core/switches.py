"""JAX's switches for the user's code, set aside within this package."""

from collections.abc import Iterator
from contextlib import contextmanager

import jax


@contextmanager
def own_conventions() -> Iterator[None]:
    """Set aside JAX's checks of the user's code: here NaN is an answer, and numbers broadcast."""
    with (
        jax.debug_nans(False),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):
        yield
