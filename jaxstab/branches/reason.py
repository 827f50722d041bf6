"""Why a branch ends at a state: an eigenvalue that vanishes, or a contact point that lets go."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxstab.branches.release import first_releases
from jaxstab.contact import Contact
from jaxstab.grid import mean
from jaxstab.loads import Load
from jaxstab.results import KINDS
from jaxstab.stability.cones import Subspace
from jaxstab.stability.davidson import Davidson
from jaxstab.stability.modes import BLOCK_SIZE, lowest_pair, noise

Field = Float[Array, " *grid"]

# How far beyond the end of a branch, in units of how near it is known, a point may let go at it.
_LEEWAY = 2


def reason_of(
    contact: Contact, load: Load, gap: Field, ahead: Float[Array, ""]
) -> tuple[KINDS, Field]:
    """Return why the branch of a state ends just beyond it, and the mode that leads away.

    It is a release if points of contact lose their reaction there and the energy falls where they
    move too; otherwise a fold.

    Arguments:
        contact: the contact problem.
        load: that of the state.
        gap: of the state.
        ahead: how far ahead the load lies that has no state of this branch, with its sign.
    """
    control = contact.control(load)
    touches = gap == 0
    lets_go = touches & (first_releases(contact, load, gap, ahead) <= _LEEWAY)
    hessian = contact.hessian(gap, control)
    starts = noise(jax.random.key(0), BLOCK_SIZE, gap)

    def lowest(is_moving: Bool[Array, " *grid"]) -> tuple[Float[Array, ""], Field]:
        space = Subspace(is_moving, control.fixes_mean)
        pair, _ = lowest_pair(Davidson(), hessian, space, starts)
        return pair.eigenvalue, pair.mode

    nothing = jnp.array(jnp.inf, gap.dtype), jnp.zeros_like(gap)
    opened, mode = jax.lax.cond(
        jnp.any(lets_go), lambda: lowest(~touches | lets_go), lambda: nothing
    )
    is_release = opened < 0
    kind = KINDS.where(is_release, KINDS.release, KINDS.fold)
    mode = jax.lax.cond(is_release, lambda: mode, lambda: lowest(~touches)[1])
    # A contact point opens.
    opening = jnp.where(touches, mode, 0)
    return kind, mode * jnp.where(mean(opening) < 0, -1, 1)
