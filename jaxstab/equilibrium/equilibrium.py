"""An equilibrium, its fields, and the conversion of other results to equilibria."""

from dataclasses import replace
from typing import Annotated, Any, Protocol

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxstab.contact.contact import Contact, require_contact
from jaxstab.contact.residual import Balance
from jaxstab.core import model
from jaxstab.core.checks import are_finite, require_finite, require_shape, where_known
from jaxstab.core.compile import program
from jaxstab.core.display import Outcome
from jaxstab.core.grid import mean, total
from jaxstab.core.history import History
from jaxstab.core.results import RESULTS
from jaxstab.core.stack import require_single
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.core.units import (
    AREA,
    ENERGY,
    LENGTH,
    NO_UNITS,
    NUMBER,
    PRESSURE,
    Units,
)
from jaxstab.loads.load import Load
from jaxstab.potentials.evaluation import slope

Fields = dict[str, Array]

# The fields of an `Equilibrium` that can be differentiated, and those of a surface that yields.
DIFFERENTIABLE = ("displacement", "gap", "pressure", "reaction", "mean_pressure", "energy")
OF_YIELDING = ("indentation", "plastic_work")


class PressedSurface(Outcome):
    """A surface under a mean pressure, or several; if it is a window, the force is shown too."""

    mean_pressure: eqx.AbstractVar[Float[Array, "..."]]
    area: eqx.AbstractVar[Float[Array, "..."]]
    is_window: eqx.AbstractVar[bool]

    @property
    def force(self) -> Float[Array, "..."]:
        """The mean pressure times the area of the cell, positive in compression.

        [force]; on a line it is a force per length across it [force/length].
        """
        return self.mean_pressure * self.area

    @property
    def derived(self) -> tuple[str, ...]:
        """The force, if the surface is a window."""
        if self.is_window:
            return ("force",)
        return ()


class Equilibrium(PressedSurface):
    """An equilibrium K u + p0 + f'(g) = mu, g >= 0, mu >= 0, mu g = 0 (Rey & Bleyer, 9 and 10).

    Attributes:
        load: the load that holds it.
        displacement: u = g + h [length].
        gap: g, exactly zero at the points in contact [length].
        pressure: the elastic pressure K u + p0, positive in compression [pressure].
        reaction: mu, the pressure of contact; zero out of contact [pressure].
        in_contact: where the surfaces are in contact: where the gap is zero and, under a law that
            repels at zero gap, up to the gap at which its attraction is largest.
        mean_pressure: p0 = mean(mu - f'(g)), positive in compression [pressure].
        contact_area: the number of contact points over the number of all points; NaN if no gap is
            zero and the law repels at every gap, so that contact is not defined.
        area: the area of the cell [length^2]; on a line its length [length].
        energy: elastic and adhesive energy of the surface [energy]; without the energy of a uniform
            compression, nor of a spring.
        residual: the relative optimality residual.
        num_steps: steps that the solver took.
        result: a member of `RESULTS`: how the solver ended.
        history: the indicator "residual" at the solver's steps and, if the solver measures it,
            "energy". That is u.Ku / 2 + sum f(g) (Rey & Bleyer, eq. 15) and the work of the load:
            the energy of the surface over the area of one cell [energy/area].
        units: the units of length and of pressure, None where unknown.
        is_window: whether the surface is a window, pressed by a force, and not repeated.
        indentation: z, the depth by which the surface, as the contact has it, has been flattened
            for good [length]; u = g + h - z. None on a surface without a hardness.
        plastic_work: sum H z over the surface, which that took [energy]; None likewise.

    Example:
        >>> f"{state.gap.mean():.3f}, {state.gap.min():.1f}"
        '0.050, 0.0'
    """

    load: Load
    displacement: Annotated[Field, LENGTH]
    gap: Annotated[Field, LENGTH]
    pressure: Annotated[Field, PRESSURE]
    reaction: Annotated[Field, PRESSURE]
    in_contact: Mask
    mean_pressure: Annotated[Scalar, PRESSURE]
    contact_area: Annotated[Scalar, NUMBER]
    area: Annotated[Scalar, AREA]
    energy: Annotated[Scalar, ENERGY]
    residual: Annotated[Scalar, NUMBER]
    num_steps: Int[Array, ""]
    result: RESULTS
    history: History
    units: Units = eqx.field(static=True, default=NO_UNITS, repr=False)
    is_window: bool = eqx.field(static=True, default=False, repr=False)
    indentation: Annotated[Field, LENGTH] | None = None
    plastic_work: Annotated[Scalar, ENERGY] | None = None

    @property
    def signed_gap(self) -> Field:
        """The gap where the surfaces are apart, less the indentation where they yield [length]."""
        if self.indentation is None:
            return self.gap
        return _signed_gap(self.gap, self.indentation)

    @property
    def is_yielding(self) -> Mask | None:
        """Where the surface yields: where there is indentation; None without a hardness."""
        if self.indentation is None:
            return None
        return self.indentation > 0

    @property
    def yielded_area(self) -> Scalar | None:
        """The number of yielding points over the number of all; None without a hardness."""
        indentation = self.indentation
        if indentation is None:
            return None
        # NaN of a state that was not found.
        share = jnp.where(jnp.isnan(indentation), jnp.nan, indentation > 0)
        sides = tuple(range(self.contact_area.ndim, self.gap.ndim))
        return jnp.mean(share.astype(self.gap.dtype), axis=sides)

    def in_units_of(self, pressure: Scalar) -> "Equilibrium":
        """Return the same with pressures in another unit; no result where its energy overflows."""
        found = super().in_units_of(pressure)
        overflows = (self.result == RESULTS.successful) & ~jnp.isfinite(found.energy)
        return replace(found, result=RESULTS.where(overflows, RESULTS.nonfinite, self.result))

    @property
    def mean_gap(self) -> Scalar:
        """The mean of the gap over the cell [length]."""
        sides = tuple(range(self.contact_area.ndim, self.gap.ndim))
        return jnp.mean(self.gap, axis=sides)


