"""The long names of quantities in data sets."""

from collections.abc import Sequence

# The long name by the name of the field, unless the name says it.
_NAMES = {
    "angle": "contact angle, in radians",
    "area": "area of the cell",
    "back": "energy of the saddle above the end",
    "bending_stiffness": "bending stiffness B",
    "bound": "proved lower bound of the smallest eigenvalue",
    "complementarity": "least reaction over the rms pressure",
    "contact_area": "number of contact points over the number of all points",
    "dissipated": "energy dissipated in the solid",
    "dissipation": "energy lost",
    "conductance": "conductance C",
    "datum": "height that heights count from",
    "dielectric": "thickness of the dielectric over its relative permittivity",
    "displacement": "displacement u",
    "eigenvalue": "smallest eigenvalue",
    "end": "end of the branch",
    "energies": "energy of the images and the load, above the start",
    "energy": "elastic and adhesive energy",
    "error": "error of the eigenvalue",
    "factor": "factor of the law",
    "gap": "gap g",
    "heights": "height h of the rigid surface",
    "history": "indicators of the solver at its steps",
    "images": "gap along the string",
    "in_contact": "whether the surfaces touch",
    "incremental_stiffness": "force over a small approach",
    "index": "number of negative eigenvalues on the free points",
    "kind": "why the branch ends",
    "largest": "area of the largest patch",
    "length": "range",
    "lengths": "side lengths of the cell",
    "lost": "energy lost in jumps",
    "mean_pressure": "mean pressure p0, positive in compression",
    "mode": "mode of unit norm",
    "num_applications": "applications of the Hessian",
    "num_steps": "steps of the solver",
    "percolates": "whether a patch percolates",
    "perimeter": "length of the interface",
    "permeability": "permeability k",
    "poisson_ratio": "Poisson's ratio",
    "pressure": "elastic pressure p, positive in compression",
    "proved": "whether it is proved",
    "ratios": "moduli of the branches over the relaxed one",
    "reached": "time of the last state found",
    "reaction": "contact reaction",
    "residual": "relative residual",
    "result": "how the solver ended",
    "smoothing": "smoothing of the law's edge over its range",
    "state": "number of the state before",
    "stored": "energy stored, above the start",
    "strains": "displacement of each spring, first relative to the far side",
    "surface_energy": "work of adhesion",
    "tension": "surface tension of the liquid",
    "there": "energy of the saddle above the start",
    "thickness": "thickness of the layer",
    "true_area": "area corrected for the grid",
    "verdict": "verdict on the stability",
    "work": "work of the load",
    "youngs_modulus": "Young's modulus",
}
# The long name by the names of the holder and of the field.
_NAMES_IN = {
    ("solid", "tension"): "surface tension of the solid",
    ("solid", "times"): "relaxation times",
    ("barrier_law", "exponent"): "power of the distance with which the barrier grows",
    ("barrier_law", "coefficient"): "barrier over that power of the distance",
    ("turns", "kind"): "why the load turns",
    ("turns", "mode"): "direction of the branch, of unit norm",
    ("turns", "state"): "number of the state after",
}


def long_name(field: str, holders: Sequence[str]) -> str:
    """Return the long name of a field, given the fields that lead to it."""
    known = _NAMES.get(field, field.replace("_", " "))
    return _NAMES_IN.get((holders[-1], field), known) if holders else known
