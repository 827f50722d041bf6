"""The mean pressure at which the last path of leakage through a contact closes."""

from typing import Annotated, Literal

import numpy as np

from jaxstab.contact import Contact, require_contact, require_elastic
from jaxstab.contact.resolution import FOR_STATES, warned_once
from jaxstab.core.checks import array, positive_scalar, require_known, require_one_of
from jaxstab.core.compile import program
from jaxstab.core.display import Outcome
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS, SolverError
from jaxstab.core.types import ArrayLike, Scalar
from jaxstab.core.units import PRESSURE
from jaxstab.equilibrium import Equilibrium, equilibrate
from jaxstab.equilibrium.observables.clusters import clusters_of
from jaxstab.equilibrium.start import Initial
from jaxstab.loads import MeanPressure

# The first trial, over the rms pressure of full contact: a path closes near a half of the area.
_FIRST = 1 / 16
# Full contact takes a few times its rms pressure, and a core not much more.
_MAX_DOUBLINGS = 20


class SealingPressure(Outcome):
    """The mean pressure at which a path of leakage closes.

    Attributes:
        pressure: the middle of the bracket; zero if adhesion closes the path at zero load
            [pressure].
        error: half the width of the bracket [pressure].
        before: the last state found with a path through it.
        after: the first state found without.

    Example:
        >>> bare = js.Contact(solid, heights, js.potentials.NoAdhesion())
        >>> sealing = js.sealing_pressure(bare)
        >>> bool(sealing.before.contact_area < sealing.after.contact_area)
        True
    """

    pressure: Annotated[Scalar, PRESSURE]
    error: Annotated[Scalar, PRESSURE]
    before: Equilibrium
    after: Equilibrium


def sealing_pressure(
    contact: Contact,
    side: Literal["x", "y"] = "x",
    *,
    rtol: ArrayLike = 1e-3,
    initial: Initial = None,
    progress: bool | None = None,
) -> SealingPressure:
    """Return the mean pressure above which nothing leaks through a contact along a side.

    There the points out of contact cease to percolate around the periodic cell along the side, and
    the `permeability` of `jaxstab.leakage` along it becomes zero. The pressure is doubled until the
    path is closed, and the bracket then halved. Each state is sought from the last open one, as in
    an approach: with adhesion the path opens again at a lower pressure than this one.

    The pressure of a random surface in one cell varies from realisation to realisation. Does not
    work inside `jax.jit`, `jax.vmap` or `jax.grad`.

    Arguments:
        contact: the contact problem, of a periodic solid.
        side: the side along which the pressure of the fluid falls.
        rtol: the error over the pressure at which to stop.
        initial: where the state at zero mean pressure starts, as in `equilibrate`.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.

    Raises:
        ValueError: on a window, which does not repeat, for a side that the grid does not have, and
            a tolerance that is not positive.
        TypeError: inside of a JAX transformation.
        SolverError: if an equilibrium is not found, or no pressure closes the path.

    Example:
        >>> bare = js.Contact(solid, heights, js.potentials.NoAdhesion())
        >>> f"{js.sealing_pressure(bare).pressure:.3f}"
        '0.162'
    """
    require_contact(contact)
    require_elastic(contact, "sealing_pressure")
    require_known((contact, initial), "sealing_pressure")
    require_one_of("side", side, "xy"[: len(contact.grid.shape)])
    tolerance = float(positive_scalar(rtol, "rtol"))
    if contact.solid.is_window:
        raise ValueError(
            f"The solid is a {type(contact.solid).__name__}, a window that does not repeat: the "
            "flow goes around the contact. Use a periodic solid."
        )
    axis = "xy".index(side)

    def is_open(state: Equilibrium) -> bool:
        return bool(clusters_of(~np.asarray(state.in_contact)).spans[:, axis].any())

    with (
        warned_once(contact, FOR_STATES),
        progress_bar("sealing pressure", 0, "state", shown=progress) as bar,
    ):
        # Without load and attraction there is no state to find, and nothing is closed.
        before = equilibrate(contact, MeanPressure(0.0), initial=initial, throw=False)
        unit = float(_conforming_pressure(contact))
        is_found = bool(before.result == RESULTS.successful)
        if unit == 0 or (is_found and not is_open(before)):
            zero = array(0.0, contact.heights.dtype)
            return SealingPressure(zero, zero, before, before)
        start = before if is_found else initial
        low, high = 0.0, _FIRST * unit
        after = None
        while after is None or high - low > tolerance * (low + high):
            trial = (low + high) / 2 if after is not None else high
            found = equilibrate(contact, MeanPressure(trial), initial=start)
            bar.update()
            if not is_open(found):
                high, after = trial, found
                continue
            low, before, start = trial, found, found
            if after is None:
                high = 2 * trial
            if high > 2.0**_MAX_DOUBLINGS * unit:
                raise SolverError(f"No mean pressure up to {trial:.6g} closes the path.", found)
    dtype = contact.heights.dtype
    return SealingPressure(
        array((low + high) / 2, dtype), array((high - low) / 2, dtype), before, after
    )


@program
def _conforming_pressure(contact: Contact) -> Scalar:
    return contact.conforming_pressure
