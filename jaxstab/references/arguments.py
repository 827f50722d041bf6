"""The arguments of the closed forms: their meaning and their conditions."""

import numpy as np
import numpy.typing
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from jaxstab.core.checks import require

Array = NDArray[np.float64]
# A named alias, which signatures show in place of the union that it stands for.
ArrayLike = TypeAliasType("ArrayLike", numpy.typing.ArrayLike)


def positive(**values: ArrayLike) -> tuple[Array, ...]:
    """Return `values` as arrays of one shape, each positive and finite."""
    arrays = {name: np.asarray(value, np.float64) for name, value in values.items()}
    for name, array in arrays.items():
        is_good = (array > 0) & np.isfinite(array)
        require(f"The {name.replace('_', ' ')}", array, is_good, "give a positive, finite number.")
    return tuple(array.copy() for array in np.broadcast_arrays(*arrays.values()))


def not_negative(name: str, value: ArrayLike) -> Array:
    """Return `value` as an array without negative entries, which may be infinite."""
    array = np.asarray(value, np.float64)
    require(f"The {name.replace('_', ' ')}", array, array >= 0, "give zero or a positive number.")
    return array
