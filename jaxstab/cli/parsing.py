"""How arguments are read: bad ones end in one line and the exit code 2."""

import argparse
import re
import tomllib
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn

# How a command ends.
FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130

_NEGATIVE = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.IGNORECASE)


def option_of(name: str) -> str:
    """Return the option of a name, as --k-low of k_low."""
    return f"--{name.replace('_', '-')}"


class Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line and takes no abbreviations."""

    def __init__(self, **options: Any):
        super().__init__(
            allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **options
        )
        # That of argparse knows no exponents: it takes -1e-3 for an option.
        self._negative_number_matcher = _NEGATIVE

    def parse_args(self, args: Any, namespace: Any = None) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the options; an argument that is none ends the command and names the nearest."""
        # argparse would first take the value of an option that is none for a file.
        for name in (text.partition("=")[0] for text in args if text.startswith("--")):
            self._require_option(name)
        options, unknown = self.parse_known_args(args, namespace)
        if unknown:
            name = unknown[0].partition("=")[0]
            if name.startswith("-"):
                self._require_option(name)
            self.error(f"unrecognized argument: {name}")
        return options

    def _require_option(self, name: str) -> None:
        if name != "--" and name not in self._option_string_actions:
            close = nearest(name, self._option_string_actions)
            self.error(f"there is no option {name}; the nearest is {close}.")

    @property
    def options(self) -> list[str]:
        """The long names of the options that a configuration can hold, as in --size."""
        names = self._option_string_actions
        return [name for name in names if name.startswith("--") and name != "--help"]

    def error(self, message: str) -> NoReturn:
        """Exit with a line about the error."""
        self.exit(BAD_INPUT, f"{self.prog}: {' '.join(message.split())}\n")

    def refuse(self, name: str, reason: str) -> NoReturn:
        """Exit with a line about a wrong option."""
        self.error(f"argument {option_of(name)} {reason}.")


def nearest(word: str, choices: Iterable[str]) -> str:
    """Return the choice that is spelled most like a word."""
    return get_close_matches(word, [*choices], 1, cutoff=0)[0]


class Ended(Exception):
    """A command ended before its end, with an exit code."""

    def __init__(self, message: str, code: int):
        super().__init__(message)
        self.code = code


def whole_number(least: int, most: int | None = None) -> Callable[[str], int]:
    """Return a converter of text that lets whole numbers of a range pass."""
    limits = f"of at least {least}" if most is None else f"from {least} to {most}"

    def convert(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = None
        if number is None or number < least or (most is not None and number > most):
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number {limits}.")
        return number

    return convert


def existing_file(text: str) -> Path:
    """Return the path of a file that is there."""
    if not Path(text).is_file():
        raise argparse.ArgumentTypeError(f"there is no file {text}.")
    return Path(text)


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
    try:
        with path.open("rb") as file:
            content = tomllib.load(file)
    except OSError as error:
        parser.error(f"argument --config: {path}: {error.strerror}.")
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        parser.error(f"argument --config: {path} is not TOML: {error}.")
    arguments: list[str] = []
    for name, value in _flat(content.items()):
        if name == "config":
            parser.error(f"argument --config: {path} names another file: give options only.")
        values = value if isinstance(value, list) else [value]
        if not all(type(part) in (int, float, str) for part in values) or not values:
            parser.error(f"argument --config: {path}: {name} is {value!r}: give a number or text.")
        option = option_of(name)
        if option not in parser.options:
            close = nearest(option, parser.options)[2:].replace("-", "_")
            parser.error(
                f"argument --config: {path}: there is no option {name}; the nearest is {close}."
            )
        texts = list(map(str, values))
        # In one word a negative number is no option.
        arguments += [f"{option}={texts[0]}"] if len(texts) == 1 else [option, *texts]
    return arguments


def _flat(items: Iterable[tuple[str, object]]) -> Iterable[tuple[str, object]]:
    for name, value in items:
        if isinstance(value, dict):
            yield from _flat(value.items())
        else:
            yield name, value
