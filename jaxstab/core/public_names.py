"""The names by which stores of studies know the classes and functions of jaxstab.

Stores hold hashes of the modules that things lay in when stores were first written; they go on
being made of these.
"""

from typing import Any

from jaxstab.core.units import is_own

_PACKAGE = __name__.partition(".")[0]
# By module, or by "module:name", where what lies there lay first.
_FIRST_MODULES = {
    "citations.cite": "citations",
    "contact.contact": "contact",
    "contact.resolution": "resolution",
    "core.grid": "grid",
    "core.history": "history",
    "core.results": "results",
    "equilibrium.equilibrium": "equilibrium.state",
    "equilibrium.solvers.base": "equilibrium.solver",
    "equilibrium.solvers.conjugate_gradients": "equilibrium.preconditioned",
    "equilibrium.solvers.polonsky_keer_rey": "equilibrium.polonsky_keer_rey",
    "equilibrium.solvers.saddle_newton": "equilibrium.saddle_newton",
    "loads.held_gap": "loads.gap",
    "paths.branch_end.critical_load": "branches.critical_load",
    "paths.critical_load": "paths.bracketed",
    "paths.sweep": "sweeps",
    "potentials.varying": "potentials.composed",
    "solids.free_half_space": "elasticity.free",
    "solids.half_space": "elasticity.half_space",
    "solids.layers": "elasticity.layers",
    "solids.solid": "elasticity.solid",
    "solids.spectral": "elasticity.spectral",
    "stability.barrier": "stability.margins",
    "stability.eigenpair": "stability.eigenpairs",
    "stability.lowest_modes": "stability.modes",
    "stability.perturb": "stability.release",
    "stability.solvers.base": "stability.solver",
    "stability.solvers.cone_lobpcg": "stability.projected",
    "stability.solvers.davidson": "stability.davidson",
    "stability.solvers.proximal": "stability.proximal",
    "paths.branch_end.kind:KINDS": "results",
    "stability.verdict:VERDICTS": "results",
    "stability.eigenpair:Minimum": "stability.solver",
}


def first_module(value: Any) -> str:
    """Return the module by which stores know a class or a function."""
    module, name = getattr(value, "__module__", ""), getattr(value, "__qualname__", "")
    if not is_own(module or ""):
        return module
    room = module.removeprefix(f"{_PACKAGE}.")
    first = _FIRST_MODULES.get(f"{room}:{name}", _FIRST_MODULES.get(room, room))
    return f"{_PACKAGE}.{first}"