@program
def _signed_gap(gap: Field, indentation: Field) -> Field:
    return gap - indentation


def fields_of(contact: Contact, load: Load, gap: Field) -> tuple[Fields, Field]:
    """Return the differentiable fields of an equilibrium, and the force on its free points.

    Its gap, signed on a surface that yields, is brought under the load if the load is another one,
    and moves with it.
    """
    control = contact.control(load)
    gap = control.restore(gap)
    pressures = contact.pressures(gap)
    net = control.net_pressure(pressures.gradient, gap)
    energy = pressures.energy * contact.grid.cell_area
    plastic_work = None
    if pressures.plastic is not None:
        plastic_work = total(pressures.plastic) * contact.grid.cell_area
    fields = fields_at(contact, gap, net, energy, plastic_work)
    return fields, model.on_side(net, gap, control.largest_reaction)


def fields_at(
    contact: Contact, gap: Field, net: Field, energy: Scalar, plastic_work: Scalar | None
) -> Fields:
    """Return the differentiable fields of a state from its gap, NaN where it is, and the rest."""
    opened = contact.open_gap(gap)
    attraction = slope(contact.potential, opened)
    reaction = model.reaction(net, gap)
    fields = {
        "displacement": contact.displacement(gap),
        "gap": opened,
        "pressure": net - attraction,
        "reaction": reaction,
        "mean_pressure": mean(contact.solid.surface(reaction - attraction)),
        "energy": energy,
    }
    if plastic_work is None:
        return fields
    return fields | {"indentation": model.closed_part(gap), "plastic_work": plastic_work}


def _in_contact(contact: Contact, gap: Field, curvature: Field) -> tuple[Mask, Scalar]:
    """Return where surfaces are in contact, and the fraction of points, given f'' at the gap.

    They are where g = 0. Where the law repels at zero gap, as a core does, they also are below the
    gap at which f' is largest: up to there, where f'' > 0, the law holds the surfaces together as a
    spring does (J. A. Greenwood, 1997). In the limit of a short range it is the contact of a hard
    wall. The fraction is NaN of NaN, and if no gap is closed under a law that repels throughout.
    """
    profile = contact.profile
    points = (gap == 0) | ((gap < profile.contact_gap) & (curvature > 0))
    is_known = ~jnp.isnan(gap) & (jnp.any(points) | ~profile.repels_throughout)
    counted = jnp.where(is_known, points.astype(gap.dtype), jnp.nan)
    return points, mean(contact.solid.surface(counted))


def equilibrium_at(
    contact: Contact, load: Load, gap: Field, balance: Balance, **how: Any
) -> Equilibrium:
    """Return the state of a gap and its balance, given how it was found: residual, steps, ...

    On a surface that yields the gap is signed.
    """
    energy = balance.energy * contact.grid.cell_area
    plastic_work = balance.plastic_work
    if plastic_work is not None:
        plastic_work = plastic_work * contact.grid.cell_area
    in_contact, area_fraction = _in_contact(contact, contact.open_gap(gap), balance.curvature)
    return Equilibrium(
        load=load,
        in_contact=in_contact,
        contact_area=area_fraction,
        area=contact.area,
        units=contact.units,
        is_window=contact.solid.is_window,
        **fields_at(contact, gap, balance.net, energy, plastic_work),
        **how,
    )


