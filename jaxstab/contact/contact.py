"""The contact problem: its energy, its derivatives and its optimality conditions.

The state is the gap g = u - h >= 0, which is exactly zero where the surfaces touch. Without the
cell's area, as in Rey & Bleyer's eq. 15, the energy is u.Ku / 2 + sum f(g); its gradient is
K u + f'(g) and its Hessian A = K + D with D = diag f''(g).
"""

from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.contact.hessian import Hessian
from jaxstab.contact.inputs import (
    as_heights,
    hardness_on,
    law_on,
    relative_heights,
    require_sound,
    unit_of_lengths,
)
from jaxstab.contact.residual import (
    Balance,
    Pressures,
    balance_of,
    conforming_pressure,
    pressures_of,
)
from jaxstab.contact.window import continued_hardness, continued_surface
from jaxstab.core import model
from jaxstab.core.checks import cast, is_traced, possible, require_kind, require_shape
from jaxstab.core.compile import program
from jaxstab.core.display import block
from jaxstab.core.equality import are_same
from jaxstab.core.grid import Grid
from jaxstab.core.types import ArrayLike, Field, FieldMap, Flag, Scalar
from jaxstab.core.units import LENGTH, PRESSURE, Units
from jaxstab.loads.load import Control, Load
from jaxstab.potentials.evaluation import curvature, slope
from jaxstab.potentials.jumps import law_jump, require_no_jump
from jaxstab.potentials.profile import Profile, profile_of, require_smooth
from jaxstab.potentials.sharpness import sharpest_curvature
from jaxstab.potentials.varying import Potential, Scaled, everywhere
from jaxstab.solids.solid import Solid

if TYPE_CHECKING:
    from jaxstab.surfaces import Topography


class HasIndentation(Protocol):
    """A state that may have flattened the surface of its contact, or a result that holds one."""

    @property
    def indentation(self) -> Field | None:
        """The depth by which it has [length]; None if nothing yields."""


