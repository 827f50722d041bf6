"""The states of a contact along a path or a branch, and its jumps or turning points."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, Self

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.core import display
from jaxstab.core.display import Outcome, column, several
from jaxstab.core.results import RESULTS
from jaxstab.core.types import Field, Scalar
from jaxstab.core.units import (
    AREA,
    ENERGY,
    LENGTH,
    NO_UNITS,
    NUMBER,
    PRESSURE,
    Dimensioned,
    Units,
    measured,
    readable_unit,
    shown_unit,
)
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load, Spring
from jaxstab.paths.barrier_law import BarrierLaw
from jaxstab.paths.kinds import KINDS
from jaxstab.paths.tables import load_column, measured_columns, percent_column, state_columns


class PathInterrupted(UserWarning):
    """A path was interrupted; it holds the states so far."""


class States(Outcome):
    """The recorded states of a path, in order.

    Attributes:
        mean_gap: mean(g) [length].
        mean_pressure: p0, positive in compression [pressure].
        contact_area: the number of contact points over the number of all points.
        area: the area of the cell [length^2]; on a line its length [length].
        energy: elastic and adhesive energy of the surface [energy].
        work: done up to here on surface and spring by the load: the change of their energy and the
            loss in the jumps [energy].
        dissipation: energy lost in the jumps up to here [energy].
        gap: g, None without `fields` [length].
        units: the units of length and of pressure, None where unknown.
        is_window: whether the surface is a window, pressed by a force, and not repeated.
    """

    mean_gap: Annotated[Float[Array, "*states"], LENGTH]
    mean_pressure: Annotated[Float[Array, "*states"], PRESSURE]
    contact_area: Annotated[Float[Array, "*states"], NUMBER]
    area: Annotated[Float[Array, "*states"], AREA]
    energy: Annotated[Float[Array, "*states"], ENERGY]
    work: Annotated[Float[Array, "*states"], ENERGY]
    dissipation: Annotated[Float[Array, "*states"], ENERGY]
    gap: Annotated[Float[Array, " *states_and_grid"], LENGTH] | None
    units: Units = eqx.field(static=True, default=NO_UNITS, repr=False)
    is_window: bool = eqx.field(static=True, default=False, repr=False)

    @property
    def force(self) -> Float[Array, "*states"]:
        """The mean pressure times the area of the cell, positive in compression.

        [force]; on a line it is a force per length across it [force/length].
        """
        return self.mean_pressure * self.area


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
            where surfaces are pulled off or come together.
        state: the number of the state before, among those recorded.
        barrier_law: how the barrier that holds the state before grows with the distance from the
            load of the jump, and up to which distance. The energy is of second order in the mode's
            amplitude at a release, of third at a fold.
    """

    load: Load
    kind: KINDS
    before: Equilibrium
    after: Equilibrium
    mode: Annotated[Float[Array, " *jumps_and_grid"], NUMBER]
    dissipation: Annotated[Float[Array, "*jumps"], ENERGY]
    state: Int[Array, "*jumps"]
    barrier_law: BarrierLaw


class Turn(Outcome):
    """Where the load turns back along a branch, or another branch crosses it.

    Attributes:
        load: the load there.
        kind: a member of `KINDS`: a fold, a release, a touch, or a bifurcation, where the load
            does not turn back.
        equilibrium: the state.
        mode: the unit vector along which the branch goes on there, at a bifurcation the other one.
        state: the number of the state after it, among the states of the branch.
    """

    load: Load
    kind: KINDS
    equilibrium: Equilibrium
    mode: Annotated[Field, NUMBER]
    state: Int[Array, ""]


class PathState(Outcome):
    """A recorded state of a path, or several: `path[-1]`, `path[3:5]`.

    A state with a gap can start further equilibria and paths, as `initial=`.

    Attributes:
        load: its load.
        equilibrium: the state.
    """

    load: Load
    equilibrium: States


class StateSequence(Dimensioned):
    """States in order: `path[3]` is one of them, `path[3:5]` are several, `len(path)` all.

    In a batch, as after `jax.vmap`, `batch[3]` is the fourth path.

    Attributes:
        load: the loads of the recorded states.
        equilibrium: these states.
    """

    load: Load
    equilibrium: States

    def __len__(self) -> int:
        return len(self.load)

    def __getitem__(self, index: Any) -> PathState | Self:
        if self.load.value.ndim > 1:
            entry = np.arange(len(self))[index]
            return jax.tree.map(lambda leaf: leaf[entry], self)
        return PathState(self.load[index], self.equilibrium[index])

    def __iter__(self) -> Iterator[PathState | Self]:
        return (self[i] for i in range(len(self)))

    @property
    def _extent(self) -> str:
        """The first and the last load and the number of states, in words."""
        loads, units = np.asarray(self.load.value), self.equilibrium.units
        first, last = (measured(units, loads[i], self.load.unit, digits=6) for i in (0, -1))
        return f"{type(self.load).__name__} {first} to {last} in {several(loads.size, 'state')}"


