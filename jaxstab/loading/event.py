"""The jumps and touches that load stepping detects."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxstab.contact import Contact
from jaxstab.core.compile import program
from jaxstab.core.control_flow import cond
from jaxstab.core.grid import mean
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.equilibrium.equilibrium import detached_where, state_at
from jaxstab.loads import Load
from jaxstab.states.point import PathPoint


class Event(eqx.Module):
    """A jump along a load path, or a touch of surfaces that were apart.

    An empty row of a table is neither.

    Attributes:
        before: the state before.
        after: the state after it, at the next load.
        ahead: how far ahead that load lies, with its sign.
        dissipation: the energy lost [energy]; NaN where surfaces fall apart or touch.
        state: the number of the state before, among those recorded.
        is_jump: whether it is a jump, from the end of a branch.
        is_pulled: whether the surfaces fall apart in the jump.
        is_touch: whether it is a touch.
    """

    before: PathPoint
    after: PathPoint
    ahead: Scalar
    dissipation: Scalar
    state: Int[Array, ""]
    is_jump: Flag
    is_pulled: Flag
    is_touch: Flag

    @property
    def plastic_work(self) -> Scalar | None:
        """The plastic work between both states [energy]; None if nothing yields."""
        before = self.before.plastic_work
        after = self.after.plastic_work
        if before is None or after is None:
            return None
        return _difference(after, before)

    def equilibrium_before(self, contact: Contact, load: Load) -> Equilibrium:
        """Return the equilibrium before it, given the load at any value."""
        return _equilibrium_unless(self.is_touch, contact, load, self.before)

    def equilibrium_after(self, contact: Contact, load: Load) -> Equilibrium:
        """Return the equilibrium after it, given the load at any value."""
        return _equilibrium_unless(self.is_pulled, contact, load, self.after)


def load_on_indented(load: Load, point: PathPoint) -> Load:
    """Return a load as one for the surface that a state leaves."""
    if point.indentation is None:
        return load
    return _lower_load(load, point.indentation)


@program
def _difference(after: Scalar, before: Scalar) -> Scalar:
    return after - before


@program
def _lower_load(load: Load, indentation: Field) -> Load:
    return load.after_indentation(mean(indentation))


def no_event(here: PathPoint) -> Event:
    """Return an event at a state that is neither a jump nor a touch."""
    zero = jnp.zeros_like(here.value)
    no = jnp.array(False)
    return Event(
        before=here,
        after=here,
        ahead=zero,
        dissipation=zero,
        state=jnp.array(0),
        is_jump=no,
        is_pulled=no,
        is_touch=no,
    )


def _equilibrium_unless(
    is_apart: Flag, contact: Contact, load: Load, point: PathPoint
) -> Equilibrium:
    """Return the equilibrium of a point; where surfaces are apart there is none."""
    load = load.at(point.value)
    return cond(
        is_apart,
        lambda: _none(contact, load, point),
        lambda: _state(contact, load, point),
    )


def _state(contact: Contact, load: Load, point: PathPoint) -> Equilibrium:
    """Return a state of a path; a surface that yields has been indented up to there."""
    if point.indentation is None:
        return state_at(contact, load, point.gap)
    return _indented_state(contact, load, point)


@program
def _indented_state(contact: Contact, load: Load, point: PathPoint) -> Equilibrium:
    state = state_at(contact.after(point), load_on_indented(load, point), point.gap)
    indentation, plastic_work = point.indentation, point.plastic_work
    return replace(state, load=load, indentation=indentation, plastic_work=plastic_work)


@program
def _none(contact: Contact, load: Load, point: PathPoint) -> Equilibrium:
    return detached_where(jnp.array(True), _state(contact, load, point))
