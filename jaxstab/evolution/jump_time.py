"""The time of a jump as a differentiable function of all that went before.

A viscoelastic contact jumps where the contact that answers at once (`Evolution.instant`) comes to
a fold or a release. Ahead of a fold its state moves ever faster, and along the critical mode; at a
release a reaction vanishes. So a change of the gap along its rate delays a jump by their ratio, and
one of the reaction by its ratio to the rate of that.
"""

from functools import partial

import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.grid import total
from jaxstab.core.implicit import nan_if
from jaxstab.core.types import Field, Scalar
from jaxstab.equilibrium.derivatives import free_system, third_derivative
from jaxstab.equilibrium.equilibrium import fields_of
from jaxstab.evolution.evolution import Memory, mean_displacement_as_gap, moved_contact
from jaxstab.loads import Load

# An event lies no farther ahead than the jump by this factor, to leading order.
_FARTHEST = 10.0


def time_of_jump(
    contact: Contact, load: Load, slope: Scalar, memory: Memory, until: Scalar
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
    zero = jnp.zeros_like(until)
    one = jnp.ones_like(until)
    fixed = jax.lax.stop_gradient((contact, load, slope, memory))
    glassy, held = _instant(*fixed, zero)
    gap = fixed[3].gap
    control = glassy.control(held)
    balance = partial(_balance, *fixed)
    # Under the load of the mean gap, the gap follows it by itself.
    (_, net), (_, net_rate) = jax.jvp(partial(balance, gap), (zero,), (one,))
    move, is_solved = free_system(glassy, control, gap).solution(-net_rate)
    _, (gap_rate, net_rate) = jax.jvp(balance, (gap, zero), (move, one))

    falls = (gap == 0) & (net_rate < 0)
    releases = jnp.where(falls, -net / jnp.where(falls, net_rate, 1), jnp.inf)
    release = jnp.min(releases)
    # At a distance s from a fold the eigenvalue is c s, and s^2 falls linearly in time.
    size = jnp.sqrt(total(move**2))
    mode = move / size
    eigenvalue = total(mode * glassy.hessian(gap, control)(mode))
    fold = eigenvalue / (2 * jnp.abs(total(third_derivative(glassy, gap) * mode**3)) * size)
    is_release = release < fold
    # Which of two points is released first is not resolved within a step.
    is_tied = is_release & (jnp.sum(releases <= release + until) > 1)
    is_event = is_solved & (jnp.minimum(release, fold) <= _FARTHEST * until) & ~is_tied

    _, net = _balance(contact, load, slope, memory, memory.gap, zero)
    places = jnp.arange(gap.size).reshape(gap.shape)
    point = (places == jnp.argmin(releases)).astype(gap.dtype)
    weight = jnp.where(is_release, point, gap_rate)
    rate = total(weight * jnp.where(is_release, net_rate, gap_rate))
    # Without an event any change makes the derivative NaN, also in forward mode.
    weight = jnp.where(is_event, weight / rate, 1 + jnp.cos(places).astype(gap.dtype))
    change = total(weight * jnp.where(is_release, net, memory.gap))
    return nan_if(~is_event, jax.lax.stop_gradient(change) - change)


def _instant(
    contact: Contact, load: Load, slope: Scalar, memory: Memory, dt: Scalar
) -> tuple[Contact, Load]:
    """Return the contact that answers at once, a little later, and its load."""
    return moved_contact(contact, memory, dt), mean_displacement_as_gap(
        contact, load.at(load.value + slope * dt)
    )


def _balance(
    contact: Contact, load: Load, slope: Scalar, memory: Memory, gap: Field, dt: Scalar
) -> tuple[Field, Field]:
    """Return a gap under the load a little later, and its net pressure."""
    fields, net = fields_of(*_instant(contact, load, slope, memory, dt), gap)
    return fields["gap"], net
