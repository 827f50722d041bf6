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

# Frames of these packages lie between the caller's line and ours.
_INSIDE = tuple(
    f"{folder}{os.sep}"
    for folder in (
        Path(__file__).parents[1],
        *(Path(package.__file__ or "").parent for package in (jax, jaxlib, equinox)),
    )
)
# Warnings given so far, with the filters then: a change of the filters repeats them.
_said: dict[Hashable, list[object]] = {}
_said_in_block: ContextVar[set[Hashable] | None] = ContextVar("_said_in_block", default=None)


def warn_once(message: str, category: type[Warning], *, per_line: bool = False) -> None:
    """Warn once for each message, unless Python's filters are "always".

    With `per_line`, once for each line of the caller, whatever numbers the message has, as at each
    step of a fit.
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
    """Warn each time, at the innermost line outside of this package and JAX.

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
    # Python registers a warning that it will not repeat under a tuple.
    return any(isinstance(key, tuple) for key in registry)


def _caller() -> FrameType:
    """Return the innermost frame outside; `skip_file_prefixes` needs Python 3.12."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_INSIDE):
        frame = frame.f_back
    return frame
