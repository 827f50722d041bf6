"""Docstrings that take what several functions say alike from one place."""

from collections.abc import Callable, Mapping
from inspect import cleandoc, signature
from textwrap import fill
from typing import Any, TypeVar

Documented = TypeVar("Documented", bound=Callable[..., Any])


def described(
    meanings: Mapping[str, str], raises: str, **others: str
) -> Callable[[Documented], Documented]:
    """Return a decorator that adds the sections on arguments and errors to a docstring.

    Arguments:
        meanings: what each argument is, by its name.
        raises: when a `ValueError` is raised.
        others: the same as `meanings`, for this function alone.
    """

    def describe(function: Documented) -> Documented:
        known = {**meanings, **others}
        entries = (f"{name}: {known[name]}." for name in signature(function).parameters)
        lines = [
            fill(entry, 96, initial_indent=" " * 4, subsequent_indent=" " * 8) for entry in entries
        ]
        text = cleandoc(function.__doc__ or "")
        sections = "\n".join(["Arguments:", *lines, "", "Raises:", f"    ValueError: {raises}."])
        function.__doc__ = f"{text}\n\n{sections}"
        return function

    return describe
