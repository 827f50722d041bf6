"""What a contact goes through: the states along a path, and the jumps between them."""

import equinox as eqx
from jaxtyping import Array, Float, Int

from jaxstab.display import block
from jaxstab.enumerations import Enumeration, member
from jaxstab.equilibrium import Equilibrium
from jaxstab.loads import Load
from jaxstab.results import RESULTS
from jaxstab.stacks import Stackable


class KINDS(Enumeration):
    """Why a branch of equilibria ends."""

    fold = member("the smallest eigenvalue on the critical cone vanishes")
    release = member("a contact point lets go, and on the cone that opens with it energy falls")
    touch = member("surfaces that a pull had taken apart come back together")


class States(Stackable, eqx.Module):
    """The recorded states of a path, in order.

    Attributes:
        mean_gap: mean(g) [length].
        mean_pressure: p0, positive in compression [pressure].
        contact_area: the number of contact points over that of all points.
        energy: elastic and adhesive energy of the surface [energy].
        work: done up to here, on surface and spring, by what is prescribed [energy].
        dissipation: energy lost up to here, in jumps located or not [energy].
        gap: g, None unless asked for [length].
    """

    mean_gap: Float[Array, "*states"]
    mean_pressure: Float[Array, "*states"]
    contact_area: Float[Array, "*states"]
    energy: Float[Array, "*states"]
    work: Float[Array, "*states"]
    dissipation: Float[Array, "*states"]
    gap: Float[Array, " *states_and_grid"] | None

    __repr__ = block


class Jump(Stackable, eqx.Module):
    """Where a branch ends, and where the contact goes from there.

    Attributes:
        load: the load [that of the path].
        kind: a member of `KINDS`: why the branch ends.
        before: the last equilibrium of the branch.
        after: the one that the contact jumps to, at the next load; NaN where it is pulled off.
        mode: the unit vector along which the state loses its stability.
        dissipation: the energy lost [energy]; NaN where surfaces are pulled off or come together.
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


class Path(eqx.Module):
    """The equilibria that a contact goes through under a programme of loads.

    Attributes:
        load: the loads of the recorded states.
        equilibrium: these states.
        jumps: the jumps between them, in order.
        work: of the whole path, done on surface and spring by what is prescribed [energy].
        dissipation: energy lost on the whole path, in jumps located or not [energy].
        result: how the path ended.
    """

    load: Load
    equilibrium: States
    jumps: Jump
    work: Float[Array, ""]
    dissipation: Float[Array, ""]
    result: RESULTS

    __repr__ = block
