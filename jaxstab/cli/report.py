"""`jaxstab report`: how a scanned surface sticks, on one page that needs no other file."""

import argparse
import hashlib
import shlex
from collections.abc import Mapping
from typing import Any

import jax

from jaxstab.cli.options import in_options
from jaxstab.cli.parsing import option_of
from jaxstab.cli.problem import surface_of
from jaxstab.lab import Wording, report

# Options that have other names in Python.
_NAMES = {"youngs_modulus": "modulus", "surface_energy": "work"}


def run(options: argparse.Namespace) -> None:
    """Compute the contact of a surface and write its report, which grows as results come."""
    jax.config.update("jax_enable_x64", True)
    scan = surface_of(options.file, options)
    if scan.unit is None:
        raise ValueError(f"{options.file} has no unit of length: give --unit, as in --unit um.")

    def command(arguments: Mapping[str, Any]) -> list[str]:
        """Return the command for the same report, with the defaults that depend on the scan."""
        computed = {_NAMES.get(name, name): value for name, value in arguments.items()}
        known = {**vars(options), **computed, "output": None}
        words = [str(known.pop("file"))]
        for name, value in known.items():
            if value is not None:
                values = value if isinstance(value, list) else [value]
                words += [option_of(name), *map(str, values)]
        return [shlex.quote(word) for word in ["python", "-m", "jaxstab", "report", *words]]

    digest = hashlib.sha256(options.file.read_bytes()).hexdigest()
    name = options.file.name
    wording = Wording(f"Adhesion of {name}", command, in_options, f"SHA-256 of {name}: {digest}")
    file = report(
        scan,
        options.modulus,
        options.work,
        options.output,
        poisson_ratio=options.poisson_ratio,
        range=options.range,
        size=options.size,
        detrend=options.detrend,
        periodic=options.periodic,
        hardness=options.hardness,
        wording=wording,
    )
    print(file)
