"""Results of files, and the option of the commands that open them."""

import argparse
from importlib import import_module
from typing import Any

import jax

from jaxstab.cli.parsing import Parser
from jaxstab.contact import Contact
from jaxstab.files import load


def add_result_options(parser: Parser) -> None:
    """Add the option that imports modules."""
    help = "import a module that defines classes of the result; loading a file imports none"
    parser.add_argument("--import", action="append", default=[], metavar="MODULE", help=help)


def loaded(options: argparse.Namespace) -> tuple[Contact, Any]:
    """Return the contact and the result of a file, in double precision."""
    jax.config.update("jax_enable_x64", True)
    for name in vars(options)["import"]:
        import_module(name)
    return load(options.file)
