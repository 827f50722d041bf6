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
# Warnings given so far, with the filters then: a change of the filters repeats them.
_given: dict[tuple, list[object]] = {}


def warn(message: str, category: type[Warning] = UserWarning, *, per_line: bool = False) -> None:
    """Warn at the innermost line outside of this package and JAX, once unless filters say "always".

    With `per_line`, once for each line of the caller, whatever numbers the message has, as at each
    step of a fit.
    """
    frame, registry = sys._getframe(1), {}
    # `skip_file_prefixes` needs Python 3.12.
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_INSIDE):
        frame = frame.f_back
    line, filters = (category, frame.f_code.co_filename, frame.f_lineno), [*warnings.filters]
    topics = [(category, message), *([line] if per_line else [])]
    if any(_given.get(topic) == filters for topic in topics):
        return
    module = frame.f_globals.get("__name__")
    warnings.warn_explicit(message, *line, module=module, registry=registry)
    # Python registers a warning that it will not repeat under a tuple.
    if any(isinstance(key, tuple) for key in registry):
        _given.update(dict.fromkeys(topics, filters))