class Path(StateSequence):
    """The equilibria through which a contact goes along a load path.

    `path[3]` is a recorded state, `len(path)` their number. The last state, `path[-1]`, always has
    its gap. So `follow(contact, rest, initial=path[-1])` goes on with a path that was interrupted.
    In a batch, as after `jax.vmap`, `batch[3]` is the fourth path.

    Attributes:
        load: the loads of the recorded states.
        equilibrium: these states.
        jumps: the jumps between them, in order.
        work: of the whole path, done on surface and spring by the load: the change of their energy
            and the loss in the jumps [energy]. NaN where a dead load has pulled the surfaces apart,
            which it does without end; `equilibrium.work` is known up to there.
        dissipation: the loss in all jumps [energy]; NaN as the work is.
        result: how the path ended. It has failed, as `unbalanced_work`, if steps between jumps have
            gained energy, so that `unlocated` is below zero by more than its error.
        unlocated: the loss that steps between jumps may hide: the work by quadrature minus the
            change of energy [energy].
        unlocated_error: the error of that quadrature, and no less than the smallest jump that is
            located; a smaller loss is not significant [energy].
        last_gap: g of the last recorded state [length].
    """

    jumps: Jump
    work: Annotated[Scalar, ENERGY]
    dissipation: Annotated[Scalar, ENERGY]
    result: RESULTS
    unlocated: Annotated[Scalar, ENERGY]
    unlocated_error: Annotated[Scalar, ENERGY]
    last_gap: Annotated[Field, LENGTH]

    def __getitem__(self, index: Any) -> PathState | Self:
        state = super().__getitem__(index)
        is_last = isinstance(index, int | np.integer) and index % len(self) == len(self) - 1
        if is_last and isinstance(state, PathState) and self.equilibrium.gap is None:
            last = replace(state.equilibrium, gap=self.last_gap)
            return replace(state, equilibrium=last)
        return state

    @display.readable
    def __repr__(self) -> str:
        lines = [
            f"Path: {self._extent}, {several(len(self.jumps), 'jump')}; {self.result.name}",
            *_energies(self),
        ]
        table = [display.table(_jumps(self.jumps))] if len(self.jumps) else []
        return "\n".join([*lines, *table])


class Branch(StateSequence):
    """Equilibria along a branch, stable or not, where its load turns, and where others cross.

    `branch[3]` is a state, `len(branch)` their number.

    Attributes:
        load: the loads of the states, in the order of the branch.
        equilibrium: the states. A branch is reversible: nothing is lost, and the work is the change
            of energy.
        index: the Morse index of each: the number of negative eigenvalues of A among perturbations
            of its free points that the load allows. Zero means a minimum, 19 that number or more,
            -1 that it was not found.
        turns: where the load turns back, and where another branch crosses at a bifurcation, in
            order.
        end: a member of `KINDS`: why the branch ends there.
        result: how the search ended.
    """

    index: Int[Array, " states"]
    turns: Turn
    end: KINDS
    result: RESULTS

    @display.readable
    def __repr__(self) -> str:
        index = np.asarray(self.index)
        unknown = f"{np.sum(index < 0)} of unknown index, " if np.any(index < 0) else ""
        lines = [
            f"Branch: {self._extent}, {np.sum(index > 0)} of them unstable, {unknown}"
            f"{several(len(self.turns), 'turn')}; "
            f"ends {str(KINDS[self.end]).split(': ', 1)[1]}; {self.result.name}"
        ]
        table = [display.table(_turns(self.turns))] if len(self.turns) else []
        return "\n".join([*lines, *table])


def _energies(path: Path) -> list[str]:
    work, losses = np.asarray(path.equilibrium.work), np.asarray(path.jumps.dissipation)
    is_known = np.isfinite(path.work)
    number = len(losses) if is_known else np.isfinite(np.cumsum(losses)).sum()
    done = float(path.work if is_known else work[np.isfinite(work)][-1])
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
    if abs(path.unlocated) > path.unlocated_error:
        amount, error = float(path.unlocated) / divisor, float(path.unlocated_error) / divisor
        name = "lost in jumps not located" if amount > 0 else "lost between jumps, which cannot be:"
        lines.append(f"  {name}  {amount:.2g} ± {error:.1g} {shown_unit(unit)}".rstrip())
    broken = int(np.sum(np.asarray(path.jumps.kind == KINDS.bifurcation)))
    if broken:
        place = "a bifurcation" if broken == 1 else f"{broken} bifurcations"
        lines.append(f"  a symmetry was broken at {place}: another disturbance may lead elsewhere")
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


def _turns(turns: Turn) -> dict[str, list[str]]:
    state = turns.equilibrium
    return {
        **load_column(turns.load, state.units, ".8g"),
        "kind": column(turns.kind.name, str),
        **state_columns(state),
    }
