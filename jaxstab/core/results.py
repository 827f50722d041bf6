"""How a solve can end, and how a failure is raised."""

from collections.abc import Callable
from typing import Any, TypeVar

from jaxtyping import Array, Bool

from jaxstab.core.checks import is_traced
from jaxstab.core.enumeration import Enumeration, member

Tree = TypeVar("Tree")


class RESULTS(Enumeration):
    """How a solve ended: a name, and what to make of it."""

    successful = member("the tolerance was reached")
    max_steps_reached = member(
        "the step limit came before the tolerance. Raise the solver's "
        "`max_steps`, loosen its `tolerance`, or start nearer to the solution"
    )
    stagnated = member(
        "progress ended before the residual reached the tolerance. Either the "
        "tolerance is finer than the precision can hold (loosen it, or use float64), or the solver "
        "is caught between states (start elsewhere, for instance from a neighbouring load)"
    )
    nonfinite = member(
        "a NaN or an infinity appeared. Check that the potential and its two "
        "derivatives are finite for every gap >= 0 (one that is infinite at zero gap needs "
        "PreconditionedConjugateGradient), and that no input is NaN"
    )
    invalid_contact = member(
        "the heights are not finite, or the solid has a stiffness that is not positive, or beyond "
        "the range of the precision. Use a modulus > 0, a Poisson's ratio in (-1, 0.5], or other "
        "units"
    )
    infeasible_load = member(
        "a mean gap must be positive and finite, as the surfaces cannot enter "
        "each other, and a mean pressure finite; what holds a far side needs a finite stiffness, "
        "where a half space has none and an incompressible layer an infinite one. Prescribe a mean "
        "displacement above the mean height"
    )
    sunk = member(
        "the solid is pressed in deeper than the surface reaches down, and comes round its edges. "
        "Press less, or take a larger window"
    )
    pulled_off = member(
        "no equilibrium was found at this tensile load, which drew the surfaces apart "
        "for good. Pull less, start from a state in contact, or prescribe the mean gap instead"
    )
    no_equilibrium = member(
        "there was no converged equilibrium to assess. Look at the result of the equilibrium"
    )
    other_contact = member(
        "the state is not in equilibrium in this contact, whose pressures it leaves "
        "out of balance. Use the contact and the load that it came from"
    )
    no_fold = member(
        "between the two loads neither the critical eigenvalue was seen to vanish, nor a contact "
        "point to let go in a jump. Look at a path between them, by jaxstab.follow, and narrow the "
        "bracket"
    )
    no_jump = member(
        "the surfaces came apart without a jump, since the machine is stiff enough to hold them on "
        "all the way. Take the largest tension of a path, by jaxstab.follow, or a softer machine"
    )
    store_full = member(
        "the store is full before the end. Give it more room (`max_states`, `max_jumps`), follow a "
        "shorter programme, or locate fewer jumps (`smallest_jump`)"
    )
    interrupted = member("it was interrupted; what was done until then is there")
    same_state = member(
        "both states relax to the same one at this load. Give two that are apart, such as the two "
        "sides of a jump at a load right before it"
    )
    no_pass = member(
        "no equilibrium with one negative eigenvalue was found near the highest state of the "
        "string. Give more images (`num_images`), or states that are closer to each other: there "
        "may be minima between them"
    )
    not_computed = member(
        "another number had already proved the verdict. Assess without `verdict_only`"
    )
    too_many_modes = member(
        "there are fewer admissible directions than modes asked for. Ask for fewer (`count`)"
    )


class SolverError(RuntimeError):
    """A solver did not reach its tolerance; the message says why and what to try.

    Attributes:
        found: what was found all the same, as with `throw=False`; None of a derivative.
    """

    def __init__(self, message: str, found: Any = None):
        super().__init__(message)
        self.found = found


def throw_failure(
    result: RESULTS, tree: Tree, describe: Callable[[], str], throw: bool = True
) -> Tree:
    """Return `tree`, or raise if `result` is not successful and failures are thrown.

    Outside of JAX transformations the error is a `SolverError` that begins with `describe()`
    and holds the tree; inside, one of Equinox's runtime errors, raised if any lane failed.
    """
    if not throw:
        return tree
    failed: Bool[Array, ...] = result != RESULTS.successful
    if is_traced(failed):
        return result.error_if(tree, failed)
    if failed:
        raise SolverError(f"{describe()}: {RESULTS[result]}.", tree)
    return tree
