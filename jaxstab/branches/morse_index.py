"""The Morse index of an equilibrium: the number of negative eigenvalues on its free points."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact
from jaxstab.contact.hessian import Block
from jaxstab.core.compile import program
from jaxstab.core.control_flow import cond
from jaxstab.core.results import RESULTS
from jaxstab.core.types import ArrayLike, Field, Flag, Mask
from jaxstab.loads import Load
from jaxstab.stability.cones import Subspace
from jaxstab.stability.ritz import norms
from jaxstab.stability.solvers.base import ModesProblem, noise
from jaxstab.stability.solvers.davidson import Davidson

# Of eigenvalues, where the modes are used.
_TOLERANCE = {"float64": 1e-5, "float32": 1e-4}
# A residual below which a positive Ritz value is one of an eigenvalue that is positive: over that
# value, or where this is larger, over the scale of A.
_CERTAIN = 0.1
# The modes that are looked at first, and at most; one of them converges last, and does not count.
_FEW = 4
_MANY = 20
# The modes of which it is known whether they have a part in a change, and one more.
_SOME = 12
# Of modes that a change of the gap is compared with, and the least part of it that is one.
_EXACT = {"float64": 1e-9, "float32": 1e-4}
_LEAST_PART = {"float64": 1e-6, "float32": 1e-3}
MOST = _MANY - 1
UNKNOWN = -1


class _Signs(Davidson):
    """Davidson's method until the signs of the lowest eigenvalues are known.

    There are at least as many negative eigenvalues as there are negative Ritz values. So those that
    are positive decide; one of them belongs to a new vector, since modes from nearby may lack it.
    """

    def doubts(self, problem: ModesProblem, state: Any) -> Float[Array, " count"]:
        """Return the residuals of positive Ritz values, over those which are certain."""
        values = state.eigenvalues[: problem.count] / problem.operator.scale
        certain = jnp.maximum(_CERTAIN * values, _TOLERANCE[values.dtype.name])
        return jnp.where(values >= 0, state.residuals / certain, 0)


def some_modes(gap: Field) -> Block:
    """Return modes to begin with."""
    return noise(jax.random.key(0), _FEW, gap)


def refreshed(modes: Block, is_new: ArrayLike = False) -> Block:
    """Return modes with new vectors for those that a smaller space did not have, and others."""
    is_new = is_new | (norms(modes) == 0)
    fresh = noise(jax.random.key(2), len(modes), modes[0])
    return jnp.where(is_new.reshape(-1, *[1] * (modes.ndim - 1)), fresh, modes)


def index_of(
    contact: Contact,
    load: Load,
    gap: Field,
    modes: Block,
    *,
    precise: bool = False,
    counts_all: bool = True,
) -> tuple[Int[Array, ""], Block]:
    """Return the number of negative eigenvalues of A on the critical space, and its lowest modes.

    Modes are eigenvectors where they are to be precise. Otherwise they do for the count.

    The search starts from the modes of a state nearby; from more of them if all that count
    are negative, or not known. More than `MOST` count as so many; `UNKNOWN` says that the search
    failed. Where not all are to be counted, three may stand for more.
    """
    # The last of the modes converges slowly, and only its sign is of use.
    solver, spare = (Davidson(_TOLERANCE[gap.dtype.name]), 1) if precise else (_Signs(1.0), 0)
    few = _count(spare, contact, load, gap, modes, solver)
    if not counts_all:
        return few.index, few.modes

    def look_on() -> Int[Array, ""]:
        return _count(spare, contact, load, gap, _many(gap), solver).index

    return cond(few.is_all, lambda: few.index, look_on), few.modes


class _Count(eqx.Module):
    """The number of negative eigenvalues among the lowest, or `UNKNOWN`; modes; whether it is all
    that there are.
    """

    index: Int[Array, ""]
    modes: Block
    is_all: Flag


@partial(program, static_argnums=0)
def _count(
    spare: int, contact: Contact, load: Load, gap: Field, modes: Block, solver: Davidson
) -> _Count:
    values, is_known, modes = _lowest(contact, load, gap, gap > 0, modes, solver, spare)
    index = jnp.sum(values < 0)
    # Of one type, as everywhere: programs would be compiled twice.
    known = jnp.where(is_known, index, UNKNOWN).astype(int)
    return _Count(known, modes, is_known & (index < _FEW - 1))


@program
def _many(gap: Field) -> Block:
    return noise(jax.random.key(1), _MANY, gap)


class DrivenIndex(eqx.Module):
    """How many modes of negative eigenvalues have a part in a change of the gap, and all lowest.

    Attributes:
        index: their number, or `UNKNOWN`.
        eigenvalues: the lowest eigenvalues, in order [pressure/length].
        modes: their modes.
    """

    index: Int[Array, ""]
    eigenvalues: Float[Array, " modes"]
    modes: Block


def driven_index_of(
    contact: Contact, load: Load, gap: Field, is_free: Mask, change: Field
) -> DrivenIndex:
    """Return how many modes of negative eigenvalues have a part in a change of the gap.

    Modes that break a symmetry of the contact have none. Ten are counted; more are `UNKNOWN`.
    """
    solver = Davidson(_EXACT[gap.dtype.name])
    some = noise(jax.random.key(3), _SOME, gap)
    values, is_known, modes = _lowest(contact, load, gap, is_free, some, solver, 1)
    is_negative = values < 0
    part = jnp.stack([jnp.abs(jnp.sum(mode * change)) for mode in modes[:-1]])
    has_part = part > _LEAST_PART[gap.dtype.name] * jnp.sqrt(jnp.sum(change**2))
    is_all = is_known & ~jnp.all(is_negative)
    index = jnp.where(is_all, jnp.sum(is_negative & has_part), UNKNOWN)
    return DrivenIndex(index, values, modes[:-1])


def _lowest(
    contact: Contact,
    load: Load,
    gap: Field,
    is_free: Mask,
    modes: Block,
    solver: Davidson,
    spare: int,
) -> tuple[Float[Array, " modes"], Flag, Block]:
    """Return the lowest eigenvalues, whether their signs are known, and modes.

    Those beyond the dimension of the space are infinite.
    """
    control = contact.control(load)
    space = Subspace(is_free, control.fixes_mean)
    modes = refreshed(modes, jnp.arange(len(modes)) == len(modes) - 1)
    hessian = contact.hessian(gap, control).restricted(space.is_moving)
    minimum = solver.solve(hessian, space, modes, len(modes) - spare)
    found = minimum.vector
    # The Ritz values, of vectors of unit norm or none.
    values = jax.lax.map(lambda mode: jnp.sum(mode * hessian(mode)), found[:-1])
    values = jnp.where(norms(found[:-1]) > 0, values, jnp.inf)
    return values, minimum.result == RESULTS.successful, found