class Contact(eqx.Module):
    """A rigid rough surface against an elastic solid, with adhesion between them.

    Its fields, and everything computed from them, have the precision of `heights`.

    Nothing depends on a constant in the heights. A constant that would cost digits is subtracted in
    the given precision, before the heights are cast: `contact.heights` are then relative to
    `contact.datum`, which otherwise is zero. Displacements, and loads that prescribe them, are
    relative to zero.

    Arguments:
        solid: the elastic solid.
        heights: h at the points of the solid's grid [length]; summits touch first. An array, or a
            `jaxstab.surfaces.Topography` on that grid, whose unit the contact then has; also an
            array of xarray with dimensions x and y, in either order, and a surface of
            SurfaceTopography.
        potential: adhesive energy per area as a scalar function of the gap: a law of
            `jaxstab.potentials`, any `equinox.Module`, or a bare function. It is twice
            differentiable for every gap >= 0, or for every gap > 0 if it rises without bound
            towards zero.
        hardness: H, the largest pressure that the softer side bears [pressure]: where it is
            reached, this side is flattened for good. A number, or an array over the points; None,
            or infinity, for surfaces that do not yield.
        unit: unit of lengths, for heights without one: "m", "µm" or "um", "nm", ...
        pressure_unit: unit of pressures: "Pa", "kPa", "MPa", "GPa"; by default pascals where
            lengths are in metres. Tables, figures and data sets show both units, and the units of
            forces and energies, which follow from them.
        force_unit, energy_unit: units in which tables and figures show forces and energies, as
            "nN" and "fJ"; by default the prefix suits the numbers. Results and data sets keep the
            units that follow from those of length and pressure.

    Warns:
        SurfaceWarning: for heights that look wrong: tilted, with opposite edges that do not meet,
            in another unit than the lengths, or with a number for missing points. On a window
            neither tilt nor edges matter.

    Raises:
        ValueError: for heights that are not finite or have another shape than the grid. For a
            topography with missing points, on another grid or in another unit. For dimensions of
            other names than x and y. For a unit that is not one of length, pressure, force or
            energy; for a unit of force or energy where that of length or pressure is unknown.
            For a potential that is not a scalar of a scalar. For one whose value or slope jumps,
            by a thousandth of its depth or largest attraction; inside of `jax.jit` all results are
            then `invalid_contact`. For a potential that, or whose first two derivatives, are not
            finite at some gap; at zero gap it may rise without bound. For a hardness that is not
            positive, or below the repulsion of the law at zero gap, which then allows no contact;
            and for one of a `Viscoelastic` solid.
        TypeError: for a solid that is not one, and for a potential that JAX cannot trace. For
            heights that are complex, or floats other than float32 and float64.

    Example:
        >>> contact = js.Contact(solid, heights, lambda gap: -0.03 * jnp.exp(-gap / 0.06))
        >>> f"{contact.resolution:.2f}"
        '4.27'
    """

    solid: Solid
    heights: Annotated[Field, LENGTH]
    datum: Annotated[Scalar, LENGTH]
    potential: Potential
    unit: str | None = eqx.field(static=True)
    pressure_unit: str | None = eqx.field(static=True, default=None)
    force_unit: str | None = eqx.field(static=True, default=None)
    energy_unit: str | None = eqx.field(static=True, default=None)
    hardness: Annotated[Float[Array, "..."], PRESSURE] | None = None

    __repr__ = block

    def __init__(
        self,
        solid: Solid,
        heights: "ArrayLike | Topography",
        potential: Potential,
        *,
        hardness: ArrayLike | None = None,
        unit: str | None = None,
        pressure_unit: str | None = None,
        force_unit: str | None = None,
        energy_unit: str | None = None,
    ):
        if not isinstance(solid, Solid):
            raise TypeError(
                f"The solid is a {type(solid).__name__}: give a solid such as HalfSpace(grid, ...) "
                "first, then the heights, then the potential."
            )
        given, topography = as_heights(heights, solid.grid)
        relative, datum = relative_heights(given)
        self.heights = solid.grid.device_put(relative)
        dtype = self.heights.dtype
        self.datum = cast(datum, dtype)
        if dtype not in (jnp.float32, jnp.float64):
            raise TypeError(f"heights are {dtype}: give them in float32 or float64.")
        require_sound(solid, given, topography)
        self.solid = cast(solid, dtype)
        units = Units.of_names(
            unit_of_lengths(topography, unit), pressure_unit, force_unit, energy_unit
        )
        self.unit = units.length
        self.pressure_unit = units.pressure
        self.force_unit = units.force
        self.energy_unit = units.energy
        self.potential = law_on(solid.grid, potential, dtype)
        require_smooth(self.profile)
        jump = law_jump(everywhere(self.potential), self.grid.lengths)
        require_no_jump(jump)
        # In a trace no error can be raised: results say so.
        self.heights = possible(self.heights, jump.is_absent)
        self.hardness = hardness_on(solid, self.heights, self.potential, hardness)

    @property
    def has_core(self) -> Flag | bool:
        """Whether the potential rises without bound as a gap closes, so that none ever does."""
        law = self.potential
        if isinstance(law, Scaled) and law.has_core is not None:
            return law.has_core
        return self.profile.has_core

    @property
    def known_core(self) -> bool | None:
        """The same as a number of Python, on which programs can depend; None if not known yet."""
        if is_traced(self.has_core):
            return None
        return bool(self.has_core)

    @property
    def padded(self) -> "Contact":
        """The same contact on the grid that it is solved on: on a window a larger one."""
        solid = self.solid.padded
        if solid is self.solid:
            return self
        continued = solid, *continued_surface(solid, self.heights, self.potential)
        whole = eqx.tree_at(lambda c: (c.solid, c.heights, c.potential), self, continued)
        return whole.with_hardness(continued_hardness(self.hardness, self.heights))

    @property
    def profile(self) -> Profile:
        """The potential at gaps from far beyond the size of the grid down to zero."""
        return profile_of(everywhere(self.potential), self.grid.lengths)

    @property
    def sharpest_curvature(self) -> Scalar:
        """The largest |f''| where the potential attracts [pressure/length]."""
        return sharpest_curvature(everywhere(self.potential), self.grid.lengths)

    @property
    def units(self) -> Units:
        """The units of length and of pressure, for a surface of so many sides."""
        sides = self.grid.num_dimensions
        return Units(self.unit, self.pressure_unit, sides, self.force_unit, self.energy_unit)

    @property
    def grid(self) -> Grid:
        """The grid of the surface."""
        return self.solid.grid

    @property
    def area(self) -> Scalar:
        """The area of the surface [length^2]; on a line its length [length]."""
        return self.solid.area.astype(self.heights.dtype)

    @property
    def resolution(self) -> Scalar:
        """Stiffness of the grid's shortest wave over the largest |f''| where the law attracts.

        Below 1 the grid pins contact edges, and jumps between its points are artefacts. The tension
        of a pull-off is too large by about 0.2 over its square: measured on Johnson's sinusoid,

            resolution   16      8      4      2     1     0.5
            error        0.07 %  0.3 %  1.3 %  6 %   30 %  100 %

        On rings the shortest wave lies at the rim, where rings are narrowest: at the edge of a
        contact of radius a the resolution is smaller by a over the radius of the disc.
        """
        return self.solid.max_stiffness / self.sharpest_curvature

    @property
    def is_valid(self) -> Flag:
        """Whether heights are finite, and solid and hardness possible ones, also where traced."""
        is_valid = jnp.all(jnp.isfinite(self.heights)) & self.solid.is_valid
        if self.hardness is None:
            return is_valid
        return is_valid & jnp.all(self.hardness > 0)

    @property
    def characteristic_pressure(self) -> Scalar:
        """The unit of pressure that suits the problem, a power of two: squares keep the range.

        It is about the pressure that moves the stiffest wave by the height of the surface.
        """
        height = jnp.max(jnp.abs(self.heights - self.heights.ravel()[0]))
        height = jnp.where(height > 0, height, jnp.max(self.grid.spacing).astype(height.dtype))
        stiffness = self.solid.max_stiffness.astype(height.dtype)
        return _power_of_two_above(jax.lax.stop_gradient(height * stiffness))

    def in_units_of(self, pressure: Scalar, has_core: bool | None = None) -> "Contact":
        """Return the same contact with pressures in another unit; lengths stay.

        The known data of its core come with it, without compiling.
        """
        solid = self.solid.scaled(1 / pressure)
        law = Scaled(self.potential, 1 / pressure, has_core)
        own = eqx.tree_at(lambda contact: (contact.solid, contact.potential), self, (solid, law))
        if self.hardness is None:
            return own
        return own.with_hardness(self.hardness / pressure)

    def after(self, state: "HasIndentation") -> "Contact":
        """Return the contact over the surface that a state leaves: lower by its indentation.

        Arguments:
            state: an equilibrium of this contact, or a state of a path that has its fields.
        """
        held: Any = getattr(state, "equilibrium", state)
        indentation = held.indentation
        if indentation is None:
            if self.hardness is None:
                return self
            raise ValueError(
                "The state has no indentation: give an equilibrium, the last state of a path, or "
                "one of a path with fields=True."
            )
        return self.with_indentation(indentation)

    def with_indentation(self, depth: Field) -> "Contact":
        """Return the contact over a surface that lies lower by a depth [length]."""
        require_shape("The indentation", depth.shape, self.grid.shape, "give one of its states.")
        return eqx.tree_at(lambda c: c.heights, self, _lowered_heights(self.heights, depth))

    @property
    def elastic(self) -> "Contact":
        """The same contact, which does not yield."""
        return self.with_hardness(None)

    def with_hardness(self, hardness: Array | None) -> "Contact":
        """Return the same contact with another hardness, not checked, or None."""
        return eqx.tree_at(
            lambda contact: contact.hardness, self, hardness, is_leaf=lambda leaf: leaf is None
        )

    @property
    def largest_reaction(self) -> Field | None:
        """H + f'(0), the reaction at which a point yields; None on a surface that does not."""
        if self.hardness is None:
            return None
        return self.hardness + slope(self.potential, jnp.zeros_like(self.heights))

    def gap(self, displacement: Field) -> Field:
        """Return g = u - h (Rey & Bleyer, eq. 2) [length]."""
        return model.gap_of(displacement - self.datum, self.heights)

    def displacement(self, gap: Field) -> Field:
        """Return u = g + h [length]."""
        return model.displacement_of(gap, self.heights) + self.datum

    def energy(self, gap: Field) -> Scalar:
        """Return the potential energy of the surface (Rey & Bleyer, eq. 5) [energy].

        Of a gap that is signed, on a surface that yields, it leaves out the plastic work.
        """
        return self.pressures(gap).energy * self.grid.cell_area

    @property
    def gradient(self) -> FieldMap:
        """The map from a gap to K u + f'(g) [pressure], K prepared once, here."""
        pressures = self.pressures
        return lambda gap: pressures(gap).gradient

    @property
    def pressures(self) -> Callable[[Field], Pressures]:
        """The map from a gap to K u, f'(g) and f''(g), K prepared once, here."""
        return pressures_of(self.solid, self.heights, self.potential, self.hardness)

    def open_gap(self, gap: Field) -> Field:
        """Return g where the gap is signed, as on a surface that yields [length]."""
        if self.hardness is None:
            return gap
        return model.open_part(gap)

    def shut(self, gap: Field) -> Field | int:
        """Return the gap of points in contact: zero, or less where a signed gap is [length]."""
        if self.hardness is None:
            return 0
        return jnp.minimum(gap, 0)

    def curvature(self, gap: Field) -> Field:
        """Return f''(g), the diagonal of D (Rey & Bleyer, eq. 24) [pressure/length].

        It is zero where a signed gap is negative, since the surface yields there.
        """
        curvatures = curvature(self.potential, self.open_gap(gap))
        if self.hardness is None:
            return curvatures
        return jnp.where(gap < 0, 0, curvatures)

    def control(self, load: Load) -> Control:
        """Return the condition that load and surface set on the gap."""
        control = load.relative_to(self.datum).control(self.solid, self.heights)
        if self.hardness is None:
            return control
        return eqx.tree_at(
            lambda c: (c.largest_reaction, c.largest_pressure),
            control,
            (self.largest_reaction, jnp.mean(self.hardness)),
            is_leaf=lambda leaf: leaf is None,
        )

    def hessian(self, gap: Field, control: Control | None = None) -> Hessian:
        """Return the operator A = K + D (Rey & Bleyer, eq. 24) [pressure/length].

        Under a control, K includes the stiffness of the load; by default that is zero.
        """
        stiffness = None
        if control is not None:
            stiffness = control.stiffness
        return Hessian(self.solid, self.curvature(gap), stiffness)

    @property
    def conforming_pressure(self) -> Scalar:
        """Rms elastic pressure that full contact takes, |K h| [pressure]: the problem's scale."""
        return conforming_pressure(self.solid, self.heights)

    def balance(self, control: Control) -> Callable[[Field], Balance]:
        """Return the map from a gap, nowhere negative or signed, to how far it is from balance."""
        escape = control.escape_gap(self.profile)
        return balance_of(self.solid, self.heights, self.potential, self.hardness, control, escape)


