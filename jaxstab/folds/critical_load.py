"""The load at which a stable branch of equilibria ends in a fold.

There the smallest eigenvalue on the free points vanishes, and the branch turns back:

    K u + p0 + f'(g) = 0 on the free points,   lambda(g) = 0.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import ArrayLike

from jaxstab.contact import Contact
from jaxstab.display import block
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrate import initial_gap
from jaxstab.equilibrium.state import DIFFERENTIABLE, fields_of
from jaxstab.folds.branch import Field, free_space
from jaxstab.folds.implicit import differentiable, differentiable_fields
from jaxstab.folds.search import follow_to_fold
from jaxstab.loads import Load, require_load, require_same_machine
from jaxstab.programs import program
from jaxstab.resolution import warn_if_coarse
from jaxstab.results import RESULTS, throw_failure
from jaxstab.stability import Eigenpair
from jaxstab.stability.implicit import differentiable as differentiable_pair
from jaxstab.stacks import Stackable


class CriticalLoad(Stackable, eqx.Module):
    """A fold, where a branch of equilibria ends; by symmetry it can branch off there instead.

    Attributes:
        equilibrium: the equilibrium there, with its load.
        critical: the smallest eigenvalue on the free points, which is zero, and its mode.
        result: a member of `RESULTS`: how the search ended.
    """

    equilibrium: Equilibrium
    critical: Eigenpair
    result: RESULTS

    __repr__ = block

    @property
    def load(self) -> Load:
        """The critical load."""
        return self.equilibrium.load


def critical_load(
    contact: Contact,
    bracket: Load,
    *,
    initial: ArrayLike | Equilibrium | None = None,
    throw: bool = True,
) -> CriticalLoad:
    """Return the load at which the critical eigenvalue vanishes, on the way between two loads.

    Arguments:
        contact: the contact problem.
        bracket: a load that holds two values: one at which the branch is stable, and one beyond
            its end. If the branch from the first does not end before the second, that from the
            second is followed towards the first.
        initial: where equilibria at both loads start, as in `equilibrate`.
        throw: raise where no fold is found, or a derivative is asked for that does not exist;
            otherwise look at `result`, and such a derivative is NaN.

    Returns:
        The fold. Its load, equilibrium and mode can be differentiated with respect to the contact:
        dl = -(x.dr) / (x.dr/dl), r being the imbalance on the free points. Where the branch does
        not end but branches off, by symmetry, there is no derivative.

    Raises:
        ValueError: for other than two loads, machines that differ, or an initial gap that
            `equilibrate` refuses.
        SolverError: if `throw`, where the first load has no stable equilibrium, or the eigenvalue
            does not vanish in the bracket.
    """
    require_load(bracket)
    if bracket.value.shape != (2,):
        raise ValueError(
            f"critical_load takes two loads, but {type(bracket).__name__} holds an array of shape "
            f"{bracket.value.shape}: give one on the stable branch and one beyond its end."
        )
    require_same_machine(bracket)
    warn_if_coarse(contact)
    start = initial_gap(contact, bracket, initial)
    # Histories end in NaN, and what was not found is NaN.
    with jax.debug_nans(False):
        found = find_fold(*jax.lax.stop_gradient((contact, bracket, start)))
    found = with_derivatives(contact, bracket, found, throw)
    if not throw:
        return found
    return throw_failure(found.result, found, lambda: _describe(bracket, found))


@program
def find_fold(contact: Contact, bracket: Load, initial: Field | None) -> CriticalLoad:
    """Do what `critical_load` does, on checked arguments, without derivatives."""
    ways = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf[::-1]]), bracket)
    searches = jax.lax.map(lambda loads: follow_to_fold(contact, loads, initial), ways)
    successes = searches.result == RESULTS.successful
    found = jax.tree.map(lambda leaf: leaf[jnp.argmax(successes)], searches)
    is_found = found.result == RESULTS.successful
    load, gap = found.point.load, found.point.gap
    fields, _ = fields_of(contact, load, gap)
    fields["contact_area"] = jnp.mean(gap == 0)
    fields = jax.tree.map(lambda field: jnp.where(is_found, field, jnp.nan), fields)
    return CriticalLoad(
        equilibrium=Equilibrium(
            load=load,
            in_contact=gap == 0,
            residual=found.newton.residual,
            num_steps=found.num_steps,
            result=found.result,
            history=found.newton.history,
            **fields,
        ),
        critical=replace(found.point.pair, result=found.result),
        result=found.result,
    )


def with_derivatives(
    contact: Contact, bracket: Load, found: CriticalLoad, throw: bool
) -> CriticalLoad:
    """Return a fold as a differentiable function of the contact and what the bracket shares."""
    equilibrium, pair = found.equilibrium, found.critical
    load = bracket[0].at(equilibrium.load.value)
    load, gap = differentiable(load, equilibrium.gap, pair, contact, throw)
    fields = {name: getattr(equilibrium, name) for name in DIFFERENTIABLE}
    is_found = found.result == RESULTS.successful
    fields = differentiable_fields(fields, is_found, contact, load, gap, throw)
    space = free_space(contact, load, gap)
    return replace(
        found,
        equilibrium=replace(equilibrium, load=load, **fields),
        critical=differentiable_pair(pair, space, contact, load, gap, throw),
    )


def _describe(bracket: Load, found: CriticalLoad) -> str:
    first, last = (float(value) for value in jax.lax.stop_gradient(bracket.value))
    equilibrium = jax.lax.stop_gradient(found.equilibrium)
    return (
        f"No fold found between {type(bracket).__name__}({first:.6g}) and ({last:.6g}): the search "
        f"ended at {float(equilibrium.load.value):.6g} with a residual of "
        f"{float(equilibrium.residual):.3g}"
    )
