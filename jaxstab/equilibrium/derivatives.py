"""Derivatives of an equilibrium with respect to all that went into it."""

from functools import partial

import jax
import jax.numpy as jnp

from jaxstab.contact.contact import Contact
from jaxstab.core import model
from jaxstab.core.accuracy import rounding_of_fields
from jaxstab.core.grid import total
from jaxstab.core.implicit import finite, tangent_of
from jaxstab.core.linear_system import LinearSystem
from jaxstab.core.types import Field, Flag, Mask, Scalar
from jaxstab.equilibrium.equilibrium import Fields, fields_of
from jaxstab.loads.load import Control, Load
from jaxstab.potentials.evaluation import slope
from jaxstab.solids.solid import Solid

# The largest change of the smallest eigenvalue by the residual, over it.
_MAX_ERROR = 1e-2


def changes_of_fields(
    fields: Fields,
    is_found: Flag,
    inputs: tuple[Contact, Load],
    changes: tuple[Contact, Load],
) -> tuple[Fields, dict[str, Flag]]:
    """Return how the fields of an equilibrium change with contact and load, a rule for `attach`."""
    inputs = contact, load = finite(is_found, inputs)
    fields = finite(is_found, fields)
    gap = fields["gap"]
    net = fields["pressure"] + slope(contact.potential, gap)
    if "indentation" in fields:
        gap = gap - fields["indentation"]
    control = contact.control(load)
    is_free = model.free_points(gap, control.largest_reaction)
    residual = control.imbalance(net, gap)
    sharpness = jnp.max(jnp.abs(jnp.where(is_free, third_derivative(contact, gap), 0)))

    def is_sound(moved: Field, right_side: Field) -> Flag:
        # After Newton and Kantorovich, with the eigenvalue that the solution shows.
        eigenvalue = total(moved * right_side) / total(moved**2)
        error = sharpness * jnp.sqrt(total(residual**2)) / eigenvalue**2
        return error < _MAX_ERROR

    is_undefined = ~is_found | jnp.any(
        changing_points(net, gap, contact.solid, control.largest_reaction)
    )
    system = free_system(contact, control, gap)
    change, imbalance = tangent_of(partial(fields_of, gap=gap), inputs, changes)
    right_side = jnp.where(is_undefined, 0, -imbalance)
    moved = system.differentiable_solution(right_side, is_sound)
    _, (response, _) = jax.jvp(partial(fields_of, contact, load), (gap,), (moved,))
    sums = {name: change[name] + response[name] for name in fields}
    undefined = dict.fromkeys(fields, is_undefined)
    if control.fixes_mean and contact.hardness is None:
        # No move of the free points that keeps the mean gap does work to first order, nor does it
        # matter which of them are free.
        sums["energy"] = change["energy"]
        undefined["energy"] = ~is_found
    return sums, undefined


def free_system(contact: Contact, control: Control, gap: Field) -> LinearSystem:
    """Return the system of A on the free points, for an A that is positive there."""
    is_free = model.free_points(gap, control.largest_reaction)
    hessian = contact.hessian(gap, control).restriction(is_free)
    adhesion = total(jnp.maximum(hessian.curvature, 0)) / gap.size
    inverse = hessian.inverse(contact.solid.min_stiffness + adhesion)
    return LinearSystem(hessian, inverse, lambda field: control.project(field, is_free))


def third_derivative(contact: Contact, gap: Field) -> Field:
    """Return f'''(g) at every point [pressure/length^2]."""
    return jax.jvp(contact.curvature, (gap,), (jnp.ones_like(gap),))[1]


def changing_points(net: Field, gap: Field, solid: Solid, largest: Field | None = None) -> Mask:
    """Return where there is hardly any reaction, or hardly any gap; or where they hardly yield."""
    noise = pressure_noise(net, gap, largest)
    if largest is None:
        return jnp.where(gap > 0, gap * solid.max_stiffness, net) <= noise
    margin = jnp.minimum(net, largest - net)
    return jnp.where(gap == 0, margin, jnp.abs(gap) * solid.max_stiffness) <= noise


def pressure_noise(net: Field, gap: Field, largest: Field | None = None) -> Scalar:
    """Return the least pressure above the residual and rounding."""
    rounding = rounding_of_fields(gap.dtype)
    squares = 1e2 * model.imbalance(net, gap, largest) ** 2 + (rounding * net) ** 2
    return jnp.sqrt(total(squares) / gap.size)
