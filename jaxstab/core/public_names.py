"""The names by which files and stores know the classes and functions of jaxstab.

Files hold public names, so that modules can move. Stores hold hashes of the modules that things lay
in when stores were first written; they go on being made of these.
"""

from importlib import import_module
from typing import Any

_PACKAGE = __name__.partition(".")[0]
# Where the classes that files hold are public.
_NAMESPACES = (_PACKAGE, f"{_PACKAGE}.potentials")
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


def is_own(module: str) -> bool:
    """Return whether a module is one of jaxstab."""
    return module == _PACKAGE or module.startswith(f"{_PACKAGE}.")


def public_name(kind: type) -> str:
    """Return "module:name" of a class: where it is public, or where it lies."""
    homes = [space for space, value in _public(kind.__qualname__) if value is kind]
    return f"{homes[0] if homes else kind.__module__}:{kind.__qualname__}"


def public(name: str) -> Any:
    """Return what has a public name, None if nothing has."""
    return next((value for _, value in _public(name)), None)


def first_module(value: Any) -> str:
    """Return the module by which stores know a class or a function."""
    module, name = getattr(value, "__module__", ""), getattr(value, "__qualname__", "")
    if not is_own(module or ""):
        return module
    room = module.removeprefix(f"{_PACKAGE}.")
    first = _FIRST_MODULES.get(f"{room}:{name}", _FIRST_MODULES.get(room, room))
    return f"{_PACKAGE}.{first}"


def _public(name: str) -> list[tuple[str, Any]]:
    modules = [(space, import_module(space)) for space in _NAMESPACES]
    return [(space, getattr(module, name)) for space, module in modules if name in module.__all__]
