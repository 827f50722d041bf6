"""The path of a contact along a load path, and its jumps."""

from dataclasses import replace
from typing import Annotated, Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.branches.barrier_law import BarrierLaw
from jaxstab.contact import Contact
from jaxstab.core import display
from jaxstab.core.compile import program
from jaxstab.core.display import Outcome, column, several
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Scalar
from jaxstab.core.units import ENERGY, LENGTH, NUMBER, readable_unit, shown_unit
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load, Spring
from jaxstab.states.columns import load_column, measured_columns, percent_column, state_columns
from jaxstab.states.kinds import KINDS
from jaxstab.states.sequence import PathState, StateSequence

# The tension over the largest one below which surfaces count as apart.
_ALMOST_APART = 0.05


class Jump(Outcome):
    """Where a branch ends, and where the contact goes from there.

    Attributes:
        load: the load [as in the path], the only differentiable function of the contact in a
            path.
        kind: a member of `KINDS`: why the branch ends.
        before: the last equilibrium of the branch; NaN, with no contact area, before a touch.
        after: the equilibrium to which the contact jumps, at the next load; NaN, with no contact
            area, where it is pulled off.
        mode: the unit vector along which the state loses its stability; NaN at a touch.
        dissipation: the energy lost, the difference of two potentials at one load [energy]; NaN
            where surfaces are pulled off or come together. The plastic work is none of it.
        state: the number of the state before, among those recorded.
        barrier_law: how the barrier that holds the state before grows with the distance from the
            load of the jump, and up to which distance. The energy is of second order in the mode's
            amplitude at a release, of third at a fold; the law is unknown where a point begins to
            yield.
        plastic_work: in the jump, on a surface with a hardness; otherwise None [energy].

    Example:
        >>> path = js.follow(contact, js.MeanGap([0.3, 0.03, 0.3]), fields=True)
        >>> f"{path.jumps[0].before.contact_area:.3f} {path.jumps[0].after.contact_area:.3f}"
        '0.215 0.223'
    """

    load: Load
    kind: KINDS
    before: Equilibrium
    after: Equilibrium
    mode: Annotated[Float[Array, " *jumps_and_grid"], NUMBER]
    dissipation: Annotated[Float[Array, "*jumps"], ENERGY]
    state: Int[Array, "*jumps"]
    barrier_law: BarrierLaw
    plastic_work: Annotated[Float[Array, "*jumps"], ENERGY] | None = None


class Path(StateSequence):
    """The equilibria through which a contact goes along a load path.

    `path[3]` is a recorded state, `len(path)` their number. The last state, `path[-1]`, always has
    its gap. So `follow(contact, rest, initial=path[-1])` goes on with a path that was interrupted.
    In a batch, as after `jax.vmap`, `batch[3]` is the fourth path, without empty entries.

    Attributes:
        load: the loads of the recorded states.
        equilibrium: these states.
        jumps: the jumps between them, in order.
        work: of the whole path, done on surface and spring by the load: the change of their energy,
            the loss in the jumps, and the plastic work [energy]. NaN where a dead load has pulled
            the surfaces apart, which it does without end; `equilibrium.work` is known up to there.
        dissipation: the loss in all jumps [energy]; NaN as the work is.
        result: how the path ended. It has failed, as `unbalanced_work`, if steps between jumps have
            gained energy, so that `unlocated` is below zero by more than its error.
        unlocated: the loss that steps between jumps may hide: the work by quadrature minus the
            change of energy [energy].
        unlocated_error: the error of that quadrature, and no less than the smallest jump that is
            located; a smaller loss is not significant [energy].
        last_gap: g of the last recorded state [length].
        last_indentation: z of that state, over the surface with which the path began; None for a
            contact without a hardness [length].
        plastic_work: since the first state, that of jumps included [energy]; None likewise.
        contact: the contact over the surface that is left, from which another path can go on; None
            likewise.

    Example:
        >>> path = js.follow(contact, js.MeanGap([0.3, 0.03, 0.3]), fields=True)
        >>> f"{path.dissipation:.2e}", len(path.jumps)
        ('2.30e-06', 2)
    """

    jumps: Jump
    work: Annotated[Scalar, ENERGY]
    dissipation: Annotated[Scalar, ENERGY]
    result: RESULTS
    unlocated: Annotated[Scalar, ENERGY]
    unlocated_error: Annotated[Scalar, ENERGY]
    last_gap: Annotated[Field, LENGTH]
    last_indentation: Annotated[Field, LENGTH] | None = None
    plastic_work: Annotated[Scalar, ENERGY] | None = None
    contact: Contact | None = None
    _of_events: ClassVar[str] = "jumps"

    def __getitem__(self, index: Any) -> PathState | Self:
        state = super().__getitem__(index)
        is_last = isinstance(index, int | np.integer) and index % len(self) == len(self) - 1
        if is_last and isinstance(state, PathState) and self.equilibrium.gap is None:
            last = replace(state.equilibrium, gap=self.last_gap, indentation=self.last_indentation)
            return replace(state, equilibrium=last)
        return state

    @property
    def work_of_separation(self) -> Scalar:
        """The work per area that the last retraction takes from zero load until detachment.

        -int p0 dl over the tensile part of the retraction, losses in jumps included: the effective
        work of separation of a rough surface, to be compared with the work of adhesion w. It is the
        difference of `equilibrium.work` between the two states, and needs no quadrature; between
        the two recorded states around zero load p0 is taken as linear [energy/area].

        The retraction is what the load rises through at the end of the path. If all of it is under
        tension, it counts from its first state. NaN for a path that ends approaching or in contact,
        or at a tension above 5 % of the largest, as detachment lies beyond it; and for a load that
        is a pressure, which works without end once it has pulled the surfaces apart. The area is
        the surface's.
        """
        if self.load.unit != LENGTH:
            return jax.device_put(np.full(self.work.shape, np.nan, self.work.dtype))
        states = self.equilibrium
        return _work_of_separation(
            self.load.value, states.mean_pressure, states.work, states.contact_area, states.area
        )

    @display.readable
    def __repr__(self) -> str:
        path = self.recorded
        lines = [
            f"Path: {path._extent}, {several(len(path.jumps), 'jump')}; {path.result.name}",
            *_energies(path),
        ]
        if len(path.jumps):
            lines.append(display.table(_jumps(path.jumps)))
        return "\n".join(lines)


