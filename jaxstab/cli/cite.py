"""`jaxstab cite`: the sources behind functions and modules."""

import argparse

import jaxstab
from jaxstab.cli.parsing import Parser

DESCRIPTION = "Print the sources to cite: the software, and the papers behind its functions."


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    help = "a function or module, as equilibrate or references.jkr (default: the method itself)"
    parser.add_argument("names", nargs="*", metavar="NAME", help=help)
    parser.add_argument("--bibtex", action="store_true", help="as BibTeX")


def run(options: argparse.Namespace) -> None:
    """Print the sources."""
    sources = jaxstab.cite(*map(_named, options.names))
    print(sources.bibtex if options.bibtex else sources)


def _named(name: str) -> object:
    found: object = jaxstab
    for part in name.split("."):
        if part.startswith("_") or not hasattr(found, part):
            raise ValueError(f"There is no {name} in jaxstab: give a public name.")
        found = getattr(found, part)
    return found
