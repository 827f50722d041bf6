"""Why a branch ends at a state: an eigenvalue that vanishes, or a contact point that lets go."""

import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.grid import mean
from jaxstab.core.types import Field, Flag
from jaxstab.loads import Load
from jaxstab.paths.kinds import KINDS
from jaxstab.stability.cones import Subspace
from jaxstab.stability.lowest_modes import BLOCK_SIZE, noise
from jaxstab.stability.lowest_pair import on_space
from jaxstab.stability.solvers.davidson import Davidson

# How far beyond the end of a branch, in units of how near it is known, a point may let go at it.
_LEEWAY = 2


def reason_of(contact: Contact, load: Load, gap: Field, releases: Field) -> tuple[KINDS, Field]:
    """Return why the branch of a state ends just beyond it, and the mode that leads away.

    It is a release if points of contact lose their reaction there, as `first_releases` says, and
    the energy falls where they move too; otherwise a fold.
    """
    control = contact.control(load)
    touches = gap == 0
    lets_go = touches & (releases <= _LEEWAY)
    hessian = contact.hessian(gap, control)
    starts = noise(jax.random.key(0), BLOCK_SIZE, gap)

    def seek(found: tuple[Flag, Flag, Field]) -> tuple[Flag, Flag, Field]:
        opens, *_ = found
        space = Subspace(~touches | (lets_go & opens), control.fixes_mean)
        pair = on_space(Davidson(), hessian, space, starts).pair
        is_release = opens & (pair.eigenvalue < 0)
        return is_release, is_release | ~opens, pair.mode

    # With the points that may let go, if there are any, and where that is no release without them.
    start = jnp.any(lets_go), jnp.array(False), jnp.zeros_like(gap)
    is_release, _, mode = jax.lax.while_loop(lambda found: ~found[1], seek, start)
    kind = KINDS.where(is_release, KINDS.release, KINDS.fold)
    # A contact point opens.
    opening = jnp.where(touches, mode, 0)
    return kind, mode * jnp.where(mean(opening) < 0, -1, 1)
