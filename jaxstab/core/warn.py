"""Warnings that point at the line of the caller that they concern."""

import os
import sys
import warnings
from pathlib import Path

import equinox
import jax
import jaxlib

# Frames of these packages lie between the caller's line and ours.
_INSIDE = tuple(
    f"{folder}{os.sep}"
    for folder in (
        Path(__file__).parents[1],
        *(Path(package.__file__ or "").parent for package in (jax, jaxlib, equinox)),
    )
)


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the innermost line outside of this package, JAX and Equinox."""
    # `skip_file_prefixes` needs Python 3.12.
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_INSIDE):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)
