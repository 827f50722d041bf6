"""The Morse index of an equilibrium: the number of negative eigenvalues on its free points."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact
from jaxstab.contact.hessian import Block
from jaxstab.core.accuracy import ALONG_CURVES, EQUILIBRIUM, NEGLIGIBLE
from jaxstab.core.checks import array, as_array
from jaxstab.core.compile import program
from jaxstab.core.control_flow import cond
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Mask
from jaxstab.loads import Load
from jaxstab.stability.cones import Subspace
from jaxstab.stability.eigenpair import Eigenpair, eigenpair_of
from jaxstab.stability.ritz import norms
from jaxstab.stability.solvers.base import BLOCK_SIZE, ModesProblem, noise
from jaxstab.stability.solvers.davidson import Davidson

# A residual below which a positive Ritz value is one of an eigenvalue that is positive: over that
# value, or where this is larger, over the scale of A.
_CERTAIN = 0.1
# The modes that are looked at if the first are not enough; the last to converge does not count.
_MANY = 20
# The modes of which it is known whether they have a part in a change, and one more.
_SOME = 12
MOST = _MANY - 1
UNKNOWN = -1


class CurveDavidson(Davidson):
    """Davidson's method until the lowest modes, or only the signs of their eigenvalues, are known.

    There are at least as many negative eigenvalues as there are negative Ritz values. So for the
    signs those decide that are positive; one of them belongs to a new vector, since modes from
    nearby may lack it.

    Arguments:
        number: how many of the lowest modes are to converge.
        signs_only: whether the signs of all eigenvalues are sought instead.
    """

    number: Int[Array, ""] = eqx.field(converter=as_array, default=1)
    signs_only: Flag = eqx.field(converter=array, default=False)

    def doubts(self, problem: ModesProblem, state: Any) -> Float[Array, " count"]:
        """Return the residuals that decide, for signs less where a Ritz value is large."""
        residuals = state.residuals
        values = state.eigenvalues[: problem.count] / problem.operator.scale
        tolerance = self.tolerance_in(values.dtype)
        certain = jnp.maximum(_CERTAIN * values / tolerance, 1)
        signs = jnp.where(values >= 0, residuals / certain, 0)
        lowest = jnp.where(jnp.arange(problem.count) < self.number, residuals, 0)
        return jnp.where(self.signs_only, signs, lowest)


class LowestModes(eqx.Module):
    """The lowest modes of an equilibrium.

    Attributes:
        pair: the lowest eigenpair.
        modes: the modes, of which the last converges late, and does not count.
        index: the number of negative eigenvalues among the others, or `UNKNOWN`.
        is_all: whether there are no more.
    """

    pair: Eigenpair
    modes: Block
    index: Int[Array, ""]
    is_all: Flag


@program
def no_modes(gap: Field) -> Block:
    """Return that no modes are known: searches begin with random ones."""
    return jnp.zeros((BLOCK_SIZE, *gap.shape), gap.dtype)


def index_of(
    contact: Contact,
    load: Load,
    gap: Field,
    modes: Block,
    *,
    opened: Field | None = None,
    precise: bool = False,
    counts_all: bool = True,
) -> tuple[Int[Array, ""], Block]:
    """Return the number of negative eigenvalues of A on the critical space, and its lowest modes.

    The space is that of the free points, or of those where an opened gap is positive. Modes are
    eigenvectors where they are to be precise. Otherwise they do for the count.

    The search starts from the modes of a state nearby; from more of them if all that count
    are negative, or not known. More than `MOST` count as so many; `UNKNOWN` says that the search
    failed. Where not all are to be counted, three may stand for more.
    """

    free = gap if opened is None else opened

    def count(modes: Block) -> LowestModes:
        # The last of the modes converges slowly, and only its sign is of use.
        tolerance = ALONG_CURVES[gap.dtype.name]
        solver = CurveDavidson(tolerance, number=len(modes) - 1, signs_only=not precise)
        return _lowest_modes(contact, load, gap, free, modes, solver.in_precision(gap.dtype))

    few = count(modes)
    if not counts_all:
        return few.index, few.modes
    return cond(few.is_all, lambda: few.index, lambda: count(_many(gap)).index), few.modes


def lowest_pair(
    contact: Contact, load: Load, gap: Field, opened: Field, modes: Block, tolerance: float
) -> Eigenpair:
    """Return the lowest eigenpair on the points of positive opened gap, from modes nearby."""
    solver = CurveDavidson(tolerance).in_precision(gap.dtype)
    return _lowest_modes(contact, load, gap, opened, modes, solver).pair


@program
def _lowest_modes(
    contact: Contact, load: Load, gap: Field, opened: Field, modes: Block, solver: CurveDavidson
) -> LowestModes:
    pair, eigenvalues, modes = _lowest(contact, load, gap, opened > 0, modes, solver)
    is_known = pair.result == RESULTS.successful
    index = jnp.sum(eigenvalues < 0)
    # Of one type, as everywhere: programs would be compiled twice.
    known = jnp.where(is_known, index, UNKNOWN).astype(int)
    return LowestModes(pair, modes, known, is_known & (index < len(eigenvalues)))


@program
def _many(gap: Field) -> Block:
    return jnp.zeros((_MANY, *gap.shape), gap.dtype)


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
    solver = CurveDavidson(EQUILIBRIUM[gap.dtype.name], number=_SOME - 1)
    none = jnp.zeros((_SOME, *gap.shape), gap.dtype)
    pair, values, modes = _lowest(contact, load, gap, is_free, none, solver)
    is_negative = values < 0
    part = jnp.stack([jnp.abs(jnp.sum(mode * change)) for mode in modes[:-1]])
    has_part = part > NEGLIGIBLE[gap.dtype.name] * jnp.sqrt(jnp.sum(change**2))
    is_all = (pair.result == RESULTS.successful) & ~jnp.all(is_negative)
    index = jnp.where(is_all, jnp.sum(is_negative & has_part), UNKNOWN)
    return DrivenIndex(index, values, modes[:-1])


def _lowest(
    contact: Contact,
    load: Load,
    gap: Field,
    is_moving: Mask,
    modes: Block,
    solver: CurveDavidson,
) -> tuple[Eigenpair, Float[Array, " modes-1"], Block]:
    """Return the lowest eigenpair, the lowest eigenvalues, and modes, from modes of a state nearby.

    Eigenvalues beyond the dimension of the space are infinite. The search begins with a new vector
    in place of the last mode, and of those that a smaller space did not have.
    """
    control = contact.control(load)
    space = Subspace(is_moving, control.fixes_mean)
    hessian = contact.hessian(gap, control).restriction(space.is_moving)
    is_new = (norms(modes) == 0) | (jnp.arange(len(modes)) == len(modes) - 1)
    fresh = noise(jax.random.key(2), len(modes), gap)
    starts = jnp.where(is_new.reshape(-1, *[1] * gap.ndim), fresh, modes)
    minimum = solver.solve(hessian, space, starts, len(modes))
    pair = eigenpair_of(hessian, space, minimum, minimum.vector[0]).with_proof(True)
    # Ritz values of vectors of unit norm or none, beside that of the pair. The last vector has come
    # anew into the search, and is none of the lowest yet.
    others = minimum.vector[1:-1]
    values = jax.lax.map(lambda mode: jnp.sum(mode * hessian(mode)), others)
    values = jnp.where(norms(others) > 0, values, jnp.inf)
    return pair, jnp.append(pair.eigenvalue, values), minimum.vector
