"""Docstrings that take what several functions say alike from one place."""

from collections.abc import Callable, Mapping
from inspect import cleandoc, signature
from textwrap import fill
from typing import Any, TypeVar

Documented = TypeVar("Documented", bound=Callable[..., Any])


def described(
    meanings: Mapping[str, str], value_error: str, type_error: str = "", **others: str
) -> Callable[[Documented], Documented]:
    """Return a decorator that adds the sections on arguments and errors to a docstring.

    Arguments:
        meanings: what each argument is, by its name.
        value_error, type_error: when one is raised.
        others: the same as `meanings`, for this function alone.
    """
    errors = {"ValueError": value_error, "TypeError": type_error}

    def section(title: str, entries: Mapping[str, str]) -> str:
        lines = (f"{name}: {text}." for name, text in entries.items() if text)
        wrapped = (fill(x, 96, initial_indent=" " * 4, subsequent_indent=" " * 8) for x in lines)
        return "\n".join([f"{title}:", *wrapped])

    def describe(function: Documented) -> Documented:
        known = {**meanings, **others}
        arguments = {name: known[name] for name in signature(function).parameters}
        parts = [section("Arguments", arguments), section("Raises", errors)]
        function.__doc__ = "\n\n".join([cleandoc(function.__doc__ or ""), *parts])
        return function

    return describe
