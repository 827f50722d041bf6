"""What each quantity is called, and what it is measured in."""

import re
from collections.abc import Sequence

import numpy as np

from jaxstab.contact import Contact

LENGTH, PRESSURE, ENERGY, NUMBER = "length", "pressure", "energy", "1"
STIFFNESS, SURFACE_ENERGY = "pressure/length", "energy/area"

# By the name of the field that holds it.
QUANTITIES = {
    "amplitude": ("amplitude", LENGTH),
    "angle": ("contact angle, in radians", NUMBER),
    "area": ("area of the cell", f"{LENGTH}^2"),
    "back": ("energy of the saddle above the end", ENERGY),
    "bound": ("what the smallest eigenvalue is proved not to be below", STIFFNESS),
    "complementarity": ("least reaction over the rms pressure", NUMBER),
    "contact_area": ("number of contact points over that of all", NUMBER),
    "dissipation": ("energy lost", ENERGY),
    "conductance": ("conductance C", f"{LENGTH}/resistivity"),
    "dielectric": ("thickness of the dielectric over its relative permittivity", LENGTH),
    "displacement": ("displacement u", LENGTH),
    "eigenvalue": ("smallest eigenvalue", STIFFNESS),
    "end": ("why the branch goes no further", NUMBER),
    "energies": ("energy of the images and the load, above that of the start", ENERGY),
    "energy": ("elastic and adhesive energy", ENERGY),
    "error": ("error of the eigenvalue", STIFFNESS),
    "factor": ("factor of the law", NUMBER),
    "gap": ("gap g", LENGTH),
    "heights": ("height h of the rigid surface", LENGTH),
    "history": ("indicators of the solver as it went", NUMBER),
    "images": ("gap along the string", LENGTH),
    "in_contact": ("whether the surfaces touch", NUMBER),
    "incremental_stiffness": ("force over a small approach", f"{PRESSURE} {LENGTH}"),
    "index": ("number of negative eigenvalues on the free points", NUMBER),
    "kind": ("why the branch ends", NUMBER),
    "largest": ("area of the largest patch", f"{LENGTH}^2"),
    "length": ("range", LENGTH),
    "lengths": ("side lengths of the cell", LENGTH),
    "mean_gap": ("mean gap", LENGTH),
    "mean_pressure": ("mean pressure p0, positive in compression", PRESSURE),
    "mode": ("mode of unit norm", NUMBER),
    "num_applications": ("applications of the Hessian", NUMBER),
    "num_steps": ("steps of the solver", NUMBER),
    "number": ("number", NUMBER),
    "percolates": ("whether a patch goes on without end", NUMBER),
    "perimeter": ("length of the interface", LENGTH),
    "permeability": ("permeability k", f"{LENGTH}^3"),
    "permittivity": ("permittivity", f"{ENERGY}/(voltage^2 {LENGTH})"),
    "poisson_ratio": ("Poisson's ratio", NUMBER),
    "pressure": ("elastic pressure p, positive in compression", PRESSURE),
    "proved": ("whether it is proved", NUMBER),
    "reaction": ("contact reaction", PRESSURE),
    "residual": ("relative residual", NUMBER),
    "result": ("how the solver ended", NUMBER),
    "smoothing": ("smoothing of the law's edge over its range", NUMBER),
    "state": ("number of the state before", NUMBER),
    "stiffness": ("stiffness", STIFFNESS),
    "surface_energy": ("work of adhesion", SURFACE_ENERGY),
    "tension": ("surface tension of the liquid", SURFACE_ENERGY),
    "there": ("energy of the saddle above the start", ENERGY),
    "thickness": ("thickness of the layer", LENGTH),
    "true_area": ("area corrected for the grid", f"{LENGTH}^2"),
    "verdict": ("verdict on the stability", NUMBER),
    "viscosity": ("viscosity", f"{PRESSURE} time"),
    "voltage": ("voltage", "voltage"),
    "work": ("work done by what is prescribed", ENERGY),
    "youngs_modulus": ("Young's modulus", PRESSURE),
}
# By the names of the field and of that which holds it, where it is another thing there.
_QUANTITIES_IN = {
    ("barrier_law", "exponent"): ("power of the distance with which the barrier grows", NUMBER),
    ("barrier_law", "coefficient"): (
        "barrier over that power of the distance",
        f"{ENERGY}/load^exponent",
    ),
    ("turns", "kind"): ("why the load turns", NUMBER),
    ("turns", "mode"): ("direction of the branch, of unit norm", NUMBER),
    ("turns", "state"): ("number of the state after", NUMBER),
}


def quantity(field: str, holders: Sequence[str]) -> tuple[str, str] | None:
    """Return what a field of a result is called and measured in; None where that is not known."""
    known = QUANTITIES.get(field)
    return _QUANTITIES_IN.get((holders[-1], field), known) if holders else known


# In metres, and in no other unit, it is clear what a consistent set measures the rest in.
_SI = {LENGTH: "m", "area": "m^2", PRESSURE: "Pa", ENERGY: "J", "voltage": "V"}
_PREFIXES = dict(
    zip(range(-18, 13, 3), ["a", "f", "p", "n", "µ", "m", "", "k", "M", "G", "T"], strict=True)
)
# There energies and areas are those per length of the other side.
_ON_A_LINE = {ENERGY: f"{ENERGY}/{LENGTH}", f"{LENGTH}^2": LENGTH}


def dimension_on(num_sides: int, dimension: str) -> str:
    """Return the dimension that a quantity has on a grid of one side or two."""
    return _ON_A_LINE.get(dimension, dimension) if num_sides == 1 else dimension


def with_unit(contact: Contact | str | None, label: str) -> str:
    """Return a dimension, or a label "name [dimension]", in the units of a contact.

    That is given, or its unit of length: in metres the others are those of the SI.
    """
    unit = contact.unit if isinstance(contact, Contact) else contact
    if unit is None:
        return label
    units = _SI if unit == "m" else {LENGTH: unit}
    name, bracket, dimension = label.rpartition("[")
    return name + bracket + re.sub("[a-z]+", lambda word: units.get(word[0], word[0]), dimension)


def prefixed(unit: str, largest: float) -> tuple[float, str]:
    """Return by what to divide a value in an SI unit, and the unit with that prefix.

    Other units, and those that take no prefix, as 1/m, stay as they are.
    """
    if not re.match(r"(m|Pa|J)(/|$)", unit) or not 0 < largest < np.inf:
        return 1.0, unit
    power = int(np.clip(3 * np.floor(np.log10(largest) / 3), min(_PREFIXES), max(_PREFIXES)))
    return 10.0**power, _PREFIXES[power] + unit


def measured(contact: Contact | str | None, value: float, dimension: str, digits: int = 3) -> str:
    """Return a value with its unit; in brackets, as 2 [length], where that is not known."""
    divisor, unit = prefixed(with_unit(contact, dimension), abs(value))
    is_known = not {*re.findall("[a-z]+", unit)} & {*_SI}
    return f"{value / divisor:.{digits}g} {unit if is_known else f'[{unit}]'}"
