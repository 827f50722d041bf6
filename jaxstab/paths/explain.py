"""Why a branch ended at a state: the eigenvalue that vanished, or the contact point that let go."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxstab.contact import Contact
from jaxstab.grid import mean
from jaxstab.loads import Load
from jaxstab.paths.path import KINDS
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpairs import Eigenpair
from jaxstab.stability.lobpcg import LOBPCG
from jaxstab.stability.modes import BLOCK_SIZE, lowest_pair, noise

Field = Float[Array, " *grid"]

# In units of the conforming pressure: a reaction that vanishes within the resolution of a path.
_HARDLY_ANY = 1e-4


def reason_of(contact: Contact, load: Load, gap: Field, key: Array) -> tuple[KINDS, Field]:
    """Return why the branch of a state ends just beyond it, and the mode that leads away.

    It is a release if a point of contact has hardly any reaction and the energy falls where it
    moves too; otherwise a fold.
    """
    control = contact.control(load)
    net = contact.balance(control)(gap).net
    touches = gap == 0
    lets_go = touches & (net <= _HARDLY_ANY * contact.conforming_pressure)
    hessian = contact.hessian(gap, control)
    starts = noise(key, BLOCK_SIZE, gap)

    def lowest(is_moving: Bool[Array, " *grid"]) -> Eigenpair:
        space = Subspace(is_moving, control.fixes_mean)
        return lowest_pair(LOBPCG(), hessian, space, starts)[0]

    closed, opened = lowest(~touches), lowest(~touches | lets_go)
    is_release = jnp.any(lets_go) & (opened.eigenvalue < 0)
    kind = KINDS.where(is_release, KINDS.release, KINDS.fold)
    mode = jnp.where(is_release, opened.mode, closed.mode)
    # A contact point opens.
    opening = jnp.where(touches, mode, 0)
    return kind, mode * jnp.where(mean(opening) < 0, -1, 1)