@program
def _work_of_separation(
    load: Array, pressure: Array, work: Array, contact_area: Array, area: Array
) -> Array:
    """Return `Path.work_of_separation` from the fields of the states, along the last axis."""
    number = jnp.arange(load.shape[-1])
    is_state = jnp.isfinite(load)

    def at(field: Array, place: Array) -> Array:
        return jnp.take_along_axis(field, place[..., None], -1)[..., 0]

    def last(condition: Array) -> Array:
        return jnp.max(jnp.where(condition, number, -1), axis=-1)

    end = last(is_state)
    has_fallen = jnp.diff(load, axis=-1, prepend=jnp.inf) <= 0
    first = last(has_fallen & is_state)
    retracts = (number >= first[..., None]) & is_state
    tension = jnp.where(retracts, -pressure, -jnp.inf)
    strongest = jnp.argmax(tension, axis=-1)
    before = last(retracts & (pressure >= 0) & (number < strongest[..., None]))
    start = jnp.where(before < 0, first, before)
    pressed = at(pressure, start)
    pulled = at(pressure, start + 1)
    step = at(load, start + 1) - at(load, start)
    # The area under a line from the last pressure to zero.
    until_zero = jnp.where(before < 0, 0, -pressed * (pressed / (pressed - pulled)) * step / 2)
    separation = (at(work, end) - at(work, start)) / area[..., 0] - until_zero
    largest = at(tension, strongest)
    # Surfaces without adhesion are apart where their pressure has gone.
    highest = jnp.max(jnp.where(retracts, pressure, 0), axis=-1)
    scale = jnp.where(largest > 0, largest, highest)
    is_apart = (at(contact_area, end) == 0) & (abs(at(pressure, end)) <= _ALMOST_APART * scale)
    is_known = is_apart & (first < end)
    return jnp.where(is_known, jnp.where(largest > 0, separation, 0), jnp.nan)


def _energies(path: Path) -> list[str]:
    work = np.asarray(path.equilibrium.work)
    losses = np.asarray(path.jumps.dissipation)
    is_known = np.isfinite(path.work)
    if is_known:
        number = len(losses)
        done = float(path.work)
    else:
        number = int(np.isfinite(np.cumsum(losses)).sum())
        done = float(work[np.isfinite(work)][-1])
    lost = float(losses[:number].sum())
    # One unit for all, as they are compared.
    divisor, unit = readable_unit(path.equilibrium.units, ENERGY, max(abs(done), lost))
    energies = [f"{value / divisor:.6g} {shown_unit(unit)}".rstrip() for value in (done, lost)]
    jumps = several(number, "jump")
    if isinstance(path.load, Spring):
        jumps += ", by contact and spring together"
    if is_known:
        lines = [f"  work  {energies[0]}", f"  lost in {jumps}  {energies[1]}"]
    else:
        lines = [
            f"  work until the surfaces fall apart  {energies[0]}",
            f"  lost in {jumps} before  {energies[1]}",
            "  after that neither is known: a dead load pulls surfaces apart without end",
        ]
    if path.plastic_work is not None:
        plastic = float(np.asarray(path.equilibrium.plastic_work)[np.isfinite(work)][-1])
        if is_known:
            plastic = float(path.plastic_work)
        lines.insert(1, f"  plastic work  {plastic / divisor:.6g} {shown_unit(unit)}".rstrip())
    if abs(path.unlocated) > path.unlocated_error:
        amount = float(path.unlocated) / divisor
        error = float(path.unlocated_error) / divisor
        name = "lost in jumps not located"
        if amount <= 0:
            name = "lost between jumps, which cannot be:"
        lines.append(f"  {name}  {amount:.2g} ± {error:.1g} {shown_unit(unit)}".rstrip())
    broken = int(np.sum(np.asarray(path.jumps.kind == KINDS.bifurcation)))
    if broken:
        places = several(broken, "bifurcation")
        lines.append(f"  a symmetry was broken at {places}: another disturbance may lead elsewhere")
    return lines


def _jumps(jumps: Jump) -> dict[str, list[str]]:
    units = jumps.before.units
    return {
        **load_column(jumps.load, units, ".8g"),
        "kind": column(jumps.kind.name, str),
        **measured_columns({"dissipation": jumps.dissipation}, units, ENERGY, ".4e"),
        **state_columns(jumps.before),
        "after": percent_column(jumps.after.contact_area),
    }
