"""The command line of a study's data: cases that are computed once, and the file made of them."""

import argparse
import itertools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import xarray

import jaxstab as js


def make_data(
    description: str,
    case: Callable[..., Any],
    blocks: Iterable[Iterable[dict[str, Any]]],
    documented: Callable[[xarray.Dataset], xarray.Dataset],
) -> None:
    """Compute the cases of all blocks in their order, and write the data set if it is asked for."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("folder", type=Path, help="where each case is kept as soon as it ends")
    parser.add_argument("--output", type=Path, help="the data set of all cases")
    options = parser.parse_args()
    cases = []
    for one in itertools.chain.from_iterable(blocks):
        if one not in cases:
            cases.append(one)
    study = js.study(case, cases, options.folder / case.__name__)
    print(f"{study.sizes['case']} cases, {study.seconds.values.sum() / 3600:.1f} h")
    if options.output:
        documented(study).to_netcdf(options.output)


def describe(
    study: xarray.Dataset, variables: Mapping[str, tuple[str, str]], title: str
) -> xarray.Dataset:
    """Return a data set with its title, and the meaning and the unit of each variable."""
    for name, (meaning, unit) in variables.items():
        study[name].attrs.update(long_name=meaning, units=unit)
    return study.assign_attrs(title=title)
