"""The lifetime of a viscoelastic contact under a held load."""

from typing import Any

import jax
import numpy as np

from jaxstab.contact import Contact
from jaxstab.contact.resolution import FOR_JUMPS, warned_once
from jaxstab.core.checks import array, positive_scalar, require_kind, require_known
from jaxstab.core.results import RESULTS, SolverError
from jaxstab.core.types import ArrayLike
from jaxstab.equilibrium import Equilibrium, equilibrate
from jaxstab.evolution.evolution import Evolution, relaxed_contact, require_viscoelastic
from jaxstab.evolution.evolve import evolve
from jaxstab.evolution.legs import RTOL
from jaxstab.loads import Load, MeanPressure, require_loads


def lifetime(
    contact: Contact,
    load: Load,
    *,
    initial: Equilibrium | Evolution | None = None,
    until: ArrayLike | None = None,
    rtol: float | None = None,
) -> float:
    """Return the time to detachment under a load that is applied at once and then held.

    The contact has detached once a dead load has pulled the surfaces apart, or once no point is in
    contact. A law with a core keeps every gap open, so that there only the first counts.

    Arguments:
        contact: the contact, of a `Viscoelastic` solid.
        load: the load, a single value.
        initial: a state in contact before, as in `evolve`; by default relaxed, without a load.
        until: how long to follow the contact [time]; by default a thousand times the longest
            relaxation time.
        rtol: the error of a step, as in `evolve`, and of a time where points lose contact smoothly.

    Returns:
        The time [time]: zero if it detaches at once, infinite if the relaxed solid has an
        equilibrium in contact where the contact has come to rest.

    Raises:
        TypeError: for a solid that is not viscoelastic, a start that is no state, and under JAX
            transformations.
        ValueError: for an array of loads, and an initial state without contact.
        SolverError: where an equilibrium is not found for another reason than detachment, and for a
            contact that has not come to rest.

    Example:
        >>> contact = js.Contact(js.Viscoelastic(solid, (1.0,), (0.1,)), heights, law)
        >>> f"{js.lifetime(contact, js.MeanPressure(-0.2)):.2f}"
        '0.50'
    """
    require_viscoelastic(contact)
    if rtol is None:
        rtol = RTOL[contact.heights.dtype.name]
    require_known((contact, load, initial, until), "lifetime")
    require_loads(load, (), "lifetime takes one load", "use a loop.")
    with warned_once(contact, FOR_JUMPS):
        return _lifetime(contact, load, initial, until, rtol)


def _lifetime(contact: Contact, load: Load, initial: Any, until: Any, rtol: Any) -> float:
    solid: Any = contact.solid
    relaxed = relaxed_contact(contact)
    start = initial
    if start is None:
        start = equilibrate(relaxed, MeanPressure(0.0))
    require_kind(start, Equilibrium | Evolution, "no state: give one of equilibrate or evolve.")
    # Where a core keeps every gap open, a dead load alone detaches the surfaces.
    has_core = bool(contact.has_core)
    if not (has_core or np.asarray(start.contact_area).flat[-1] > 0):
        raise ValueError(
            "The initial state has no point in contact, so that nothing can detach: give "
            "`initial`, a state in contact."
        )
    # NumPy compiles nothing.
    relaxation_times = np.asarray(solid.times, float)
    if until is None:
        until = 1000 * relaxation_times[-1]
    end = float(positive_scalar(until, "until"))
    # Four times a decade, from a small part of the shortest relaxation time on.
    first = min(1e-4 * relaxation_times[0], end / 2)
    count = int(4 * np.log10(end / first)) + 2
    times = np.append(0, np.geomspace(first, end, count))
    after = np.inf
    while True:
        held = jax.tree.map(lambda leaf, n=times.size: array(np.full(n, leaf)), load)
        found = evolve(contact, held, times, initial=start, rtol=rtol, fields=True, throw=False)
        if len(found) < times.size:
            raise KeyboardInterrupt
        result = found.result[-1]
        area = np.asarray(found.contact_area)
        is_apart = bool(result == RESULTS.pulled_off)
        if not (is_apart or result == RESULTS.successful):
            raise SolverError(f"The contact could not be followed: {RESULTS[result]}.", found)
        # Once apart there are no numbers.
        touches = has_core | np.isnan(area) | (area > 0)
        if touches.all() and is_apart:
            return float(found.reached)
        if touches.all():
            break
        place = int(np.argmin(touches))
        before, after = (float(found.times[i]) for i in (max(place - 1, 0), place))
        if after - before <= rtol * after:
            break
        # Points have lost contact between these two: look eight times as often.
        times = np.linspace(before, after, 9)
        start = found[place - 1]
    if after < np.inf:
        # Where shorter steps hold the contact for longer, it is lost at their end.
        return after
    rest = equilibrate(relaxed, load, initial=found.gap, throw=False)
    if rest.result == RESULTS.successful and (has_core or rest.contact_area > 0):
        return np.inf
    raise SolverError(
        f"The contact still holds at {end:.6g}, where the relaxed solid has no "
        "equilibrium: raise `until`.",
        found,
    )
