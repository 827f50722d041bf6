"""A load path: the data that stay the same in all its steps."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.contact.energy import characteristic_energy
from jaxstab.core.accuracy import rounding_of_numbers
from jaxstab.core.compile import program
from jaxstab.core.control_flow import by_entries
from jaxstab.core.types import ArrayLike, Field, Scalar
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find
from jaxstab.equilibrium.solvers.conjugate_gradients import MAX_MOVE_IN_JUMP
from jaxstab.loading.event import load_on_indented
from jaxstab.loads import Load
from jaxstab.states.point import PathPoint

# The default is relative to the size of the problem's own heights and gaps.
DISTURBANCE = 1e-6
# How far a step of a solver may move a point, over its gap and the range of the law: farther ones
# were seen to leap over minima.
_MAX_MOVE = 0.1
# A leg of the load path takes so many steps at least.
_NUM_STEPS = 32


class Start(eqx.Module):
    """A load, the gap from which its equilibrium is sought [length], and the solver.

    On a surface that yields the load is one for the surface left before, which has other heights.
    """

    load: Load
    gap: Field
    solver: PreconditionedConjugateGradient
    heights: Field | None = None

    def equilibrium(self, contact: Contact) -> Equilibrium:
        """Return the equilibrium of a contact at this load."""
        if self.heights is not None:
            contact = eqx.tree_at(lambda contact: contact.heights, contact, self.heights)
        return find(contact, self.load, self.solver, self.gap)


class LoadPath(eqx.Module):
    """The data that stay the same in all steps along a load path.

    Attributes:
        contact: the contact problem, in its characteristic units.
        load: the turning points of the load path.
        threshold: the loss from which a jump is located [energy].
        share: the same, over the earlier losses.
        resolution: how near it is located [unit of the load].
        disturbance: a field that is added to where each equilibrium starts [length].
        finds_all: whether a jump is detected by the force too. Otherwise it is detected by its loss
            alone; that is enough for the end of one branch.
    """

    contact: Contact
    load: Load
    threshold: Scalar
    share: Scalar
    resolution: Scalar
    disturbance: Field
    finds_all: bool = eqx.field(static=True)

    def smallest_loss(self, here: PathPoint) -> Scalar:
        """Return the loss from which a jump from a state is located, above rounding."""
        # The loss of surfaces that fell apart is NaN.
        threshold = jnp.fmax(self.threshold, self.share * here.dissipation)
        return jnp.fmax(threshold, here.rounding(self.contact.area))

    @property
    def max_step(self) -> Scalar:
        """The longest step."""
        turns = self.load.value
        return jnp.maximum((jnp.max(turns) - jnp.min(turns)) / _NUM_STEPS, self.resolution)

    @property
    def first_step(self) -> Scalar:
        """The first step along a branch."""
        return self.max_step / 8

    def at(self, value: Scalar) -> Load:
        """Return the load at a value; all else of it is the same everywhere."""
        return self.load[0].at(value)

    def start_at(
        self,
        value: Scalar,
        gap: Field,
        least_potential: ArrayLike = -jnp.inf,
        is_final: ArrayLike = False,
        here: PathPoint | None = None,
    ) -> "Start":
        """Return where the equilibrium at a load is sought from a gap, once disturbed.

        Once the potential falls below the least, the search ends without a result; one that is
        final may lead down to another branch. The surface is the one that the state here leaves.
        """
        contact = self.contact
        load = self.at(value)
        heights = None
        if here is not None and here.indentation is not None:
            assert here.plastic_work is not None
            # The potential of the search begins anew with each surface that is left.
            before = self._supply(contact, load, here.signed_gap) + here.plastic_work
            contact = contact.after(here)
            heights = contact.heights
            load = load_on_indented(load, here)
            least_potential += self._supply(contact, load, here.gap) - before
        dtype = gap.dtype
        # Contact points stay where they are.
        disturbed = jnp.where(gap > 0, jnp.maximum(gap + self.disturbance, 0), contact.shut(gap))
        # Where the mean gap is held, no long step draws the surfaces apart.
        longest = jnp.full((), _MAX_MOVE)
        if contact.control(load).fixes_mean:
            longest = jnp.where(is_final, MAX_MOVE_IN_JUMP, jnp.inf)
        least = jnp.asarray(least_potential, dtype) / contact.grid.cell_area
        solver = PreconditionedConjugateGradient(
            max_move=longest.astype(dtype), least_energy=least.astype(dtype)
        )
        return Start(load, disturbed, solver.in_precision(dtype), heights)

    def _supply(self, contact: Contact, load: Load, gap: Field) -> Scalar:
        """Return the energy of a load at a gap [energy]."""
        control = contact.control(load)
        return contact.grid.area * control.energy(control.mean_gap_of(gap))

    def apart(self, here: PathPoint) -> Field:
        """Return the gap of surfaces that are about to touch."""
        heights = self.contact.after(here).heights
        return jnp.max(heights) - heights


@partial(program, static_argnames="finds_all")
def load_path_of(
    contact: Contact,
    load: Load,
    smallest_jump: ArrayLike,
    disturbance: ArrayLike,
    *,
    share: ArrayLike = 0.0,
    resolution: ArrayLike = 1e-6,
    finds_all: bool = False,
) -> LoadPath:
    """Return the load path of a contact, in its characteristic units, through turning points.

    Here the smallest jump is relative to the problem's characteristic energy, the resolution to the
    range of the loads, and the disturbance to `_characteristic_length`.
    """

    @by_entries
    def scales(contact: Contact, load: Load) -> tuple[Scalar, Scalar, Scalar, Field]:
        turns = load.value
        heights = contact.heights
        noise = jax.random.normal(jax.random.key(0), heights.shape, heights.dtype)
        # Loads that are nearer to each other are the same.
        finest = rounding_of_numbers(turns.dtype) * jnp.max(jnp.abs(turns))
        span = jnp.max(turns) - jnp.min(turns)
        return characteristic_energy(contact), span, finest, _characteristic_length(contact) * noise

    energy, span, finest, field = scales(contact, load)
    return LoadPath(
        contact,
        load,
        threshold=jnp.asarray(smallest_jump) * energy,
        share=jnp.asarray(share),
        resolution=jnp.maximum(resolution * span, finest),
        disturbance=jnp.asarray(disturbance) * field,
        finds_all=finds_all,
    )


def _characteristic_length(contact: Contact) -> Scalar:
    """Return the rms height, or of a flatter surface the resolution of law and grid."""
    return jnp.maximum(
        jnp.std(contact.solid.surface(contact.heights)),
        jnp.minimum(contact.profile.range, jnp.min(contact.grid.spacing)),
    )
