"""The history of a viscoelastic contact, and one state of it."""

from dataclasses import replace
from typing import Annotated, Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.contact import Contact, require_contact
from jaxstab.core import display
from jaxstab.core.checks import require_kind
from jaxstab.core.compile import program
from jaxstab.core.display import column
from jaxstab.core.renamed import Renamed
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import entry_at
from jaxstab.core.types import Field, Scalar
from jaxstab.core.units import ENERGY, FORCE, LENGTH, NUMBER, PRESSURE, TIME, Dimensioned
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrium import state_at
from jaxstab.loads import Load, MeanDisplacement, MeanGap
from jaxstab.solids.viscoelastic import Viscoelastic
from jaxstab.states.columns import load_column, measured_columns, state_columns
from jaxstab.states.sequence import States

Tree = TypeVar("Tree")
# The fields of an evolution that its single states share.
OF_RUN: tuple[str, ...] = (
    "contact",
    "last",
    "reached",
    "jump_times",
    "jump_losses",
    "largest_tension",
    "largest_tension_time",
    "largest_compression",
    "largest_compression_time",
)


class Memory(eqx.Module):
    """The memory of a viscoelastic contact, on the grid that it is solved on.

    Attributes:
        gap: g [length].
        strains: v_k of each spring, first w, the displacement relative to the far side [length].

    Example:
        >>> rubber = js.Contact(js.Viscoelastic(solid, (1.0,), (0.1,)), heights, law)
        >>> evolution = js.evolve(rubber, js.MeanGap([0.3, 0.05]), [0.0, 1.0])
        >>> evolution.memory.strains.shape
        (2, 16, 16)
    """

    gap: Annotated[Field, LENGTH]
    strains: Annotated[Float[Array, " springs_and_grid"], LENGTH]


class Totals(Dimensioned):
    """The scalars of a viscoelastic contact at a time, or at several.

    Attributes:
        mean_gap: mean(g) [length].
        mean_pressure: p0, positive in compression [pressure].
        contact_area: the number of contact points over the number of all points.
        stored: elastic energy of all branches, adhesive energy and the energy of a spring, less
            their sum at the start [energy].
        work: done by the load since the start [energy].
        viscous_dissipation: in the solid, since the start [energy].
        jump_dissipation: in jumps, since the start [energy].
    """

    mean_gap: Annotated[Float[Array, "..."], LENGTH]
    mean_pressure: Annotated[Float[Array, "..."], PRESSURE]
    contact_area: Annotated[Float[Array, "..."], NUMBER]
    stored: Annotated[Float[Array, "..."], ENERGY]
    work: Annotated[Float[Array, "..."], ENERGY]
    viscous_dissipation: Annotated[Float[Array, "..."], ENERGY]
    jump_dissipation: Annotated[Float[Array, "..."], ENERGY]


