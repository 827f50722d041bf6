"""The leakage through the gap of a contact: Reynolds' flow."""

from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Array, Float

from jaxstab.contact import Contact
from jaxstab.core.checks import (
    array,
    cast,
    parameter,
    positive_scalar,
    require_known,
    require_one_of,
)
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import LENGTH, VISCOSITY, VOLUME
from jaxstab.equilibrium.equilibrium import State, found_equilibrium
from jaxstab.equilibrium.observables.flow import Flow, Solver, conducting, flows
from jaxstab.equilibrium.observables.observable import Observable


class Leakage(Observable):
    """The leakage through the gap under a pressure that falls in the mean along x, and along y.

    Along a path `drop` and `flux` are None.

    Attributes:
        permeability: k [length^3], a symmetric 2 x 2 tensor, on a line 1 x 1: the mean flux per
            length is k / viscosity times the drop of pressure per length; g^3 / 12 between parallel
            plates. The second index is the side along which the pressure falls.
        viscosity: the given viscosity [pressure time].
        drop: for each side along which the pressure falls, by how much it has fallen, over the mean
            drop per length [length]; NaN where nothing flows through.
        flux: for each such side and each side of the grid, the flux per length through the face to
            the next point, times the viscosity, over the mean drop per length [length^3].

    Example:
        >>> open = js.equilibrate(contact, js.MeanGap(0.1))
        >>> js.leakage(contact, open).permeability.shape
        (2, 2)
    """

    shown: ClassVar[tuple[str, ...]] = ("permeability",)

    permeability: Annotated[Float[Array, "sides sides"], VOLUME]
    viscosity: Annotated[Scalar, VISCOSITY]
    drop: Annotated[Float[Array, " sides *grid"], LENGTH] | None
    flux: Annotated[Float[Array, " sides sides *grid"], VOLUME] | None

    def rate(self, drop_per_length: ArrayLike) -> Float[Array, " sides"]:
        """Return the mean flux per length along each side [length^2/time].

        Along a path it is the flux of each state.

        Arguments:
            drop_per_length: how the pressure falls in the mean along each side [pressure/length].

        Raises:
            ValueError: unless there is one for each side.
        """
        drop = cast(parameter(drop_per_length, "The drop per length"), self.permeability.dtype)
        sides = self.permeability.shape[-1]
        if drop.shape != (sides,):
            raise ValueError(
                f"The drop per length has shape {drop.shape}: give one for each of the {sides} "
                f"sides, as in rate({[1.0, 0.0][:sides]})."
            )
        return self.permeability @ drop / self.viscosity[..., None]


def leakage(
    contact: Contact,
    equilibrium: State,
    viscosity: ArrayLike = 1.0,
    *,
    solver: Solver | None = None,
) -> Leakage:
    """Return the leakage through the gap of a contact.

    Reynolds' equation div(g^3 grad p) = 0 under a mean gradient along each side, by finite volumes:
    the face between two points conducts the harmonic mean of their g^3, points in contact
    (`Equilibrium.in_contact`) block.
    If no channel leads around the periodic cell the permeability is exactly zero. Valid for gaps of
    small slope and a viscous fluid that does not move the surfaces.

    Does not work inside `jax.jit`, `jax.vmap` or `jax.grad`. It computes in
    double precision, and its result has the contact's.

    Arguments:
        contact: the contact problem, of a periodic solid.
        equilibrium: one of its states.
        viscosity: the viscosity of the fluid [pressure time].
        solver: "direct" factors the sparse matrix, by SciPy: for any contrast. "multigrid" needs
            less memory and PyAMG (`pip install 'jaxstab[leakage]'`), and more steps the more gaps
            differ. By default direct up to two million points that conduct.

    Raises:
        ValueError: on a window, which does not repeat, for a viscosity that is not positive, a
            solver that does not exist, a stack of states, one that was not found, and one of
            another grid.
        TypeError: for something that is not a state, or inside of a JAX transformation.
        SolverError: if fluxes do not balance, or the permeability is not known to 1e-7.
        ImportError: for multigrid without PyAMG.

    Example:
        >>> open = js.equilibrate(contact, js.MeanGap(0.1))
        >>> [f"{x:.1e}" for x in jnp.diag(js.leakage(contact, open).permeability)]
        ['4.7e-05', '5.1e-05']
    """
    require_known((contact, equilibrium), "leakage")
    state = found_equilibrium(contact, equilibrium)
    if contact.solid.is_window:
        raise ValueError(
            f"The solid is a {type(contact.solid).__name__}, a window that does not repeat: the "
            "flow through it depends on what lies beyond its edges. Use a periodic solid."
        )
    if solver is not None:
        require_one_of("solver", solver, ("direct", "multigrid"))
    resistance = positive_scalar(viscosity, "The viscosity")
    values = np.asarray(state.gap, float)
    dtype = contact.heights.dtype
    largest = values.max()
    conductivity = values
    if largest > 0:
        # The unit is the largest gap, whose cube can be beyond the range of numbers.
        conductivity = (values / largest) ** 3 / 12
    faces, leads = conducting(conductivity, ~np.asarray(state.in_contact))
    found = flows(faces, leads, np.asarray(contact.grid.spacing, float), solver)
    permeability = _permeability(found, leads) * largest**3
    return Leakage(
        permeability=array(permeability, dtype),
        viscosity=array(resistance, dtype),
        drop=array([flow.drop for flow in found], dtype),
        flux=array(largest**3 * np.stack([flow.flux for flow in found]), dtype),
        units=contact.units,
    )


def _permeability(found: list[Flow], leads: np.ndarray) -> Float[np.ndarray, "sides sides"]:
    """Return the mean fluxes along each side, exactly zero where no way leads along it."""
    means = [flow.flux.reshape(len(found), -1).mean(axis=1) for flow in found]
    tensor = np.where(np.logical_and.outer(leads, leads), np.stack(means, axis=1), 0.0)
    return (tensor + tensor.T) / 2
