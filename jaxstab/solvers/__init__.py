"""The solvers of equilibria and eigenvalues, and their interfaces."""

from jaxstab.equilibrium import (
    EquilibriumSolver,
    PolonskyKeerRey,
    PreconditionedConjugateGradient,
    SaddleNewton,
)
from jaxstab.stability import (
    ConeSolver,
    Davidson,
    Minimum,
    ProjectedLOBPCG,
    ProximalIteration,
    SpaceSolver,
)

__all__ = [
    "ConeSolver",
    "Davidson",
    "EquilibriumSolver",
    "Minimum",
    "PolonskyKeerRey",
    "PreconditionedConjugateGradient",
    "ProjectedLOBPCG",
    "ProximalIteration",
    "SaddleNewton",
    "SpaceSolver",
]


def __dir__() -> list[str]:
    return __all__
