"""What a contact goes through: the states along a path, and the jumps between them."""

from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from jaxstab.core import display
from jaxstab.core.display import block, column
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import Stackable
from jaxstab.core.types import Scalar
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load
from jaxstab.paths.branch_end.kind import KINDS
from jaxstab.solids import Solid


class States(Stackable, eqx.Module):
    """The recorded states of a path, in order.

    Attributes:
        mean_gap: mean(g) [length].
        mean_pressure: p0, positive in compression [pressure].
        contact_area: the number of contact points over that of all points.
        area: that of the cell [length^2]; on a line its length [length].
        energy: elastic and adhesive energy of the surface [energy].
        work: done up to here, on surface and spring, by what is prescribed: the change of their
            energy and what the jumps have lost [energy].
        dissipation: energy lost in the jumps up to here [energy].
        gap: g, None unless asked for [length].
    """

    mean_gap: Float[Array, "*states"]
    mean_pressure: Float[Array, "*states"]
    contact_area: Float[Array, "*states"]
    area: Float[Array, "*states"]
    energy: Float[Array, "*states"]
    work: Float[Array, "*states"]
    dissipation: Float[Array, "*states"]
    gap: Float[Array, " *states_and_grid"] | None

    __repr__ = block

    @property
    def force(self) -> Float[Array, "*states"]:
        """The mean pressure times the area of the cell, positive in compression.

        [pressure length^2]; on a line it is a force per length across it [pressure length].
        """
        return self.mean_pressure * self.area

    def on_surface(self, solid: Solid) -> "States":
        """Return the same states with the part of their gaps that has a surface opposite to it."""
        return replace(self, gap=None if self.gap is None else solid.surface(self.gap))

    def in_units_of(self, pressure: Scalar) -> "States":
        """Return the same states with pressures in another unit; lengths stay."""
        return replace(
            self,
            mean_pressure=self.mean_pressure / pressure,
            energy=self.energy / pressure,
            work=self.work / pressure,
            dissipation=self.dissipation / pressure,
        )


class Jump(Stackable, eqx.Module):
    """Where a branch ends, and where the contact goes from there.

    Attributes:
        load: the load [that of the path]; a function of the contact, the only thing of a path that
            can be differentiated.
        kind: a member of `KINDS`: why the branch ends.
        before: the last equilibrium of the branch; NaN, with no contact area, before a touch.
        after: the one that the contact jumps to, at the next load; NaN, with no contact area, where
            it is pulled off.
        mode: the unit vector along which the state loses its stability; NaN at a touch.
        dissipation: the energy lost, the difference of two potentials at one load [energy]; NaN
            where surfaces are pulled off or come together.
        state: the number of the state before, among those recorded.
    """

    load: Load
    kind: KINDS
    before: Equilibrium
    after: Equilibrium
    mode: Float[Array, " *jumps_and_grid"]
    dissipation: Float[Array, "*jumps"]
    state: Int[Array, "*jumps"]

    __repr__ = block

    def on_surface(self, solid: Solid) -> "Jump":
        """Return the same jumps with the part of their fields that has a surface opposite to it."""
        return replace(
            self,
            before=self.before.on_surface(solid),
            after=self.after.on_surface(solid),
            mode=solid.surface(self.mode),
        )

    def in_units_of(self, pressure: Scalar) -> "Jump":
        """Return the same jumps with pressures in another unit; lengths stay."""
        return replace(
            self,
            load=self.load.in_units_of(pressure),
            before=self.before.in_units_of(pressure),
            after=self.after.in_units_of(pressure),
            dissipation=self.dissipation / pressure,
        )


class Path(eqx.Module):
    """The equilibria that a contact goes through under a programme of loads.

    Attributes:
        load: the loads of the recorded states.
        equilibrium: these states.
        jumps: the jumps between them, in order.
        work: of the whole path, done on surface and spring by what is prescribed: the change of
            their energy and what the jumps have lost [energy]. NaN where a dead load has pulled the
            surfaces apart, which it does without end; `equilibrium.work` is known up to there.
        dissipation: the sum of what the jumps lose [energy]; NaN as the work is.
        result: how the path ended.
        unlocated: what steps between jumps may have lost beside these, the work on them by
            quadrature less the change of energy [energy]; None in files of version 0.1.0.
        unlocated_error: the error of that quadrature; less than this is nothing [energy].
    """

    load: Load
    equilibrium: States
    jumps: Jump
    work: Scalar
    dissipation: Scalar
    result: RESULTS
    unlocated: Scalar | None = None
    unlocated_error: Scalar | None = None

    def __repr__(self) -> str:
        return _text(self)

    def on_surface(self, solid: Solid) -> "Path":
        """Return the same path with the part of its fields that has a surface opposite to it."""
        return replace(
            self,
            equilibrium=self.equilibrium.on_surface(solid),
            jumps=self.jumps.on_surface(solid),
        )

    def in_units_of(self, pressure: Scalar) -> "Path":
        """Return the same path with pressures in another unit; lengths stay."""
        names = "work", "dissipation", "unlocated", "unlocated_error"
        energies = {name: getattr(self, name) for name in names}
        return replace(
            self,
            load=self.load.in_units_of(pressure),
            equilibrium=self.equilibrium.in_units_of(pressure),
            jumps=self.jumps.in_units_of(pressure),
            **{name: value / pressure for name, value in energies.items() if value is not None},
        )


def _text(path: "Path") -> str:
    """Return what a path is in lines, and a table with one line for each of its jumps."""
    try:
        loads, jumps = np.asarray(path.load.value), path.jumps
        name = type(path.load).__name__
        lines = [
            f"Path: {name} {display.number(loads[0])} to {display.number(loads[-1])} in "
            f"{loads.size} states, {len(jumps)} jumps; {path.result.name}",
            *_energies(path),
        ]
        return "\n".join([*lines, display.table(_jumps(name, jumps))] if len(jumps) else lines)
    except display.UNREADABLE:
        return display.block(path)


def _energies(path: "Path") -> list[str]:
    """Return the lines on the work along a path and on what it has lost."""
    work, losses = np.asarray(path.equilibrium.work), np.asarray(path.jumps.dissipation)
    if np.isfinite(path.work):
        lines = [
            f"  work  {display.described(path.work)}",
            f"  lost in {len(losses)} jumps  {display.number(losses.sum())}",
        ]
    else:
        known, number = work[np.isfinite(work)][-1], np.isfinite(np.cumsum(losses)).sum()
        lines = [
            f"  work until the surfaces fall apart  {display.number(known)}",
            f"  lost in {number} jumps before  {display.number(losses[:number].sum())}",
            "  after that neither is known: a dead load pulls surfaces apart without end",
        ]
    if path.unlocated is None or path.unlocated_error is None:
        lines[0] += " by quadrature, as version 0.1.0 had it"
    elif path.unlocated > path.unlocated_error:
        amount, error = float(path.unlocated), float(path.unlocated_error)
        lines.append(f"  lost in jumps not located  {amount:.2g} ± {error:.1g}")
    return lines


def _jumps(name: str, jumps: Jump) -> dict[str, list[str]]:
    areas = [state.contact_area for state in (jumps.before, jumps.after)]
    before, after = (column(area, lambda part: f"{100 * part:.2f} %") for area in areas)
    return {
        name: column(jumps.load.value, "{:.8g}".format),
        "kind": column(jumps.kind.name, str),
        "dissipation": column(jumps.dissipation, "{:.4e}".format),
        "mean pressure": column(jumps.before.mean_pressure, "{:+.4e}".format),
        "contact area": before,
        "after": after,
    }
