"""The table of a law in a file, by which the law is checked when the file is read."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxstab.contact import Contact
from jaxstab.core.accuracy import EQUILIBRIUM
from jaxstab.core.display import text
from jaxstab.core.units import LENGTH, PRESSURE, SURFACE_ENERGY, unit_symbol

# Every 16th point of a law's profile is kept.
_EVERY = 16


def law_variables(contact: Contact) -> dict[str, tuple[str, np.ndarray, dict[str, str]]]:
    """Return a law at gaps from large to zero, as variables of a data set."""
    profile = contact.profile
    chosen = np.append(np.arange(0, profile.gaps.size - 1, _EVERY), -1)
    variables = {}
    for name, column, long_name, dimension in (
        ("law_gap", profile.gaps, "gap", LENGTH),
        ("law_energy", profile.values, "law f(g)", SURFACE_ENERGY),
        ("law_attraction", profile.slopes, "f'(g)", PRESSURE),
    ):
        attributes = {"long_name": long_name, "units": unit_symbol(contact.units, dimension)}
        variables[name] = "law_gap", np.asarray(column)[chosen], attributes
    return variables


def require_same_law(contact: Contact, arrays: Mapping[str, np.ndarray], path: Path) -> None:
    """Raise `ValueError` if the law of a contact disagrees with the table of a file."""
    gaps = arrays["law_gap"]
    expected = arrays["law_energy"]
    energies = law_variables(contact)["law_energy"][1]
    is_finite = np.isfinite(expected)
    depth = -expected[is_finite].min(initial=0)
    tolerance = EQUILIBRIUM[expected.dtype.name] * (np.abs(expected) + depth)
    with np.errstate(invalid="ignore"):
        is_off = is_finite & ~(np.abs(energies - expected) <= tolerance)
    is_off |= is_finite != np.isfinite(energies)
    if is_off.any():
        first = np.argmax(is_off)
        raise ValueError(
            f"The law {text(contact.potential)} is not the one of {path}: at a gap of "
            f"{gaps[first]:.6g} it gives {energies[first]:.6g}, in the file "
            f"{expected[first]:.6g}. Give the law of the file as `potential=`."
        )