@program
def state_at(contact: Contact, load: Load, gap: Field) -> Equilibrium:
    """Return the equilibrium of a gap that was found before."""
    balance = contact.balance(contact.control(load))(gap)
    is_finite = jnp.isfinite(balance.residual)
    return equilibrium_at(
        contact,
        load,
        gap,
        balance,
        residual=balance.residual,
        num_steps=jnp.array(0),
        result=RESULTS.where(is_finite, RESULTS.successful, RESULTS.nonfinite),
        history=History.empty(["residual"], gap.dtype),
    )


def detached_where(is_apart: Flag, state: Equilibrium) -> Equilibrium:
    """Return a state; where the surfaces are apart for good it has no fields, and no contact."""
    fields = {name: getattr(state, name) for name in ("residual", *DIFFERENTIABLE)}
    return replace(
        state,
        in_contact=state.in_contact & ~is_apart,
        contact_area=jnp.where(is_apart, 0, state.contact_area),
        result=RESULTS.where(is_apart, RESULTS.pulled_off, state.result),
        **{name: jnp.where(is_apart, jnp.nan, field) for name, field in fields.items()},
    )


class _HoldsEquilibrium(Protocol):
    @property
    def equilibrium(self) -> Equilibrium: ...


# Also an entry of a sweep, or a fold.
State = Equilibrium | _HoldsEquilibrium


def single_equilibrium(state: object) -> Equilibrium:
    """Return the one equilibrium that a state is or holds; anything else and stacks are errors."""
    equilibrium = getattr(state, "equilibrium", state)
    if not isinstance(equilibrium, Equilibrium):
        raise TypeError(
            f"{type(state).__name__} is not a state: give a result of "
            "jaxstab.equilibrate, or an entry of a sweep. A state of a path that has its gap "
            "becomes one by equilibrate(contact, path[i].load, initial=path[i]). A "
            "state of an evolution has its contact and equilibrium in evolution[i].instant."
        )
    require_single(equilibrium)
    return equilibrium


def single_start(state: Any) -> Any:
    """Return the one equilibrium, or recorded state of a path, that a state is or holds."""
    held = getattr(state, "equilibrium", state)
    if not hasattr(held, "gap") or isinstance(held, Equilibrium):
        return _with_finite_gap(single_equilibrium(state))
    require_single(held)
    if held.gap is None:
        raise ValueError(
            "The state of the path was recorded without its gap: start from path[-1], which has "
            "it, or follow the path with fields=True."
        )
    return _with_finite_gap(held)


def equilibrium_of(contact: Contact, state: State | None) -> Equilibrium:
    """Return the one equilibrium that a state is or holds, of the contact's grid and precision."""
    require_contact(contact)
    equilibrium = single_equilibrium(state)
    cure = "use the contact that it came from."
    require_shape("The gap of the equilibrium", equilibrium.gap.shape, contact.grid.shape, cure)
    if equilibrium.gap.dtype != contact.heights.dtype:
        raise ValueError(
            f"The equilibrium is in {equilibrium.gap.dtype}, the contact in "
            f"{contact.heights.dtype}: use the contact that it came from, or start from it: "
            "equilibrate(contact, load, initial=equilibrium)."
        )
    return equilibrium


def found_equilibrium(contact: Contact, state: State) -> Equilibrium:
    """Return the one equilibrium that a state is or holds; a known one without gaps is an error."""
    return _with_finite_gap(equilibrium_of(contact, state))


def defined_contact(contact: Contact, state: State) -> Equilibrium:
    """Return the same as `found_equilibrium`; known contact that is not defined is an error."""
    equilibrium = found_equilibrium(contact, state)
    _require_defined(equilibrium.contact_area)
    return equilibrium


@where_known
def _require_defined(contact_area: Scalar) -> None:
    cure = (
        "no gap is zero, and the law repels at every gap, so that none is the edge of a contact. "
        "Give a law that attracts, or that is zero from some gap on."
    )
    require_finite("The contact area", contact_area, cure)


def _with_finite_gap(state: Any) -> Any:
    result = getattr(state, "result", RESULTS.nonfinite)
    _require_finite_gap(state.gap, result)
    return state


@where_known
def _require_finite_gap(gap: Field, result: RESULTS) -> None:
    if not are_finite(gap).all():
        raise ValueError(
            f"The state was not found ({result.name}), and its gaps are not finite: give a state "
            "whose `result` is successful."
        )
