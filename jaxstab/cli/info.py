"""`jaxstab info`: the content of a file, a surface or a result."""

import argparse
from typing import Any

from jaxstab.cli.options import OF_A_FILE
from jaxstab.cli.problem import load_file, surface_of
from jaxstab.core.grid import Grid
from jaxstab.files import load
from jaxstab.files.netcdf import attributes_of
from jaxstab.surfaces import Topography
from jaxstab.surfaces.read import scan_of

# The lines on a surface that do not depend on its lengths.
_OF_HEIGHTS = ("Topography", "points", "rms height", "missing", "done")


def run(options: argparse.Namespace) -> None:
    """Print the content of the file."""
    attributes = attributes_of(options.file)
    if attributes is None:
        if vars(options)["import"]:
            raise ValueError(
                f"{options.file} is a surface and needs no classes: leave out --import."
            )
        print(_surface(options))
        return
    if any(getattr(options, name) is not None for name in OF_A_FILE):
        raise ValueError(
            f"{options.file} is a result, which has its own lengths and unit: leave out --lengths, "
            "--unit and --channel."
        )
    print(attributes["title"])
    for name, text in attributes.items():
        if name not in ("title", "structure", "class", "curve", "fit"):
            print(f"  {name.replace('_', ' ')}: {text}")
    if "class" in attributes:
        print(f"\n{load(options.file)}")
    if "structure" in attributes:
        contact, result = load_file(options)
        print(f"\n{contact}\n\n{result}")


def _surface(options: argparse.Namespace) -> str:
    """Return the description of a surface, as far as it is known without its lengths."""
    scan = scan_of(options.file, options.channel)
    has_unit = options.unit is not None or scan.unit is not None
    has_lengths = scan.lengths is not None and not (scan.is_counted and has_unit)
    if options.lengths is not None or has_lengths:
        return str(surface_of(options.file, options))
    content: Any = scan
    counted = Topography(Grid(scan.heights.shape, scan.heights.shape), content, options.unit)
    lines = [line for line in str(counted).splitlines() if line.strip().startswith(_OF_HEIGHTS)]
    lengths = "  lengths      not in the file: a run, and the slope, need --lengths"
    return "\n".join([*lines[:2], lengths, *lines[2:]])
