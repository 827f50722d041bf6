"""Results from files."""

import argparse
from importlib import import_module

import jax

from jaxstab.contact import Contact
from jaxstab.files import load
from jaxstab.files.dataset import Result


def loaded(options: argparse.Namespace) -> tuple[Contact, Result]:
    """Return the contact and the result of a file, in double precision."""
    jax.config.update("jax_enable_x64", True)
    for name in vars(options)["import"]:
        import_module(name)
    return load(options.file)
