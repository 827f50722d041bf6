"""What a contact goes through: the states along a path, and the jumps between them."""

from dataclasses import replace

import equinox as eqx
from jaxtyping import Array, Float, Int

from jaxstab.core import display
from jaxstab.core.display import block
from jaxstab.core.results import KINDS, RESULTS
from jaxstab.core.stack import Stackable
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load
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

    def in_units_of(self, pressure: Float[Array, ""]) -> "States":
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

    def in_units_of(self, pressure: Float[Array, ""]) -> "Jump":
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
    work: Float[Array, ""]
    dissipation: Float[Array, ""]
    result: RESULTS
    unlocated: Float[Array, ""] | None = None
    unlocated_error: Float[Array, ""] | None = None

    __repr__ = display.path

    def on_surface(self, solid: Solid) -> "Path":
        """Return the same path with the part of its fields that has a surface opposite to it."""
        return replace(
            self,
            equilibrium=self.equilibrium.on_surface(solid),
            jumps=self.jumps.on_surface(solid),
        )

    def in_units_of(self, pressure: Float[Array, ""]) -> "Path":
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
