"""The way of least energy between two states: the string method.

The simplified method of W. E, W. Ren and E. Vanden-Eijnden, J. Chem. Phys. 126, 164103 (2007):
images of the gap go down in energy, each by itself, and are then set at equal distances along the
string again. They stay on g >= 0 and under the load, which are convex, so that all between
two images does too.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact
from jaxstab.core.grid import total
from jaxstab.core.history import Indicators
from jaxstab.core.loop import IterativeSolver, integer_parameter
from jaxstab.core.types import Field, Scalar
from jaxstab.equilibrium.solvers.conjugate_gradients import preconditioner_of
from jaxstab.loads import Control

Images = Float[Array, "images *grid"]

# The longest step, in units of that which the preconditioner takes to be right.
_LONGEST = 2.0


class String(eqx.Module):
    """Images of the gap from one state to another, and the energy of each per point of the grid."""

    images: Images
    energies: Float[Array, " images"]
    moved: Scalar

    @property
    def highest(self) -> Int[Array, ""]:
        """The number of the highest image between the ends."""
        return 1 + jnp.argmax(self.energies[1:-1])

    @property
    def summit(self) -> Field:
        """The gap where a parabola through the highest image and its neighbours is highest."""
        i = self.highest
        low, top, high = (self.energies[i + k] for k in (-1, 0, 1))
        bend = low + high - 2 * top
        share = jnp.clip(jnp.where(bend < 0, (low - high) / (2 * bend), 0), -1, 1)
        back, on = self.images[i - 1], self.images[i + 1]
        other = jnp.where(share > 0, on, back)
        return self.images[i] + jnp.abs(share) * (other - self.images[i])


@dataclass(frozen=True)
class Landscape:
    """The energy over the gaps that a load allows.

    Attributes:
        contact: the contact, in units of its own.
        control: the condition of the load on the gap.
    """

    contact: Contact
    control: Control

    def energy(self, gap: Field) -> Scalar:
        """Return the energy of a gap and of the load [energy]."""
        mean_gap = total(gap) / gap.size
        return self.contact.energy(gap) + self.contact.grid.area * self.control.energy(mean_gap)

    def straight(self, start: Field, end: Field, number: int) -> String:
        """Return images on the straight line between two gaps."""
        shares = jnp.linspace(0, 1, number, dtype=start.dtype)
        images = jax.vmap(lambda share: start + share * (end - start))(shares)
        return self.string(images)

    def string(self, images: Images, moved: Scalar | float = 1.0) -> String:
        """Return a string of images, with their energies."""
        return String(images, jax.vmap(self.energy)(images), jnp.asarray(moved, images.dtype))


class StringMethod(IterativeSolver):
    """The string method, until a step moves the images by a part of the length of the string."""

    tolerance: Scalar | None = None
    max_steps: Int[Array, ""] = eqx.field(converter=integer_parameter, default=40)

    default_tolerance: ClassVar[Mapping[str, float]] = {"float64": 1e-3, "float32": 1e-3}
    patience: ClassVar[int] = 40

    def step(self, problem: Landscape, state: String) -> String:
        """Return the string after all images between its ends have gone down a step."""
        inner = jax.vmap(partial(_descended, problem))(state.images[1:-1])
        images = state.images.at[1:-1].set(inner)
        images = _evenly(images)
        length = jnp.sqrt(total((state.images[-1] - state.images[0]) ** 2))
        moved = jnp.sqrt(jnp.max(jax.vmap(lambda x: total(x**2))(images - state.images)))
        return problem.string(images, moved / length)

    def measure(self, problem: Landscape, state: String) -> Indicators:
        """Return how far the last step has moved an image, over the length of the string."""
        return {"residual": jnp.where(jnp.isfinite(state.energies).all(), state.moved, jnp.nan)}


def _descended(problem: Landscape, gap: Field) -> Field:
    """Return a gap after a step of steepest descent, preconditioned, of the best length."""
    contact, control = problem.contact, problem.control
    net = control.net_pressure(contact.gradient(gap), gap)
    is_moving = control.moving(gap, net)
    force = control.project(net, is_moving)
    curvature = contact.curvature(gap)
    solid = contact.solid.with_uniform_stiffness(
        0 if control.stiffness is None else control.stiffness
    )
    inverse = partial(preconditioner_of(contact, solid, gap), curvature)
    move = control.project(control.precondition(inverse, force, is_moving), is_moving)
    bend = total(move * (solid.apply(move) + curvature * move))
    best = total(force * move) / jnp.where(bend > 0, bend, 1)
    length = jnp.where(bend > 0, jnp.minimum(best, _LONGEST), 1)
    return control.admissible(gap - length * move)


def _evenly(images: Images) -> Images:
    """Return images at equal distances along the string through others."""
    steps = jax.vmap(lambda x: jnp.sqrt(total(x**2)))(images[1:] - images[:-1])
    along = jnp.concatenate([jnp.zeros((1,), steps.dtype), jnp.cumsum(steps)])
    wanted = jnp.linspace(0, 1, len(images), dtype=steps.dtype) * along[-1]
    below = jnp.clip(jnp.searchsorted(along, wanted, side="right") - 1, 0, len(steps) - 1)
    width = steps[below]
    share = jnp.clip((wanted - along[below]) / jnp.where(width > 0, width, 1), 0, 1)
    shape = (-1,) + (1,) * (images.ndim - 1)
    share = share.reshape(shape)
    even = (1 - share) * images[below] + share * images[below + 1]
    return even.at[0].set(images[0]).at[-1].set(images[-1])
