"""`jaxstab plot`: the figure of a result."""

import argparse
from itertools import chain, count
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxstab import plots
from jaxstab.branches import Branch, CriticalLoad
from jaxstab.cli.problem import load_file
from jaxstab.contact import Contact
from jaxstab.equilibrium import Equilibrium
from jaxstab.evolution import Evolution
from jaxstab.loading import Path as Followed
from jaxstab.loading.sweep import Sweep
from jaxstab.observation import Observed
from jaxstab.stability import Stability
from jaxstab.transitions import Detachment, Transition

# The figures of results that need no contact, by the class of the result.
_OF_STATES = {
    Followed: plots.path,
    Branch: plots.branch,
    Evolution: plots.evolution,
    Detachment: plots.detachment,
    Observed: plots.observed,
}


def run(options: argparse.Namespace) -> None:
    """Draw the figure and say where it is."""
    contact, result = load_file(options)
    if options.state is not None:
        if not isinstance(result, Sweep) or options.state >= len(result):
            number = len(result) if isinstance(result, Sweep) else 0
            raise ValueError(
                f"--state is {options.state}: {options.file} has {number} states of a sweep."
            )
        result = result[options.state]
    if options.output is not None and options.output.exists():
        raise FileExistsError(f"{options.output} exists, and is not overwritten: choose another.")
    figure = _figure(contact, result)
    output = options.output or _free_name(options.file.with_suffix(".png"))
    print(plots.save(figure, output, width=options.width))


def _free_name(path: Path) -> Path:
    """Return a path, or the first of path-2, path-3, ... that does not exist."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(name for name in chain([path], numbered) if not name.exists())


def _figure(contact: Contact, result: Any) -> Figure | Axes:
    if draw := _OF_STATES.get(type(result)):
        return draw(result)
    if isinstance(result, Transition):
        return plots.transition(contact, result)
    if isinstance(result, Stability):
        return plots.mode(contact, result.cone)
    if isinstance(result, CriticalLoad):
        return plots.mode(contact, result.critical)
    if isinstance(result, Equilibrium) or (result.stability is None and not result.stack_shape):
        return plots.gap(contact, result)
    if result.stability is None:
        raise ValueError("This sweep holds no stability: choose one of its states by --state.")
    if result.stack_shape:
        return plots.stability_curve(result)
    return plots.summary(contact, result)
