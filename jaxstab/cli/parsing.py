"""How arguments are read: bad ones end in one line and the exit code 2."""

import argparse
import os
import re
import tomllib
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

from jaxstab.core.text import text_of

# How a command ends.
FAILED = 1
BAD_INPUT = 2
INTERRUPTED = 130
CLOSED_PIPE = 141

_NEGATIVE = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.IGNORECASE)


class Ended(Exception):
    """A command ended before its end, with an exit code."""

    def __init__(self, message: str, code: int):
        super().__init__(message)
        self.code = code


class Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line and takes no abbreviations."""

    def __init__(self, **options: Any):
        super().__init__(allow_abbrev=False, **options)
        # The pattern of argparse knows no exponents: it takes -1e-3 for an option.
        self._negative_number_matcher = _NEGATIVE

    def parse_args(self, args: Any, namespace: Any = None) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the options; an unknown one ends the command and names the nearest."""
        # argparse would first take the value of an unknown option for a file.
        for name in given_options(args):
            self.require_option(name)
        return super().parse_args(args, namespace)

    def require_option(self, name: str, source: str = "") -> None:
        """Exit with the nearest option if there is none of a name."""
        if name not in ("--", *self._option_string_actions):
            close = nearest(name, self._option_string_actions) or "; --help lists them"
            self.error(f"{source}there is no option {name}{close}.")

    def error(self, message: str) -> NoReturn:
        """Exit with a line about the error."""
        self.exit(BAD_INPUT, f"{self.prog}: {' '.join(message.split())}\n")


def option_of(name: str) -> str:
    """Return the option of a name, as --k-low of k_low."""
    return f"--{name.replace('_', '-')}"


def given_options(arguments: list[str]) -> set[str]:
    """Return the options among arguments."""
    return {text.partition("=")[0] for text in arguments if text.startswith("--")}


def nearest(word: str, choices: Iterable[str]) -> str:
    """Return a clause on the choice that is spelled most like a word, empty if none is close."""
    return "".join(f"; the nearest is {close}" for close in get_close_matches(word, [*choices], 1))


def whole_number(least: int, most: float = float("inf")) -> Callable[[str], int]:
    """Return a converter of text that lets whole numbers of a range pass."""
    limits = f"from {least} to {most}"
    if most == float("inf"):
        limits = f"of at least {least}"

    def convert(text: str) -> int:
        if not re.fullmatch(r"[-+]?\d+", text) or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number {limits}.")
        return int(text)

    return convert


def existing_file(text: str) -> Path:
    """Return the path of a file that is there."""
    if not Path(text).is_file():
        raise argparse.ArgumentTypeError(f"there is no file {text}.")
    return Path(text)


def typed_text(argument: str) -> str:
    """Return an argument as it was typed, where the locale's encoding is that of no terminal."""
    return os.fsencode(argument).decode("utf-8", "replace")


def number(text: str) -> float:
    """Return the finite number that a text is."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number.")
    return value


def from_config(parser: Parser, path: Path) -> list[str]:
    """Return the options that a TOML file holds, at its top or in tables, as arguments."""
    source = f"argument --config: {path}: "
    arguments = []
    seen = set[str]()
    try:
        text = text_of(path.read_bytes())
        if text is None:
            raise ValueError("it is no text")
        items = [*tomllib.loads(text).items()]
    except (OSError, ValueError) as error:
        parser.error(f"{source}it is not TOML: {error}.")
    for name, value in items:
        if isinstance(value, dict):
            # The loop goes on over its options.
            items += value.items()
            continue
        parser.require_option(option_of(name), source)
        if option_of(name) in seen:
            parser.error(f"{source}{name} is given twice: give each option once.")
        seen.add(option_of(name))
        values = value if isinstance(value, list) else [value]
        if name == "config" or not all(type(part) in (int, float, str) for part in values):
            parser.error(f"{source}{name} is {value!r}: give options as numbers or texts.")
        option = option_of(name)
        texts = [*map(str, values)]
        # In one word a negative number is no option.
        if len(texts) == 1:
            arguments.append(f"{option}={texts[0]}")
        else:
            arguments += [option, *texts]
    return arguments
