"""Warnings that point at the line of the caller that they concern."""

import contextlib
import os
import sys
import warnings
from pathlib import Path

import equinox
import jax
import jaxlib

# Frames of these packages, and of context managers that decorate ours, lie between the caller's
# line and ours.
_PACKAGES = jax, jaxlib, equinox
_FOLDERS = Path(__file__).parents[1], *(Path(x.__file__ or "").parent for x in _PACKAGES)
_INSIDE = (contextlib.__file__, *(f"{folder}{os.sep}" for folder in _FOLDERS))


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the innermost line outside of this package, JAX and Equinox."""
    # `skip_file_prefixes` needs Python 3.12.
    frame = sys._getframe(1)
    level = 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_INSIDE):
        frame = frame.f_back
        level = level + 1
    warnings.warn(message, category, stacklevel=level)
