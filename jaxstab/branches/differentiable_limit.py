"""The load at which a stable branch ends, and its derivatives with respect to the contact.

By the implicit function theorem: let x be the mode of a fold, or at a release the move that opens
the point, x_p = 1, with the free points following at no cost. Both do no work to first order, and
A x = 0 on the free points. So with r the net pressure, dl = -(x.dr) / (x.dr/dl).
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from jaxstab.branches.limit import Limit, limit_ahead
from jaxstab.branches.response import free_space, opening, response
from jaxstab.contact import Contact
from jaxstab.core.accuracy import NEGLIGIBLE
from jaxstab.core.compile import program
from jaxstab.core.control_flow import choose
from jaxstab.core.display import Outcome
from jaxstab.core.grid import total
from jaxstab.core.implicit import attach, finite, tangent_of
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.derivatives import changing_points, free_system, third_derivative
from jaxstab.equilibrium.equilibrium import DIFFERENTIABLE, Fields, fields_of, state_at
from jaxstab.loads import Load
from jaxstab.stability import Eigenpair
from jaxstab.stability.cones import Subspace
from jaxstab.stability.derivatives import differentiable as differentiable_pair
from jaxstab.states.kinds import KINDS

Inputs = tuple[Contact, Load]
Changes = tuple[Scalar, Field]


class CriticalLoad(Outcome):
    """Where a branch of stable equilibria ends, or at a bifurcation goes on unstable.

    Attributes:
        equilibrium: the last equilibrium of the branch, with its load.
        kind: a member of `KINDS`: a fold, a release or a bifurcation; uncertain where the branch
            ends, but the condition of none is met.
        critical: the smallest eigenvalue on the points that are free or released, and its mode. It
            is negative at a release, and zero elsewhere. `Stability.critical` leaves out the points
            that are released, and is still positive just before a release.
        after: the state that remains beyond a pull-off; otherwise None.
        result: a member of `RESULTS`: how the search ended.

    Example:
        >>> pull = js.pull_off(contact)
        >>> pull.kind.name, pull.after.result.name
        ('release', 'pulled_off')
    """

    equilibrium: Equilibrium
    kind: KINDS
    critical: Eigenpair
    after: Equilibrium | None
    result: RESULTS

    @property
    def load(self) -> Load:
        """The critical load."""
        return self.equilibrium.load


@program
def critical_load_at(contact: Contact, loads: Load, limit: Limit) -> CriticalLoad:
    """Return the limit of a branch as a differentiable function of the contact and its loads.

    The values of the loads have no effect on it.
    """
    limit = replace(limit, load=loads[0].at(limit.load.value))
    known = limit.load.value, limit.gap
    value, gap = attach(_changes_of_limit, known, limit, _inputs(contact, limit.load))
    load = limit.load.at(value)
    is_found = limit.is_found
    known = jnp.where(is_found, limit.gap, jnp.nan)
    state = state_at(*jax.lax.stop_gradient((contact, limit.load, known)))
    fields = {name: getattr(state, name) for name in DIFFERENTIABLE}
    fields = attach(_changes_of_fields, fields, is_found, (contact, load, gap))
    space = Subspace((limit.gap > 0) | limit.point, contact.control(load).fixes_mean)
    eigenvalue = jnp.where(is_found, limit.critical.eigenvalue, jnp.nan)
    pair = replace(limit.critical, eigenvalue=eigenvalue, result=limit.result)
    return CriticalLoad(
        equilibrium=replace(
            state,
            load=load,
            area=contact.area,
            residual=limit.residual,
            num_steps=limit.num_steps,
            result=limit.result,
            **fields,
        ),
        kind=limit.kind,
        critical=differentiable_pair(pair, space, contact, load, gap),
        after=None,
        result=limit.result,
    )


def differentiable_value(load: Load, gap: Field, ahead: Scalar, contact: Contact) -> Scalar:
    """Return the load of a state close to a limit as a function of the contact, as that one's is.

    It is located only if a derivative is requested.
    """
    return attach(_changes_near_limit, load.value, (gap, ahead), _inputs(contact, load))


def _inputs(contact: Contact, load: Load) -> Inputs:
    """Return the inputs on which the load of a limit depends: its own value is none of them."""
    return contact, load.at(jax.lax.stop_gradient(load.value))


def _changes_near_limit(
    value: Scalar, known: tuple[Field, Scalar], inputs: Inputs, changes: Inputs
) -> tuple[Scalar, Flag]:
    contact, load = jax.lax.stop_gradient(inputs)
    limit = limit_ahead(contact, load, *known)
    values = attach(_changes_of_limit, (limit.load.value, limit.gap), limit, inputs)
    (change, _), is_undefined = _changes_of_limit(values, limit, inputs, changes)
    return change, is_undefined


def _changes_of_limit(
    values: Changes, limit: Limit, inputs: Inputs, changes: Inputs
) -> tuple[Changes, Flag]:
    is_found = limit.is_found & (limit.kind != KINDS.uncertain)
    is_release = limit.kind == KINDS.release
    (contact, load), (value, gap), pair = finite(is_found, (inputs, values, limit.critical))
    # In second derivatives the load of the limit moves.
    load = load.at(value)
    control = contact.control(load)
    space = free_space(contact, load, gap)
    pair = differentiable_pair(pair, space, contact, load, gap)
    net, gap_rate, net_rate = response(contact, load, gap)
    slope = third_derivative(contact, gap) * pair.mode**2
    # By symmetry the load does not act on the mode, or the eigenvalue does not change along it.
    driven = _cosine(pair.mode, space.project(net_rate))
    bent = _cosine(pair.mode, slope)
    least = NEGLIGIBLE[gap.dtype.name]
    branches_off = ~(jnp.minimum(jnp.abs(driven), jnp.abs(bent)) > least)
    branches_off |= jnp.abs(pair.eigenvalue) > least * contact.solid.min_stiffness
    coinciding = changing_points(net, gap, contact.solid) & ~limit.point
    coincides = limit.is_tied | jnp.any(coinciding)
    is_undefined = ~is_found | (branches_off & ~is_release) | coincides

    def pressures(contact: Contact, load: Load) -> tuple[Field, Field, Field]:
        fields, net = fields_of(contact, load, gap)
        moved = contact.hessian(fields["gap"], contact.control(load))(pair.mode)
        return fields["gap"], net, moved

    shift, net_change, moved_change = tangent_of(pressures, (contact, load), changes)

    def changes_along(direction: Field, system: LinearSystem, is_of_kind: Flag) -> Changes:
        # A linear system with a zero right-hand side converges at once.
        unbalanced = jnp.where(is_of_kind & ~is_undefined, net_change, 0)
        work = total(direction * net_rate)
        change = -total(direction * unbalanced) / jnp.where(work == 0, 1, work)
        move = system.differentiable_solution(-unbalanced - change * net_rate)
        return change, move + change * gap_rate

    def changes_of_fold() -> Changes:
        # The eigenvalue stays zero.
        change, move = changes_along(
            pair.mode, _regular_system(contact, load, gap, pair), ~is_release
        )
        bend = total(slope * pair.mode)
        turned = total(slope * move) + total(pair.mode * moved_change)
        along = jnp.where(is_undefined, 0, turned) / jnp.where(bend == 0, 1, bend)
        return change, move - along * pair.mode

    def changes_of_release() -> Changes:
        direction = opening(contact, load, gap, limit.point)
        return changes_along(direction, free_system(contact, control, gap), is_release)

    change, move = choose(is_release, changes_of_release(), changes_of_fold())
    return (change, shift + move), is_undefined


def _cosine(mode: Field, field: Field) -> Scalar:
    return total(mode * field) / jnp.sqrt(total(field**2))


def _regular_system(contact: Contact, load: Load, gap: Field, pair: Eigenpair) -> LinearSystem:
    """Return the system of A + s x x^T on the free points: at a simple fold it is not singular."""
    space = free_space(contact, load, gap)
    hessian = contact.hessian(gap, contact.control(load)).restriction(space.is_moving)
    mode = pair.mode
    stiffness = contact.solid.min_stiffness

    def operator(field: Field) -> Field:
        return hessian(field) + stiffness * total(mode * field) * mode

    precondition = hessian.preconditioner(mode, pair.eigenvalue)
    return LinearSystem(operator, precondition, space.project)


def _changes_of_fields(
    fields: Fields, is_found: Flag, inputs: tuple, changes: tuple
) -> tuple[Fields, Flag]:
    moved, _ = tangent_of(fields_of, finite(is_found, inputs), changes)
    return moved, ~is_found
