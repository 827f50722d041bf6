"""`jaxstab info`: the content of a file, a surface or a result."""

import argparse
import json
from pathlib import Path
from typing import Any

from jaxstab.cli.parsing import Parser
from jaxstab.cli.problem import OF_A_FILE, add_file_options, surface_of
from jaxstab.cli.result import add_result_options, loaded
from jaxstab.files.netcdf import attributes_of

DESCRIPTION = "Describe a file: a surface, with its statistics, or a result."


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.add_argument("file", type=Path, metavar="FILE", help="a surface or a result")
    add_file_options(parser, "a surface")
    add_result_options(parser)


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
    print(_described(attributes))
    if "structure" in attributes:
        contact, result = loaded(options)
        print(f"\n{contact}\n\n{result}")


def _described(attributes: dict[str, Any]) -> str:
    versions = json.loads(attributes["versions"])
    texts = {
        name.replace("_", " "): text
        for name, text in attributes.items()
        if name not in ("title", "structure", "versions")
    }
    texts["versions"] = ", ".join(f"{name} {number}" for name, number in versions.items())
    width = max(map(len, texts))
    lines = (f"  {name:<{width}}  {text}" for name, text in texts.items())
    return "\n".join([attributes["title"], *lines])
