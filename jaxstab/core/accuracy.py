"""The accuracies of searches in each precision, and the rounding that bounds them.

A search that needs another accuracy takes a multiple of one of these.
"""

import jax.numpy as jnp

# The residual of an equilibrium: its imbalance of pressures over those that balance each other.
EQUILIBRIUM = {"float64": 1e-9, "float32": 1e-4}
# The residual of a linear system, or of Newton's method near its end.
EXACT = {"float64": 1e-12, "float32": 1e-6}
# The residual of an eigenpair, over the size of the operator.
EIGENPAIR = {"float64": 1e-7, "float32": 1e-5}
# That of tangents and lowest modes along a curve, by which its folds and bifurcations are told.
ALONG_CURVES = {"float64": 1e-5, "float32": 1e-4}
# The residual of what only guides another search, such as its start.
ROUGH = 1e-4
# The residual of the linear system of a step of Newton's method.
NEWTON_STEP = 1e-2
# The part of a quantity below which it counts as zero, and two states as one.
NEGLIGIBLE = {"float64": 1e-6, "float32": 1e-3}
# A measured number is told from noise if it exceeds its standard error so many times.
SIGNIFICANT = 5.0
# The relative error of a few operations on numbers, and of those on fields, in units of precision.
_OF_NUMBERS = 16
_OF_FIELDS = 1e3


def rounding_of_numbers(dtype: jnp.dtype) -> float:
    """Return the relative error that rounding leaves in a few operations."""
    return _OF_NUMBERS * float(jnp.finfo(dtype).eps)


def rounding_of_fields(dtype: jnp.dtype) -> float:
    """Return the relative error that rounding leaves in pressures, after transforms and sums."""
    return _OF_FIELDS * float(jnp.finfo(dtype).eps)
