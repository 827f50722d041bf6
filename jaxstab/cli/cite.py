"""`jaxstab cite`: the sources behind functions and modules."""

import argparse

import jaxstab


def run(options: argparse.Namespace) -> None:
    """Print the sources."""
    sources = jaxstab.cite(*map(_public_object, options.names))
    if options.bibtex:
        print(sources.bibtex)
    else:
        print(sources)


def _public_object(name: str) -> object:
    found: object = jaxstab
    for part in name.split("."):
        if part.startswith("_") or not hasattr(found, part):
            raise ValueError(f"There is no {name} in jaxstab: give a public name.")
        found = getattr(found, part)
    return found
