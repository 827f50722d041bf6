"""The dimensions of fields, each stated once, at its declaration.

    mean_pressure: Annotated[Scalar, PRESSURE]

Counts, flags, members of enumerations and other results need no dimension. A field lives on the
grid if its type names the last axes so, as `Field` does.
"""

from collections.abc import Callable, Container
from dataclasses import fields
from functools import cache
from typing import Protocol, Self, get_args

import equinox as eqx
from jaxtyping import Array

from jaxstab.core.compile import own_conventions
from jaxstab.core.types import Scalar
from jaxstab.core.unit_system import power_of_pressure


class Dimension(str):
    """The name of a dimension, as in Annotated[Array, Dimension("pressure^3 length^2")].

    Words are length, pressure, energy, force, area, time and number "1", with powers, in products
    divided by a product. Units in tables, figures and files follow from it.
    """


NUMBER, LENGTH, AREA = Dimension("1"), Dimension("length"), Dimension("length^2")
VOLUME, TIME = Dimension("length^3"), Dimension("time")
PRESSURE, ENERGY, STIFFNESS = map(Dimension, ("pressure", "energy", "pressure/length"))
FORCE, VISCOSITY = Dimension("force"), Dimension("pressure time")
# The stiffness of a machine: force over displacement.
SPRING_CONSTANT = Dimension("force/length")
SURFACE_ENERGY = Dimension("energy/area")


class _HasSurface(Protocol):
    def surface(self, field: Array) -> Array: ...


class Dimensioned(eqx.Module):
    """A module whose fields declare their dimensions."""

    @own_conventions()
    def in_units_of(self, pressure: Scalar) -> Self:
        """Convert pressures to another unit, given in the old one; lengths keep theirs."""
        kinds = dimensions(type(self))
        return self._changed(
            kinds,
            lambda name, x: in_units_of(x, kinds[name], pressure),
            lambda x: x.in_units_of(pressure),
        )

    def on_surface(self, solid: _HasSurface) -> Self:
        """Restrict the fields to the part of a padded grid where the surface is."""
        names = on_grid(type(self))
        return self._changed(names, lambda _, x: solid.surface(x), lambda x: x.on_surface(solid))

    def _changed(
        self,
        names: Container[str],
        change: Callable[..., Array],
        inside: "Callable[..., Dimensioned]",
    ) -> Self:
        changed = object.__new__(type(self))
        for name in [field.name for field in fields(self)]:
            value = getattr(self, name)
            if isinstance(value, Dimensioned):
                value = inside(value)
            elif name in names and value is not None:
                value = change(name, value)
            object.__setattr__(changed, name, value)
        return changed


def in_units_of(value: Array, dimension: Dimension, pressure: Scalar) -> Array:
    """Return a value of a dimension with pressures in another unit, given in the old one."""
    power = power_of_pressure(dimension)
    if power == 0:
        return value
    return value / (pressure if power == 1 else pressure**power)


@cache
def dimensions(module: type[Dimensioned]) -> dict[str, Dimension]:
    """Return the dimension of each field that declares one."""
    return {name: parts[0] for name, parts in declared(module).items()}


@cache
def declared(module: type) -> dict[str, tuple[Dimension, ...]]:
    """Return the declared dimensions of each field, several for a tuple."""
    found = {}
    for field in fields(module):
        if parts := [part for part in _parts(field.type) if isinstance(part, Dimension)]:
            found[field.name] = tuple(parts)
    return found


@cache
def axes_of(module: type) -> dict[str, tuple[str, ...]]:
    """Return the names of the axes of each field that is an array, as its type declares them."""
    parts = ((field.name, part) for field in fields(module) for part in _parts(field.type))
    return {
        name: tuple(axes.replace("*", "").split())
        for name, part in parts
        if (axes := getattr(part, "dim_str", None)) is not None
    }


@cache
def on_grid(module: type) -> set[str]:
    """Return the names of the fields whose last axes are the axes of the grid."""
    return {name for name, axes in axes_of(module).items() if "".join(axes).endswith("grid")}


def _parts(kind: object) -> list[object]:
    return [part for one in get_args(kind) for part in _parts(one)] or [kind]