@program
def _lowered_heights(heights: Field, indentation: Field) -> Field:
    return heights - indentation


def require_contact(contact: Contact) -> None:
    """Raise `TypeError` for anything but a contact, `ValueError` for one that cannot be solved.

    These are a batch of contacts, and one in double precision while JAX is set to single.
    """
    cure = "give that first, as made by jaxstab.Contact(solid, heights, potential)."
    require_kind(contact, Contact, f"no contact: {cure}")
    dtype = contact.heights.dtype
    if jax.dtypes.canonicalize_dtype(dtype) != dtype:
        raise ValueError(
            "The contact is in double precision, which JAX now rounds to single: call "
            'jax.config.update("jax_enable_x64", True), or make the contact anew.'
        )
    heights = contact.heights.shape
    grid = contact.grid.shape
    if heights != grid:
        batch = heights[: len(heights) - len(grid)]
        raise ValueError(
            f"These are several contacts, a batch of shape {batch}: call this function inside of "
            "jax.vmap, or choose one by jax.tree.map(lambda leaf: leaf[0], contact)."
        )


def require_elastic(contact: Contact, owner: str) -> None:
    """Raise `ValueError` for a contact with a hardness, in a function that takes none."""
    if contact.hardness is not None:
        raise ValueError(
            f"The contact has a hardness, and {owner} takes no surface that yields: give "
            "contact.after(state).elastic, the surface that a state leaves, as it is then, or "
            "contact.elastic, the surface before. jaxstab.follow goes on with the indentation."
        )


def require_same_contact(contact: Contact, other: Contact, owner: str) -> None:
    """Raise `ValueError` that names the fields in which the contact of a result is another one."""
    pairs = {
        field.name: [getattr(c, field.name) for c in (contact, other)] for field in fields(Contact)
    }
    differing = [name for name, pair in pairs.items() if not are_same(*pair)]
    if differing:
        raise ValueError(
            f"{owner} has another {' and another '.join(differing)} than the contact: give the "
            "contact that it came from."
        )


def _power_of_two_above(value: Scalar) -> Scalar:
    """Return the least power of two above a number, made of the bits of its exponent.

    It is one where the number is not positive and normal, or that power not finite.
    """
    limits = jnp.finfo(value.dtype)
    kind = jnp.dtype(f"uint{limits.bits}")
    exponent = ((1 << limits.nexp) - 1) << limits.nmant
    bits = jax.lax.bitcast_convert_type(value, kind) & np.asarray(exponent, kind)
    is_normal = (value >= limits.tiny) & (value <= limits.max / 2)
    return jnp.where(is_normal, 2 * jax.lax.bitcast_convert_type(bits, value.dtype), 1)
