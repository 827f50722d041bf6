"""The patches of a contact, and the area that a grid counts too much."""

from typing import Annotated, ClassVar

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxstab.contact import Contact
from jaxstab.core.checks import array, require_known, require_one_of
from jaxstab.core.rings import Rings
from jaxstab.core.types import Scalar
from jaxstab.core.units import AREA, FORCE, LENGTH
from jaxstab.equilibrium.equilibrium import State, defined_contact
from jaxstab.equilibrium.observables.clusters import Neighbours, clusters_of
from jaxstab.equilibrium.observables.observable import Observable
from jaxstab.equilibrium.validity import warn_of_few_points

# The grid counts this part of interface times spacing too much (Yastrebov et al., 2017).
_STAIRCASE = (np.pi - 1 + np.log(2)) / 24


class Patches(Observable):
    """The patches of a contact, the largest first.

    Along a path the parts for each patch and each point are None.

    Attributes:
        number: how many there are.
        areas: of each, by its points [length^2]; on a line its length [length].
        perimeters: of each, along the sides of its points [length]: of a disc 4 / pi times the
            circumference. On a line the number of ends.
        forces: the elastic pressure summed over each: reaction minus attraction, positive in
            compression [force]; on a line [force/length].
        percolates: for each side, whether a patch goes on along it without end, around the periodic
            cell; on a window, whether a patch reaches both edges.
        area: the area of all points in contact [length^2]; on a line a length.
        true_area: the area minus the excess of the grid, (pi - 1 + ln 2) / 24 of the
            perimeters times the spacing, and not below zero [length^2]. On a line the same.
        largest: the area of the largest patch, zero without contact [length^2].
        perimeter: the length of the whole interface, along the sides of points [length].
        labels: the patch of each point, from 1 on; 0 out of contact.

    Example:
        >>> patches = js.patches(contact, state)
        >>> f"{patches.areas.sum():.3f}", [bool(x) for x in patches.percolates]
        ('0.324', [True, False])
    """

    shown: ClassVar[tuple[str, ...]] = ("number", "true_area")

    number: Int[Array, ""]
    areas: Annotated[Float[Array, " patches"], AREA] | None
    perimeters: Annotated[Float[Array, " patches"], LENGTH] | None
    forces: Annotated[Float[Array, " patches"], FORCE] | None
    percolates: Bool[Array, " sides"]
    area: Annotated[Scalar, AREA]
    true_area: Annotated[Scalar, AREA]
    largest: Annotated[Scalar, AREA]
    perimeter: Annotated[Scalar, LENGTH]
    labels: Int[Array, " *grid"] | None


def patches(contact: Contact, equilibrium: State, *, neighbours: Neighbours = 4) -> Patches:
    """Return the patches of a contact: points in contact that are connected.

    Patches are joined across the edges of a periodic cell; on a window, as with a `FreeHalfSpace`,
    they are not, and points beyond its edges do not touch.

    The number of patches depends on the state, so this does not work inside `jax.jit`, `jax.vmap`
    or `jax.grad`. Areas are constant between changes of the contact.

    The area is corrected as by V. A. Yastrebov, G. Anciaux and J. F. Molinari (2017): a
    point counts with its whole cell, and a smooth interface cuts cells.

    A point is in contact as `Equilibrium.in_contact` says, also under a law with a core.

    Arguments:
        contact: the contact problem.
        equilibrium: one of its states.
        neighbours: 4 joins points along the sides of the grid, 8 also along diagonals.

    Warns:
        ContactWarning: for a contact of a handful of points, fewer than 5 along each side.

    Raises:
        ValueError: for other numbers of neighbours, a stack of states, one that was not
            found, or one of another grid, and where contact is not defined: without a closed gap
            under a law that repels at every gap; and on rings, where patches are annuli.
        TypeError: for something that is not a state, or inside of a JAX transformation.

    Example:
        >>> patches = js.patches(contact, state)
        >>> int(patches.number), f"{patches.largest:.3f}"
        (6, '0.184')
    """
    require_one_of("neighbours", neighbours, (4, 8))
    require_known((contact, equilibrium), "patches")
    state = defined_contact(contact, equilibrium)
    if isinstance(contact.grid, Rings):
        raise ValueError(
            f"The grid is {contact.grid!r}: the patches of an axisymmetric contact are a disc and "
            "annuli, between circles. Read `contact_area` and `in_contact` of the equilibrium."
        )
    warn_of_few_points(contact, state.contact_area)
    mask = np.asarray(state.in_contact)
    is_window = contact.solid.is_window
    found = clusters_of(mask, neighbours, not is_window)
    ends = _ends(mask, is_window)
    cell = float(contact.grid.cell_area)
    lengths = np.ones(1)
    excess = 0.0
    if mask.ndim == 2:
        lengths = np.asarray(contact.grid.spacing, float)[::-1]
        excess = _STAIRCASE * cell * ends.sum()
    sides = np.tensordot(lengths, ends, 1)
    numbers = [np.ones(mask.shape), sides, np.asarray(state.pressure, float)]
    counts, perimeters, forces = (
        np.bincount(found.labels.ravel(), field.ravel(), found.number + 1)[1:] for field in numbers
    )
    order = np.argsort(-counts, kind="stable")
    ranks = np.zeros(found.number + 1, int)
    ranks[order + 1] = np.arange(1, found.number + 1)
    dtype = contact.heights.dtype
    counted = cell * counts.sum()
    return Patches(
        number=array(found.number, int),
        areas=array(cell * counts[order], dtype),
        perimeters=array(perimeters[order], dtype),
        forces=array(cell * forces[order], dtype),
        percolates=array(found.spans.any(axis=0)),
        area=array(counted, dtype),
        true_area=array(max(counted - excess, 0.0), dtype),
        largest=array(cell * counts.max(initial=0), dtype),
        perimeter=array(perimeters.sum(), dtype),
        labels=jax.device_put(ranks[found.labels]),
        units=contact.units,
    )


def _ends(
    touches: Bool[np.ndarray, " *grid"], is_window: bool
) -> Float[np.ndarray, " sides *grid"]:
    """Return for each side of the grid at how many ends of a point the contact ends."""
    around = np.pad(touches, 1, mode="wrap")
    if is_window:
        around = np.pad(touches, 1)
    inner = (slice(1, -1),) * touches.ndim
    beside = [
        [~np.roll(around, step, side)[inner] for step in (-1, 1)] for side in range(touches.ndim)
    ]
    return touches * np.sum(beside, axis=1, dtype=float)
