"""The time of a jump as a differentiable function of all that went before.

A viscoelastic contact jumps where the contact that answers at once (`Evolution.instant`) comes to
a fold or a release. Ahead of a fold its state moves ever faster, and along the critical mode; at a
release a reaction vanishes. So the jump is late by dt where dt g' makes up for a change of the gap
along g', or dt times its rate for a change of the reaction.
"""

import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.grid import total
from jaxstab.core.implicit import nan_if
from jaxstab.core.types import Field, Scalar
from jaxstab.equilibrium.derivatives import third_derivative
from jaxstab.equilibrium.equilibrate import with_derivatives
from jaxstab.equilibrium.equilibrium import fields_of, state_at
from jaxstab.loads import Load
from jaxstab.paths.evolution.evolution import Internal, moved_contact, on_gap

# Points are released together within this part of the time until the first is.
_TIE = 1e-6
# An event lies no farther ahead than the jump by this factor, to leading order.
_FARTHEST = 10.0


def time_of_jump(
    contact: Contact, load: Load, slope: Scalar, memory: Internal, until: Scalar
) -> Scalar:
    """Return zero, with the derivative of the time of a jump.

    That is NaN where neither a fold nor a release of one point is ahead.

    Arguments:
        contact: the viscoelastic contact.
        load: the load shortly before the jump.
        slope: the rate of its value.
        memory: the state there.
        until: how much later the contact has jumped [time].
    """

    def instant(contact: Contact, load: Load, memory: Internal, dt: Scalar) -> tuple[Contact, Load]:
        return moved_contact(contact, memory, dt), on_gap(contact, load)

    fixed = jax.lax.stop_gradient((contact, load, memory))
    zero, speed = jnp.zeros_like(until), jax.lax.stop_gradient(slope)
    glassy, held = instant(*fixed, zero)
    state = state_at(glassy, held, fixed[2].gap)

    def later(dt: Scalar) -> tuple[Field, Field]:
        contact, load, memory = fixed
        inputs = instant(contact, load.at(load.value + speed * dt), memory, dt)
        found = with_derivatives(*inputs, state)
        return found.gap, found.reaction

    (gap, reaction), rates = jax.jvp(later, (zero,), (jnp.ones_like(zero),))
    gap_rate, reaction_rate = rates
    falls = (gap == 0) & (reaction_rate < 0)
    releases = jnp.where(falls, -reaction / jnp.where(falls, reaction_rate, 1), jnp.inf)
    release = jnp.min(releases)
    # To leading order, A x = c s x at a distance s from a fold, and s^2 falls linearly in time.
    control = glassy.control(held)
    moving = control.project(gap_rate, gap > 0)
    size = jnp.sqrt(total(moving**2))
    mode = moving / size
    eigenvalue = total(mode * glassy.hessian(gap, control)(mode))
    bend = total(third_derivative(glassy, gap) * mode**3)
    fold = eigenvalue / (2 * jnp.abs(bend) * size)
    is_release = release < fold
    is_tied = is_release & (jnp.sum(releases <= (1 + _TIE) * release) > 1)
    is_event = (jnp.minimum(release, fold) <= _FARTHEST * until) & ~is_tied

    fields, _ = fields_of(*instant(contact, load, memory, zero), memory.gap)
    point = (jnp.arange(gap.size).reshape(gap.shape) == jnp.argmin(releases)).astype(gap.dtype)
    weight, rate = jnp.where(is_release, point, gap_rate), jnp.where(is_release, *rates[::-1])
    weight = jnp.where(is_event, weight / total(weight * rate), 0)
    place = total(weight * jnp.where(is_release, fields["reaction"], memory.gap))
    return nan_if(~is_event, jax.lax.stop_gradient(place) - place)
