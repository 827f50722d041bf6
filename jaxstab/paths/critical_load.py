"""The load at which a stable branch of equilibria ends, in a fold or a release.

At a fold the smallest eigenvalue on the free points vanishes, and the branch turns back:

    K u + p0 + f'(g) = 0 on the free points,   lambda(g) = 0.

At a release the reaction of a contact point vanishes instead, and the energy falls as it opens.
"""

from functools import partial

import jax
import jax.numpy as jnp

from jaxstab.contact import Contact, require_contact
from jaxstab.contact.resolution import FOR_JUMPS, warn_if_coarse
from jaxstab.core.batching import by_entries
from jaxstab.core.checks import is_traced
from jaxstab.core.compile import program
from jaxstab.core.conditional import first_good, if_needed
from jaxstab.core.progress import advance_if_known, can_be_shown, progress_bar
from jaxstab.core.results import throw_failure
from jaxstab.core.types import ArrayLike, Field
from jaxstab.equilibrium.equilibrate import first_gap
from jaxstab.equilibrium.equilibrium import State
from jaxstab.equilibrium.window import whole_start
from jaxstab.loads import Load, require_loads, require_same_machine
from jaxstab.paths.branch_end.approach import SMALLEST_JUMP, follow_to_fold
from jaxstab.paths.branch_end.critical_load import CriticalLoad, critical_load_at
from jaxstab.paths.branch_end.locate import Limit, limit_ahead
from jaxstab.paths.programme import programme_of
from jaxstab.paths.record import Count, Room
from jaxstab.paths.walk import begin, go_on

# Where the branches from the two loads start.
Starts = list[Field | None]
# Two ways, to a fold and to a jump.
_NUM_SEARCHES = 4


def critical_load(
    contact: Contact,
    bracket: Load,
    *,
    initial: ArrayLike | State | None = None,
    progress: bool | None = None,
    throw: bool = True,
) -> CriticalLoad:
    """Return the load at which a branch of stable equilibria ends, on the way between two loads.

    A fold is looked for first, by its eigenvalue. If none is found, the branch is followed to its
    jump, by a release or a fold. The end of a branch need not be a pull-off. Beyond it the contact
    may go on in another state, as rough surfaces often do. `jaxstab.pull_off` gives that,
    `jaxstab.follow` all of them.

    Arguments:
        contact: the contact problem.
        bracket: a load that holds two values: one at which the branch is stable, and one beyond
            its end. If the branch from the first does not end before the second, that from the
            second is followed towards the first.
        initial: where equilibria at both loads start, as in `equilibrate`.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        throw: raise an error if no end is found; otherwise look at `result`.

    Returns:
        The end of the branch. Its load, equilibrium and mode can be differentiated with respect to
        the contact: dl = -(x.dr) / (x.dr/dl), with r the net pressure. At a fold x is the mode; at
        a release it is the move that opens the point, with the free points following. The
        derivative is NaN at a bifurcation of a symmetric state, where two events coincide (another
        point touches or is released at the same load), and where no end was found exactly.

    Raises:
        ValueError: unless there are two loads; for machines that differ, or an initial gap that is
            invalid in `equilibrate`.
        SolverError: if `throw`, where the first load has no stable equilibrium, or its branch does
            not end in the bracket.
    """
    require_contact(contact)
    cure = "give one on the stable branch and one beyond its end."
    require_loads(bracket, (2,), "critical_load takes two loads", cure)
    require_same_machine(bracket)
    warn_if_coarse(contact, FOR_JUMPS)
    whole, starts = contact, []
    for load in bracket:
        whole, start = whole_start(contact, load, first_gap(contact, load, initial))
        starts.append(start)
    own, unit = whole.in_own_units()
    loads = bracket.in_units_of(unit)
    inputs = jax.lax.stop_gradient((own, loads, starts))
    bar = progress_bar(_NUM_SEARCHES, "search", shown=can_be_shown(progress, inputs))
    # Histories end in NaN, and what was not found is NaN.
    with jax.debug_nans(False), bar as bar:
        # Outside of a trace nothing is compiled for a search that is not needed.
        limit = _find_lanes(*inputs) if is_traced(inputs) else _find(*inputs)
        # Not all searches are needed.
        bar.update(_NUM_SEARCHES - bar.n)
    found = critical_load_at(limit, own, loads[0]).in_units_of(1 / unit)
    found = found.on_surface(whole.solid)
    return throw_failure(found.result, found, lambda: _describe(bracket, found), throw)


def _find(contact: Contact, bracket: Load, starts: Starts) -> Limit:
    """Return the end of the branch from the first load, or else of that from the second.

    If there is neither, the message is about the first.
    """

    def end_of(number: ArrayLike) -> Limit:
        there = bracket, starts[0]
        way = contact, *if_needed(number == 1, lambda: (bracket[::-1], starts[1]), there)
        fold = _fold(*way)
        advance_if_known(fold)
        end = if_needed(~fold.is_found, lambda: _jump(*way, fold), fold)
        advance_if_known(end)
        return end

    return first_good(end_of, lambda limit: limit.is_found, 2)


# A program, or `jax.vmap` outside of `jax.jit` would compile it anew with each call.
_find_lanes = program(by_entries(lambda *inputs: _find(*inputs)))


_fold = program(follow_to_fold)


@program
def _jump(contact: Contact, loads: Load, start: Field | None, fold: Limit) -> Limit:
    """Return the jump that ends the branch from the first load, or else the fold not found."""
    first = loads[0]
    smallest_jump = SMALLEST_JUMP[contact.heights.dtype.name]
    programme = programme_of(contact, loads, smallest_jump, disturbance=0.0)
    ended = go_on(programme, begin(programme, start, Count.none, Room(1)))
    jump = jax.tree.map(lambda leaf: leaf[0], ended.jumps.rows)
    limit = limit_ahead(contact, first.at(jump.before.value), jump.before.gap, jump.ahead)
    is_end = limit.is_found & (ended.jumps.count == 1)
    return jax.tree.map(partial(jnp.where, is_end), limit, fold)


def _describe(bracket: Load, found: CriticalLoad) -> str:
    first, last = (float(value) for value in jax.lax.stop_gradient(bracket.value))
    equilibrium = jax.lax.stop_gradient(found.equilibrium)
    return (
        f"No end of a branch found between {type(bracket).__name__}({first:.6g}) and ({last:.6g}): "
        f"the search ended at {float(equilibrium.load.value):.6g} with a residual of "
        f"{float(equilibrium.residual):.3g}"
    )
