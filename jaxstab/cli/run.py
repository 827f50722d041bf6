"""`jaxstab run`: a contact loaded and unloaded, or the unloading study of the paper."""

import argparse
import warnings
from contextlib import suppress
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

from jaxstab.cli import problem
from jaxstab.cli.parsing import FAILED, INTERRUPTED, Ended
from jaxstab.contact import Contact
from jaxstab.core.interrupts import interrupts_held
from jaxstab.core.optional_packages import NETCDF, are_installed
from jaxstab.core.progress import is_watched
from jaxstab.core.results import RESULTS
from jaxstab.core.warn import warn
from jaxstab.files import save
from jaxstab.files.dataset import Result
from jaxstab.loading import follow
from jaxstab.loading.sweep import SweepInterrupted, sweep
from jaxstab.plots import path as plot_path
from jaxstab.plots import stability_curve
from jaxstab.states import PathInterrupted


def run(options: argparse.Namespace) -> None:
    """Run the study that the options describe, print its table and write its files."""
    jax.config.update("jax_enable_x64", options.precision == "float64")
    contact = problem.contact_of(options)
    if not are_installed(*NETCDF):
        warn("No data will be written, for lack of packages: pip install 'jaxstab[data]'.")
    folder = _new_folder(options.output)
    study = _loop if options.study == "loop" else _unloading
    try:
        print(f"{contact}\n")
        complaint = study(options, contact, folder)
    finally:
        # A run that fails at once leaves no folder.
        if not any(folder.iterdir()):
            folder.rmdir()
    print(f"\nThe results are in {folder.resolve()}")
    if complaint:
        raise complaint


def _loop(options: argparse.Namespace, contact: Contact, folder: Path) -> Ended | None:
    """Follow the contact from the last load to the first and back."""
    turns = problem.loads_of(options, contact, [1, 0, 1])
    # Said at the end instead.
    with warnings.catch_warnings(action="ignore", category=PathInterrupted):
        path = follow(
            contact, turns, smallest_jump=options.smallest_jump, progress=is_watched(), throw=False
        )
    with interrupts_held():
        # First of all, since a closed pipe or a figure may fail.
        _save(folder / "loop.nc", contact, path)
        print(path)
        if len(path.load.value) > 1:
            plot_path(path)
            plt.savefig(folder / "loop.png", dpi=150)
            plt.close()
    if path.result == RESULTS.interrupted:
        return Ended(f"interrupted, {len(path.load.value)} states are done.", INTERRUPTED)
    if path.result != RESULTS.successful:
        return Ended(f"the path stopped early: {RESULTS[path.result]}.", FAILED)
    return None


def _unloading(options: argparse.Namespace, contact: Contact, folder: Path) -> Ended | None:
    """Assess the stability of the equilibria from the first load to the last."""
    loads = problem.loads_of(options, contact, np.linspace(0, 1, options.number))
    # Said at the end instead.
    with warnings.catch_warnings(action="ignore", category=SweepInterrupted):
        result = sweep(contact, loads, order=options.order, progress=is_watched())
    with interrupts_held():
        _save(folder / "unloading.nc", contact, result)
        print(result)
        # The two panels of Rey & Bleyer's fig. 12; one legend is enough.
        figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
        stability_curve(result, "mean_pressure", axes=left).legend().remove()
        stability_curve(result, "contact_area", axes=right)
        figure.savefig(folder / "unloading.png", dpi=150)
        plt.close(figure)
    done = result.load.value.size
    if done < options.number:
        return Ended(f"interrupted, {done} of {options.number} loads are done.", INTERRUPTED)
    assert result.stability is not None
    if not np.any(result.stability.result == "successful"):
        return Ended("every load failed, as the last column says.", FAILED)
    return None


def _save(path: Path, contact: Contact, result: Result) -> None:
    if are_installed(*NETCDF):
        save(path, contact, result)


def _new_folder(parent: Path) -> Path:
    """Make and return the first of parent/1, parent/2, ... that does not exist."""
    parent.mkdir(parents=True, exist_ok=True)
    number = 1
    while True:
        folder = parent / str(number)
        with suppress(FileExistsError):
            folder.mkdir()
            return folder
        number += 1
