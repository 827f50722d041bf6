"""The parameter of a contact at which a load path begins to jump.

Without a jump the load rises along the branch from one end to the other. At a cusp a pair of folds
appears in it, between which states are unstable.
"""

import math
from collections.abc import Callable, Sequence
from typing import Annotated

import numpy as np

from jaxstab.branches.branch import Branch, Turn
from jaxstab.branches.continuation import continuation
from jaxstab.contact import Contact, require_contact, require_elastic
from jaxstab.contact.resolution import FOR_JUMPS, warned_once
from jaxstab.core.checks import (
    array,
    parameter,
    positive_scalar,
    require_finite,
    require_known,
)
from jaxstab.core.display import Outcome
from jaxstab.core.progress import progress_bar
from jaxstab.core.results import RESULTS, throw_failure
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.core.units import NUMBER
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load
from jaxstab.states.kinds import KINDS


class FirstJump(Outcome):
    """The parameter at which a load path begins to jump, and where it jumps.

    Attributes:
        parameter: the middle of the bracket [as given].
        error: half the width of the bracket.
        jumping: the end of the bracket at which the path jumps. All below belongs to the contact
            `make_contact(found.jumping)`.
        load: the load at which the path first turns back.
        kind: a member of `KINDS`: a fold, a release, a touch or a bifurcation.
        equilibrium: the state there.
        mode: the unit vector along which the branch goes on, at a bifurcation the other one.
        result: how the search ended.

    Example:
        >>> def contact_of(work):
        ...     return js.Contact(solid, heights, js.potentials.Exponential(work, 0.06))
        >>> onset = js.first_jump(contact_of, (0.01, 0.03), js.MeanGap([0.3, 0.05]))
        >>> bool(onset.jumping > onset.parameter), onset.kind.name
        (True, 'fold')
    """

    parameter: Annotated[Scalar, NUMBER]
    error: Annotated[Scalar, NUMBER]
    jumping: Annotated[Scalar, NUMBER]
    load: Load
    kind: KINDS
    equilibrium: Equilibrium
    mode: Annotated[Field, NUMBER]
    result: RESULTS


def first_jump(
    make_contact: Callable[[Scalar], Contact],
    bracket: Sequence[ArrayLike],
    load: Load,
    *,
    rtol: ArrayLike = 1e-3,
    progress: bool | None = None,
    throw: bool = True,
) -> FirstJump:
    """Return the parameter of a contact at which a path between two loads begins to jump.

    The parameter is a voltage, a work of adhesion, a height or any other number that
    `make_contact` turns into a contact. A path jumps if the load turns back along its branch, or
    another branch crosses it: `jaxstab.continuation` tells both, without jumping itself. The
    bracket is halved, so that the search cannot pass the first jump, however fast the eigenvalue
    that vanishes there changes; at a cusp the energy of the jump vanishes too, so that
    `jaxstab.follow` sees it only farther beyond. All turns count: on a coarse grid
    (`contact.resolution`) contact edges jump from point to point.

    Does not work inside `jax.jit`, `jax.vmap` or `jax.grad`.

    Arguments:
        make_contact: returns the contact for a value of the parameter, a scalar array. Classes of
            laws and solids, and numbers that enter as arrays, share one compilation.
        bracket: two values: one without a jump, and one with, in either order.
        load: two loads: where the path begins, and where it ends.
        rtol: the error, over the width of the bracket, at which to stop.
        progress: show a progress bar; by default after two seconds, in a terminal or notebook.
        throw: raise if a branch inside of the bracket could not be followed; otherwise look at
            `result`, with the error reached so far.

    Raises:
        ValueError: for other than two finite parameters, a tolerance that is not positive, loads
            that are invalid in `continuation`, and for two ends of which both jump, or neither.
        TypeError: for a function that returns no contact, and inside of a JAX transformation.
        SolverError: if a branch at an end of the bracket could not be followed; if `throw`, also
            inside of it.

    Example:
        >>> def contact_of(work):
        ...     return js.Contact(solid, heights, js.potentials.Exponential(work, 0.06))
        >>> onset = js.first_jump(contact_of, (0.01, 0.03), js.MeanGap([0.3, 0.05]))
        >>> f"{onset.parameter:.4f}"
        '0.0253'
    """
    require_known((bracket, load), "first_jump")
    ends = np.asarray(parameter(list(bracket), "The bracket"), float)
    require_finite("The bracket", ends)
    if ends.shape != (2,) or ends[0] == ends[1]:
        raise ValueError(f"The bracket is {bracket}: give two values that differ.")
    width = float(np.ptp(ends))
    tolerance = float(positive_scalar(rtol, "rtol")) * width
    number = 2 + max(0, math.ceil(math.log2(width / (2 * tolerance))))
    contacts = [make_contact(array(value)) for value in ends]
    require_contact(contacts[0])
    require_elastic(contacts[0], "first_jump")
    with (
        warned_once(contacts[0], FOR_JUMPS),
        progress_bar("first jump", number, "path", shown=progress) as bar,
    ):

        def path(contact: Contact, must_hold: bool) -> tuple[Branch, Turn | None, RESULTS]:
            branch = continuation(contact, load, progress=False, throw=must_hold)
            bar.update()
            if len(branch.turns.state):
                return branch, branch.turns[0], RESULTS.successful
            return branch, None, _result(branch)

        turns = []
        for contact in contacts:
            branch, turn, result = path(contact, True)
            turns.append(turn)
            throw_failure(result, branch, lambda: "A path at an end of the bracket is not known")
        _require_a_bracket(ends, turns)
        place = int(turns[0] is None)
        jumping, calm = float(ends[place]), float(ends[1 - place])
        first = turns[place]
        result = RESULTS.successful
        while result == RESULTS.successful and abs(jumping - calm) > 2 * tolerance:
            middle = (jumping + calm) / 2
            _, turn, result = path(make_contact(array(middle)), False)
            if turn is not None:
                jumping, first = middle, turn
            elif result == RESULTS.successful:
                calm = middle
    found = FirstJump(
        parameter=array((jumping + calm) / 2),
        error=array(abs(jumping - calm) / 2),
        jumping=array(jumping),
        load=first.load,
        kind=first.kind,
        equilibrium=first.equilibrium,
        mode=first.mode,
        result=result,
    )
    # A search that fails does so in the middle of its bracket.
    describe = f"The path at the parameter {float(found.parameter):.6g} is not known"
    return throw_failure(result, found, lambda: describe, throw)


def _result(branch: Branch) -> RESULTS:
    """Return how a branch without turns has ended; unstable states without one are unresolved."""
    is_unresolved = (branch.result == RESULTS.successful) & np.any(np.asarray(branch.index) > 0)
    return RESULTS.where(is_unresolved, RESULTS.lost_branch, branch.result)


def _require_a_bracket(ends: np.ndarray, turns: list[Turn | None]) -> None:
    jump = [turn is not None for turn in turns]
    if jump[0] == jump[1]:
        word = "both jump" if jump[0] else "neither jumps"
        raise ValueError(
            f"The paths at the parameters {ends[0]:.6g} and {ends[1]:.6g}: {word}. Give one "
            "parameter without a jump and one with."
        )