class Evolution(Totals):
    """A viscoelastic contact at given times; arrays have a leading axis of times.

    `evolution[3]` is one state, without that axis. Its memory, and so its verdicts, need
    `fields=True`, except for the last state. In a batch, as after `jax.vmap`, it is the
    fourth evolution.

    Attributes:
        contact: the contact, of a `Viscoelastic` solid.
        load: the load at each time.
        times: the times [time].
        force: the mean pressure times the area of the cell, positive in compression [force].
        fields: gap and memory at each time; None without `fields`.
        last: gap and memory of the last state that was found.
        reached: the time of the last state that was found [time].
        jump_times: when the contact jumped; under JAX transformations the end of each step [time].
        jump_losses: the energy lost in each jump; under JAX transformations in each step [energy].
        largest_tension: the largest of -p0 at the end of any step of the run, between the times
            too: negative if the contact never pulls [pressure].
        largest_tension_time: when that was [time].
        largest_compression: the largest p0, likewise [pressure].
        largest_compression_time: when that was [time].
        num_steps: the number of steps that led to each state from the one before.
        result: a member of `RESULTS`: how each state was reached.

    Example:
        >>> contact = js.Contact(js.Viscoelastic(solid, (1.0,), (0.1,)), heights, law)
        >>> evolution = js.evolve(contact, js.MeanGap([0.3, 0.05]), [0.0, 1.0])
        >>> f"{evolution[-1].mean_pressure:.4f}"
        '-0.1289'
    """

    contact: Contact
    load: Load
    times: Annotated[Float[Array, "..."], TIME]
    force: Annotated[Float[Array, "..."], FORCE]
    fields: Memory | None = eqx.field(repr=False)
    last: Memory | None = eqx.field(repr=False)
    reached: Annotated[Scalar, TIME]
    jump_times: Annotated[Float[Array, " jumps"], TIME]
    jump_losses: Annotated[Float[Array, " jumps"], ENERGY]
    largest_tension: Annotated[Scalar, PRESSURE]
    largest_tension_time: Annotated[Scalar, TIME]
    largest_compression: Annotated[Scalar, PRESSURE]
    largest_compression_time: Annotated[Scalar, TIME]
    num_steps: Int[Array, "..."]
    result: RESULTS

    dissipated = Renamed("viscous_dissipation")
    lost = Renamed("jump_dissipation")
    dissipation = Renamed("jump_losses")

    def __len__(self) -> int:
        if self.times.ndim == 0:
            raise TypeError("This is a single state of an evolution, without entries to choose.")
        return len(self.times)

    def __bool__(self) -> bool:
        return self.times.ndim == 0 or len(self) > 0

    def __getitem__(self, index: Any) -> "Evolution":
        places = np.arange(len(self))[index]
        if self.is_batch:
            return jax.tree.map(lambda leaf: leaf[places], self)
        of_all = {name: getattr(self, name) for name in OF_RUN}
        if places.size == 0:
            of_all["last"] = None
        elif (end := np.ravel(places)[-1]) < len(self) - 1:
            of_all["last"] = jax.tree.map(lambda leaf: entry_at(leaf, end), self.fields)
            of_all["reached"] = jnp.minimum(self.reached, self.times[end])
        picked = replace(self, **dict.fromkeys(OF_RUN))
        return replace(jax.tree.map(lambda leaf: entry_at(leaf, places), picked), **of_all)

    @property
    def is_batch(self) -> bool:
        """Whether these are several evolutions, or states of several."""
        return self.reached.ndim > 0

    @property
    def memory(self) -> Memory:
        """Gap and memory of a single state, or of the last one.

        Raises:
            ValueError: where they were not kept, and for several evolutions.
        """
        if self.is_batch:
            raise ValueError(f"These are {len(self)} evolutions: choose one, as batch[0].")
        if self.last is None:
            raise ValueError(
                "The gap and the memory of this state were not kept: call evolve with fields=True."
            )
        return self.last

    @property
    def equilibrium(self) -> States:
        """The states as a path has them: energies above the start, losses in jumps."""
        contact = self.contact
        gap = None
        if self.fields is not None:
            gap = contact.solid.padded.surface(self.fields.gap)
        return States.of(
            contact,
            self.stored,
            mean_gap=self.mean_gap,
            mean_pressure=self.mean_pressure,
            contact_area=self.contact_area,
            work=self.work,
            dissipation=self.jump_dissipation,
            gap=gap,
        )

    @property
    def gap(self) -> Field:
        """The gap of a single state, or of the last one [length]."""
        return self.contact.solid.padded.surface(self.memory.gap)

    @property
    def instant(self) -> tuple[Contact, Equilibrium]:
        """The contact of a single state, or the last, as it answers at once; its equilibrium.

        The solid is the glassy one, on a surface moved by the memory; on a window both are on the
        larger grid that it is solved on. After a failure the gap is NaN.
        """
        padded = self.contact.padded
        memory = self.memory
        load = self.load
        result = self.result
        if load.value.ndim > 0:
            load = load[-1]
            result = result[-1]
        return _instant(padded, load, memory, result)

    @display.readable
    def __repr__(self) -> str:
        units = self.contact.units
        columns = {"time": column(self.times, "{:.6g}".format)}
        columns |= load_column(self.load, units, ".6g") | state_columns(self.equilibrium)
        balance = {
            "work": self.work,
            "stored": self.stored,
            "dissipated": self.viscous_dissipation,
            "lost": self.jump_dissipation,
        }
        columns |= measured_columns(balance, units, ENERGY)
        columns["steps"] = column(self.num_steps, str)
        extremes = [
            f"largest {name} {units.text(float(value), PRESSURE)} at time {float(time):.6g}"
            for name, value, time in (
                ("tension", self.largest_tension, self.largest_tension_time),
                ("compression", self.largest_compression, self.largest_compression_time),
            )
        ]
        table = display.table(columns | {"result": column(self.result.name, str)})
        return "\n".join([table, *extremes])


@program
def _instant(
    contact: Contact, load: Load, memory: Memory, result: RESULTS
) -> tuple[Contact, Equilibrium]:
    moved = moved_contact(contact, memory, jnp.zeros((), memory.gap.dtype))
    return moved, state_at(
        moved, mean_displacement_as_gap(contact, load), or_nan(memory.gap, result)
    )


def or_nan(tree: Tree, result: RESULTS) -> Tree:
    """Return the leaves of a state, or NaN if it was not found."""
    is_found = result == RESULTS.successful
    return jax.tree.map(lambda leaf: jnp.where(is_found, leaf, jnp.nan), tree)


def require_viscoelastic(contact: Contact) -> None:
    """Raise `TypeError` for anything but a contact of a viscoelastic solid."""
    require_contact(contact)
    cure = "give the contact a Viscoelastic(solid, ratios, times)."
    require_kind(contact.solid, Viscoelastic, f"no solid with relaxation times: {cure}")


def relaxed_contact(contact: Contact) -> Contact:
    """Return the contact of the relaxed solid."""
    solid: Any = contact.solid
    return eqx.tree_at(lambda contact: contact.solid, contact, solid.relaxed)


def moved_contact(contact: Contact, memory: Memory, dt: Scalar) -> Contact:
    """Return the elastic contact of a step from a state: K_step on h + m."""
    solid: Any = contact.solid
    ratios, times = solid.springs
    kept = jnp.tensordot(ratios * jnp.exp(-dt / times), memory.strains, 1) / solid.stiffening(dt)
    moved = solid.step(dt), contact.heights + kept - memory.strains[0]
    return eqx.tree_at(lambda contact: (contact.solid, contact.heights), contact, moved)


def mean_displacement_as_gap(contact: Contact, load: Load) -> Load:
    """Return a mean displacement as the mean gap, which no memory moves, and other loads."""
    control: Any = contact.control(load)
    if isinstance(load, MeanDisplacement):
        return MeanGap(control.mean_gap)
    return load
