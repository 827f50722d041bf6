"""The values of a law that a file keeps beside its parameters, and by which it is known again."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxstab.contact import Contact
from jaxstab.display import text
from jaxstab.labels import PRESSURE, SURFACE_ENERGY

# Every how many points of a law's profile are kept.
_EVERY = 16
# How far a law may be from its values, over these and its depth.
_TOLERANCE = {"float32": 1e-4, "float64": 1e-9}


def law_variables(contact: Contact, unit: str) -> dict[str, Any]:
    """Return a law at gaps from large to zero, as variables of a data set.

    Arguments:
        contact: the contact problem.
        unit: that of lengths.
    """
    profile = contact.profile
    chosen = np.append(np.arange(0, profile.gaps.size - 1, _EVERY), -1)
    gaps, values, slopes = (
        np.asarray(field)[chosen] for field in (profile.gaps, profile.values, profile.slopes)
    )
    return {
        "law_gap": ("law_gap", gaps, {"long_name": "gap", "units": unit}),
        "law_energy": ("law_gap", values, {"long_name": "law f(g)", "units": SURFACE_ENERGY}),
        "law_attraction": ("law_gap", slopes, {"long_name": "f'(g)", "units": PRESSURE}),
    }


def require_same_law(contact: Contact, arrays: Mapping[str, np.ndarray], path: Path) -> None:
    """Raise `ValueError` where the law of a contact is not the one that a file has values of."""
    gaps, expected = arrays["law_gap"], arrays["law_energy"]
    energies = law_variables(contact, "")["law_energy"][1]
    is_finite = np.isfinite(expected)
    depth = -expected[is_finite].min(initial=0)
    tolerance = _TOLERANCE[expected.dtype.name] * (np.abs(expected) + depth)
    with np.errstate(invalid="ignore"):
        is_off = is_finite & ~(np.abs(energies - expected) <= tolerance)
    is_off |= is_finite != np.isfinite(energies)
    if is_off.any():
        first = np.argmax(is_off)
        raise ValueError(
            f"The law {text(contact.potential)} is not the one of {path}: at a gap of "
            f"{gaps[first]:.6g} it gives {energies[first]:.6g}, in the file "
            f"{expected[first]:.6g}. Give that of the file as `potential=`."
        )
