"""The saddle of a pass: sought near a high state, and the minima on its two sides."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.branches.morse_index import UNKNOWN, index_of, no_modes
from jaxstab.contact import Contact
from jaxstab.contact.hessian import Block
from jaxstab.core.checks import array
from jaxstab.core.compile import program
from jaxstab.core.control_flow import cond, each
from jaxstab.core.grid import total
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient, SaddleNewton
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.equilibrium import detached_where
from jaxstab.equilibrium.solvers.base import Problem
from jaxstab.loads import Load
from jaxstab.stability.perturb import amplitude_of
from jaxstab.transitions.string import Landscape

# A saddle may lie so high, over the barrier that the summit shows.
_HIGHEST = 2
# Two states differ from this largest difference of their gaps on, over the mean gap.
_APART = 1e-3


class Saddle(eqx.Module):
    """A state with one negative eigenvalue on the critical space.

    Attributes:
        gap: its gap [length].
        mode: the unit vector of the negative eigenvalue.
        energy: of the state and the load [energy].
        is_found: whether it is one.
    """

    gap: Field
    mode: Field
    energy: Scalar
    is_found: Flag


@program
def no_saddle(gap: Field) -> Saddle:
    """Return that no saddle is known yet, given a gap from which to look for it."""
    return Saddle(gap, jnp.zeros_like(gap), jnp.zeros((), gap.dtype), jnp.array(False))


def saddle_near(contact: Contact, load: Load, summit: Field, lowest: Scalar) -> Saddle:
    """Return the saddle to which Newton's method leads from a summit.

    Its energy is above the lowest that it may have, and not far above the summit's.
    """
    gap, energy, is_close = _climb(contact, load, summit, lowest)
    index, modes = cond(
        is_close,
        lambda: index_of(contact, load, gap, no_modes(gap), precise=True),
        lambda: (array(UNKNOWN), no_modes(gap)),
    )
    return _saddle_of(gap, energy, index, modes)


@program
def _climb(
    contact: Contact, load: Load, summit: Field, lowest: Scalar
) -> tuple[Field, Scalar, Flag]:
    """Return the gap found by Newton's method, its energy, and whether it is near the summit's."""
    control = contact.control(load)
    landscape = Landscape(contact, control)
    problem = Problem.of(contact, control)
    iteration = SaddleNewton(max_steps=60).run(problem, control.admissible(summit))
    gap = iteration.state.gap
    energy = landscape.energy(gap)
    seen = landscape.energy(summit)
    # Newton's method may have gone on to a higher one.
    is_close = (energy > lowest) & (energy - lowest <= _HIGHEST * (seen - lowest))
    return gap, energy, (iteration.result == RESULTS.successful) & is_close


@program
def _saddle_of(gap: Field, energy: Scalar, index: Int[Array, ""], modes: Block) -> Saddle:
    return Saddle(gap, modes[0], energy, index == 1)


def minima_beside(contact: Contact, load: Load, saddle: Saddle, start: Field) -> Equilibrium:
    """Return the minima on both sides of a saddle, the one nearer to a gap first.

    Where the surfaces detach for good there is none: its fields are NaN.
    """
    find_from = partial(find, contact, load, PreconditionedConjugateGradient())
    return _in_order(each(find_from, _sides(contact, load, saddle)), start)


@program
def _sides(contact: Contact, load: Load, saddle: Saddle) -> tuple[Field, Field]:
    """Return the gaps on both sides of a saddle, NaN where it is none."""
    control = contact.control(load)
    push = amplitude_of(saddle.gap, saddle.mode) * saddle.mode
    both = (control.admissible(saddle.gap + sign * push) for sign in (-1, 1))
    one, other = (jnp.where(saddle.is_found, gap, jnp.nan) for gap in both)
    return one, other


@program
def _in_order(both: Equilibrium, start: Field) -> Equilibrium:
    """Return two states, the one nearer to a gap first, without fields where surfaces detach."""
    distances = jnp.stack([total((gap - start) ** 2) for gap in both.gap])
    order = jnp.where(distances[0] <= distances[1], jnp.array([0, 1]), jnp.array([1, 0]))
    both = jax.tree.map(lambda leaf: leaf[order], both)
    return jax.vmap(detached_where)(both.result == RESULTS.pulled_off, both)


@program
def are_apart(one: Equilibrium, other: Equilibrium) -> Flag:
    """Return whether two states are different ones."""
    difference = jnp.max(jnp.abs(one.gap - other.gap))
    return difference > _APART * jnp.mean(other.gap)
