"""Roots of arrays of functions of one variable."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray


def bisect(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    negative: ArrayLike,
    positive: ArrayLike,
) -> NDArray[np.float64]:
    """Find the root of a continuous function between a negative and a positive value, by bisection.

    The function acts entry by entry. For an entry without a change of sign the result is the end
    that its sign points to.
    """
    below = np.asarray(negative, np.float64)
    above = np.asarray(positive, np.float64)
    # A hundred halvings reach rounding from any interval.
    for _ in range(100):
        middle = (below + above) / 2
        is_negative = function(middle) < 0
        below = np.where(is_negative, middle, below)
        above = np.where(is_negative, above, middle)
    return (below + above) / 2
