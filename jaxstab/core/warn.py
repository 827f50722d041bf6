"""Warnings that point at the line of the caller that they concern, and are given once."""

import os
import sys
import warnings
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import FrameType

import equinox
import jax
import jaxlib

# Whose frames lie between the caller's line and ours.
_INSIDE = tuple(
    f"{folder}{os.sep}"
    for folder in (
        Path(__file__).parents[1],
        *(Path(package.__file__ or "").parent for package in (jax, jaxlib, equinox)),
    )
)
# What was said, under which filters: filters may be changed so that it is said again.
_said: dict[Hashable, list[object]] = {}
_said_in_block: ContextVar[set[Hashable] | None] = ContextVar("_said_in_block", default=None)


def warn_once(message: str, category: type[Warning], *, per_line: bool = False) -> None:
    """Warn once of the same thing, unless Python's filters say "always".

    With `per_line` other numbers in the message, at the same line of the caller's, are the same
    thing too, as at each step of a fit.
    """
    frame = _caller()
    line = (category, frame.f_code.co_filename, frame.f_lineno)
    topics: set[Hashable] = {(category, message), *([line] if per_line else [])}
    block: set[Hashable] | None = _said_in_block.get()
    filters: list[object] = list(warnings.filters)
    is_said = any(_said.get(topic) == filters for topic in topics)
    if is_said or (block is not None and not topics.isdisjoint(block)):
        return
    if block is not None:
        block |= topics
    if warn(message, category):
        for topic in topics:
            _said[topic] = filters


@contextmanager
def said_once() -> Iterator[None]:
    """Let `warn_once` warn once within a block, whatever Python's filters say."""
    token = _said_in_block.set(set())
    try:
        yield
    finally:
        _said_in_block.reset(token)


def warn(message: str, category: type[Warning] = UserWarning) -> bool:
    """Warn each time, of the innermost line that is neither this package's nor JAX's.

    Return whether the filters let the same warning be given once only.
    """
    frame, registry = _caller(), {}
    warnings.warn_explicit(
        message,
        category,
        frame.f_code.co_filename,
        frame.f_lineno,
        module=frame.f_globals.get("__name__"),
        registry=registry,
    )
    # Python notes under a tuple what it would not give again.
    return any(isinstance(key, tuple) for key in registry)


def _caller() -> FrameType:
    """Return the innermost frame outside; `skip_file_prefixes` needs Python 3.12."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_INSIDE):
        frame = frame.f_back
    return frame
