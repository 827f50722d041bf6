"""The saddle of a pass: sought near a high state, and the minima on its two sides."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.branches.morse_index import index_of, no_modes
from jaxstab.contact import Contact
from jaxstab.core.compile import program
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


@program
def saddle_near(contact: Contact, load: Load, summit: Field, lowest: Scalar) -> Saddle:
    """Return the saddle to which Newton's method leads from a summit.

    Its energy is above the lowest that it may have, and not far above the summit's.
    """
    control = contact.control(load)
    landscape = Landscape(contact, control)
    problem = Problem.of(contact, control)
    iteration = SaddleNewton(max_steps=60).run(problem, control.admissible(summit))
    gap = iteration.state.gap
    energy = landscape.energy(gap)
    seen = landscape.energy(summit)
    # Newton's method may have gone on to a higher one.
    is_close = (energy > lowest) & (energy - lowest <= _HIGHEST * (seen - lowest))
    index, modes = jax.lax.cond(
        (iteration.result == RESULTS.successful) & is_close,
        lambda: index_of(contact, load, gap, no_modes(gap), precise=True),
        lambda: (jnp.array(-1), no_modes(gap)),
    )
    return Saddle(gap, modes[0], energy, index == 1)


@program
def minima_beside(contact: Contact, load: Load, saddle: Saddle, start: Field) -> Equilibrium:
    """Return the minima on both sides of a saddle, the one nearer to a gap first.

    Where the surfaces detach for good there is none: its fields are NaN.
    """
    solver = PreconditionedConjugateGradient()
    control = contact.control(load)
    push = amplitude_of(saddle.gap, saddle.mode) * saddle.mode

    def side(sign: Array) -> Equilibrium:
        pushed = control.admissible(saddle.gap + sign * push)
        return find(contact, load, solver, jnp.where(saddle.is_found, pushed, jnp.nan))

    both = jax.lax.map(side, jnp.array([-1.0, 1.0], push.dtype))
    distances = jnp.stack([total((gap - start) ** 2) for gap in both.gap])
    order = jnp.where(distances[0] <= distances[1], jnp.array([0, 1]), jnp.array([1, 0]))
    both = jax.tree.map(lambda leaf: leaf[order], both)
    return jax.vmap(detached_where)(both.result == RESULTS.pulled_off, both)


@program
def are_apart(one: Equilibrium, other: Equilibrium) -> Flag:
    """Return whether two states are different ones."""
    difference = jnp.max(jnp.abs(one.gap - other.gap))
    return difference > _APART * jnp.mean(other.gap)
