"""Where a function of one variable changes sign, for arrays of such functions at once."""

from collections.abc import Callable

import numpy as np

from jaxstab.references.arguments import Array, ArrayLike


def bisect(function: Callable[[Array], Array], negative: ArrayLike, positive: ArrayLike) -> Array:
    """Return the root of `function` between points where it is negative and where it is positive.

    That is continuous, entry by entry. Where the sign never changes, it is the end to which the
    only sign there is points.
    """
    below, above = np.asarray(negative, np.float64), np.asarray(positive, np.float64)
    # A hundred halvings leave nothing of any interval but rounding.
    for _ in range(100):
        middle = (below + above) / 2
        is_negative = function(middle) < 0
        below, above = np.where(is_negative, middle, below), np.where(is_negative, above, middle)
    return (below + above) / 2
