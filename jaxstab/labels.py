"""What each quantity is called, and what it is measured in."""

from jaxstab.contact import Contact

LENGTH, PRESSURE, ENERGY, NUMBER = "length", "pressure", "energy", "1"
STIFFNESS, SURFACE_ENERGY = "pressure/length", "energy/area"

# By the name of the field that holds it.
QUANTITIES = {
    "amplitude": ("amplitude", LENGTH),
    "area": ("area of the cell", f"{LENGTH}^2"),
    "bound": ("what the smallest eigenvalue is proved not to be below", STIFFNESS),
    "complementarity": ("least reaction over the rms pressure", NUMBER),
    "contact_area": ("number of contact points over that of all", NUMBER),
    "dissipation": ("energy lost", ENERGY),
    "displacement": ("displacement u", LENGTH),
    "eigenvalue": ("smallest eigenvalue", STIFFNESS),
    "energy": ("elastic and adhesive energy", ENERGY),
    "error": ("error of the eigenvalue", STIFFNESS),
    "factor": ("factor of the law", NUMBER),
    "gap": ("gap g", LENGTH),
    "heights": ("height h of the rigid surface", LENGTH),
    "history": ("indicators of the solver as it went", NUMBER),
    "in_contact": ("whether the surfaces touch", NUMBER),
    "kind": ("why the branch ends", NUMBER),
    "length": ("range", LENGTH),
    "lengths": ("side lengths of the cell", LENGTH),
    "mean_gap": ("mean gap", LENGTH),
    "mean_pressure": ("mean pressure p0, positive in compression", PRESSURE),
    "mode": ("mode of unit norm", NUMBER),
    "num_applications": ("applications of the Hessian", NUMBER),
    "num_steps": ("steps of the solver", NUMBER),
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
    "thickness": ("thickness of the layer", LENGTH),
    "verdict": ("verdict on the stability", NUMBER),
    "work": ("work done by what is prescribed", ENERGY),
    "youngs_modulus": ("Young's modulus", PRESSURE),
}


def with_unit(contact: Contact | str | None, label: str) -> str:
    """Return a label with a unit of length, that of a contact if it has one, for the word."""
    unit = contact.unit if isinstance(contact, Contact) else contact
    return label if unit is None else label.replace(LENGTH, unit)
