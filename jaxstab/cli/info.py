"""`jaxstab info`: the content of a file, a surface or a result."""

import argparse

from jaxstab.cli.options import OF_A_FILE
from jaxstab.cli.problem import loaded, surface_of
from jaxstab.files.netcdf import attributes_of


def run(options: argparse.Namespace) -> None:
    """Print the content of the file."""
    attributes = attributes_of(options.file)
    if attributes is None:
        if vars(options)["import"]:
            raise ValueError(
                f"{options.file} is a surface and needs no classes: leave out --import."
            )
        print(surface_of(options.file, options))
        return
    if any(getattr(options, name) is not None for name in OF_A_FILE):
        raise ValueError(
            f"{options.file} is a result, which has its own lengths and unit: leave out --lengths, "
            "--unit and --channel."
        )
    print(attributes["title"])
    for name, text in attributes.items():
        if name not in ("title", "structure", "checksums"):
            print(f"  {name.replace('_', ' ')}: {text}")
    if "structure" in attributes:
        contact, result = loaded(options)
        print(f"\n{contact}\n\n{result}")
