"""The names by which files and stores know the classes and functions of jaxstab.

Files hold public names, so that modules can move. Stores hold hashes of the modules that things lay
in when stores were first written; they go on being made of these.
"""

import sys
from typing import Any

_PACKAGE = __name__.partition(".")[0]
# Where the classes that files hold are public.
_NAMESPACES = (_PACKAGE, f"{_PACKAGE}.potentials")
# The first module of what has moved since.
_FIRST_MODULES = {
    "branches.critical_load": "CriticalLoad",
    "cases": "equilibrium pull_off verdict",
    "citations": "cite",
    "contact": "Contact",
    "elasticity.free": "FreeHalfSpace",
    "elasticity.half_space": "HalfSpace",
    "elasticity.layers": "CoatedHalfSpace Layer",
    "elasticity.solid": "Solid",
    "elasticity.spectral": "Spectral SpectralSolid",
    "equilibrium.polonsky_keer_rey": "PolonskyKeerRey",
    "equilibrium.preconditioned": "PreconditionedConjugateGradient",
    "equilibrium.saddle_newton": "SaddleNewton",
    "equilibrium.solver": "EquilibriumSolver",
    "equilibrium.state": "Equilibrium",
    "grid": "Grid",
    "loads.gap": "GapControl MeanDisplacement MeanGap",
    "paths.bracketed": "critical_load",
    "potentials.composed": "Scaled Varying Within everywhere varying_fields with_fields",
    "resolution": "ResolutionWarning",
    "results": "KINDS RESULTS SolverError VERDICTS",
    "stability.davidson": "Davidson",
    "stability.eigenpairs": "Eigenpair",
    "stability.margins": "Barrier",
    "stability.modes": "lowest_modes",
    "stability.projected": "ProjectedLOBPCG",
    "stability.proximal": "ProximalIteration",
    "stability.release": "release",
    "stability.solver": "ConeSolver SpaceSolver",
    "sweeps": "Sweep SweepInterrupted sweep",
}
_FIRST_MODULE_OF = {
    name: f"{_PACKAGE}.{module}"
    for module, names in _FIRST_MODULES.items()
    for name in names.split()
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
    return _FIRST_MODULE_OF.get(name, module) if is_own(module or "") else module


def _public(name: str) -> list[tuple[str, Any]]:
    """Return what has a public name, with the module where it has."""
    modules = [(space, sys.modules[space]) for space in _NAMESPACES]
    return [(space, vars(module).get(name)) for space, module in modules if name in module.__all__]
