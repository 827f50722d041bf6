"""The minimum-energy path between two states: the string method.

The simplified method of W. E, W. Ren and E. Vanden-Eijnden, J. Chem. Phys. 126, 164103 (2007):
images of the gap go down in energy, each by itself, and are then set at equal distances along the
string again. They stay on g >= 0 and under the load, which are convex, so that all between
two images does too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact
from jaxstab.core.checks import as_array, parameter
from jaxstab.core.grid import total
from jaxstab.core.history import Indicators
from jaxstab.core.loop import IterativeSolver
from jaxstab.core.types import Field, Scalar
from jaxstab.equilibrium.solvers.conjugate_gradients import preconditioner_of
from jaxstab.loads import Control

Images = Float[Array, "images *grid"]

# The longest step, in units of that which the preconditioner takes to be right.
_LONGEST = 2.0


class String(eqx.Module):
    """Images of the gap from one state to another.

    Attributes:
        images: the gaps, with both ends [length].
        energies: of each image and of the load there [energy].
        relative_move: how far the last step has moved an image, over the distance between the ends.
    """

    images: Images
    energies: Float[Array, " images"]
    relative_move: Scalar

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
        back = self.images[i - 1]
        on = self.images[i + 1]
        other = jnp.where(share > 0, on, back)
        return self.images[i] + jnp.abs(share) * (other - self.images[i])


@dataclass(frozen=True)
class Landscape:
    """The energy over the gaps that a load allows.

    Attributes:
        contact: the contact, in its characteristic units.
        control: the condition of the load on the gap.
    """

    contact: Contact
    control: Control

    def energy(self, gap: Field) -> Scalar:
        """Return the energy of a gap and of the load [energy]."""
        mean_gap = self.control.mean_gap_of(gap)
        return self.contact.energy(gap) + self.contact.grid.area * self.control.energy(mean_gap)

    def string(self, images: Images, relative_move: Scalar | float = 1.0) -> String:
        """Return a string of images, with their energies."""
        return String(
            images, jax.vmap(self.energy)(images), jnp.asarray(relative_move, images.dtype)
        )


class StringMethod(IterativeSolver):
    """The string method, until a step moves no image far, over the distance between the ends.

    Arguments:
        num_images: the number of images, with both ends.
    """

    num_images: int = eqx.field(static=True)
    tolerance: Scalar = eqx.field(converter=parameter, default=1e-3)
    max_steps: Int[Array, ""] = eqx.field(converter=as_array, default=40)

    patience: ClassVar[int] = 40

    def init(self, problem: Landscape, start: Sequence[Field]) -> String:
        """Return images on the straight lines from gap to gap."""
        gaps = jnp.stack(start)
        places = jnp.linspace(0, len(gaps) - 1, self.num_images, dtype=gaps.dtype)
        return problem.string(_between(places, jnp.arange(len(gaps), dtype=gaps.dtype), gaps))

    def step(self, problem: Landscape, state: String) -> String:
        """Return the string after all images between its ends have gone down a step."""
        inner = jax.vmap(partial(_descend, problem))(state.images[1:-1])
        images = _evenly(state.images.at[1:-1].set(inner))
        between_ends = jnp.sqrt(total((state.images[-1] - state.images[0]) ** 2))
        move = jnp.sqrt(jnp.max(jax.vmap(lambda x: total(x**2))(images - state.images)))
        return problem.string(images, move / between_ends)

    def measure(self, problem: Landscape, state: String) -> Indicators:
        """Return how far the last step has moved an image, over the distance of the ends."""
        return {
            "residual": jnp.where(jnp.isfinite(state.energies).all(), state.relative_move, jnp.nan)
        }


def _descend(problem: Landscape, gap: Field) -> Field:
    """Return a gap after a step of steepest descent, preconditioned, of the best length."""
    contact = problem.contact
    control = problem.control
    net = control.net_pressure(contact.gradient(gap), gap)
    is_moving = control.moving(gap, net)
    force = control.project(net, is_moving)
    hessian = contact.hessian(gap, control)
    inverse = partial(preconditioner_of(contact, hessian.solid, gap), hessian.curvature)
    move = control.project(control.precondition(inverse, force, is_moving), is_moving)
    bend = total(move * hessian(move))
    best = total(force * move) / jnp.where(bend > 0, bend, 1)
    length = jnp.where(bend > 0, jnp.minimum(best, _LONGEST), 1)
    return control.admissible(gap - length * move)


def _evenly(images: Images) -> Images:
    """Return images at equal distances along the string through others."""
    steps = jax.vmap(lambda x: jnp.sqrt(total(x**2)))(images[1:] - images[:-1])
    along = jnp.concatenate([jnp.zeros((1,), steps.dtype), jnp.cumsum(steps)])
    wanted = jnp.linspace(0, 1, len(images), dtype=steps.dtype) * along[-1]
    return _between(wanted, along, images).at[-1].set(images[-1])


def _between(wanted: Array, along: Array, images: Images) -> Images:
    """Return images at places along a string through others, by linear interpolation."""
    columns = images.reshape(len(images), -1)
    found = jax.vmap(partial(jnp.interp, wanted, along), 1, 1)(columns)
    return found.reshape(-1, *images.shape[1:])
