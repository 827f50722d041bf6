"""Derivatives of an equilibrium with respect to all that went into it."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxstab.contact import Contact
from jaxstab.derivatives import FieldMap, LinearSystem, finite, pushed
from jaxstab.elasticity import apply_multiplier, softest_wave
from jaxstab.grid import total
from jaxstab.hessian import Hessian
from jaxstab.loads import Load
from jaxstab.potentials import slope
from jaxstab.refusals import Obstacle, any_exists

Field = Float[Array, " *grid"]
Fields = dict[str, Array]

# The fields of an `Equilibrium` that can be differentiated.
DIFFERENTIABLE = ("displacement", "gap", "pressure", "reaction", "mean_pressure", "energy")

# What the residual may do to the smallest eigenvalue, over it.
_MAX_ERROR = 1e-2
NOT_FOUND = "there is no converged equilibrium (look at its result)"
_VERGE = (
    "a point is on the verge of contact, which it enters or leaves, to within the residual of the "
    "equilibrium. Differentiate at a slightly different load, in float64 or with a finer tolerance"
)


def fields_of(contact: Contact, load: Load, gap: Field) -> tuple[Fields, Field]:
    """Return the differentiable fields of an equilibrium and its net pressure.

    Its gap, brought under the load if the load is another one, moves with it.
    """
    control = load.control(contact.heights)
    gap = control.restore(gap)
    attraction = slope(contact.potential, gap)
    net = control.net_pressure(contact.gradient(gap), gap > 0)
    reaction = jnp.where(gap == 0, net, 0)
    fields = {
        "displacement": contact.displacement(gap),
        "gap": gap,
        "pressure": net - attraction,
        "reaction": reaction,
        "mean_pressure": jnp.mean(reaction - attraction),
        "energy": contact.energy(gap),
    }
    return fields, net


def changes_of_fields(
    fields: Fields,
    is_found: Bool[Array, ""],
    inputs: tuple[Contact, Load],
    changes: tuple[Contact, Load],
) -> tuple[Fields, dict[str, list[Obstacle]]]:
    """Return how the fields of an equilibrium change with contact and load, a rule for `attach`."""
    inputs = contact, load = finite(is_found, inputs)
    fields = finite(is_found, fields)
    gap = fields["gap"]
    is_free = gap > 0
    control = load.control(contact.heights)
    hessian = contact.hessian(gap)
    net = fields["pressure"] + slope(contact.potential, gap)
    missed = _imbalance(net, gap)
    sharpness = jnp.max(jnp.abs(jnp.where(is_free, third_derivative(contact, gap), 0)))

    def is_sound(moved: Field, right_side: Field) -> Bool[Array, ""]:
        # After Newton and Kantorovich, with the eigenvalue that the solution shows.
        eigenvalue = total(moved * right_side) / total(moved**2)
        error = sharpness * jnp.sqrt(total(missed**2)) / eigenvalue**2
        return error < _MAX_ERROR

    obstacles = [Obstacle(~is_found, NOT_FOUND), verge_of_contact(net, gap, hessian)]
    system = LinearSystem(
        hessian, _preconditioner(hessian), lambda field: control.project(field, is_free)
    )
    change, imbalance = pushed(partial(fields_of, gap=gap), inputs, changes)
    right_side = jnp.where(any_exists(obstacles), 0, -imbalance)
    moved = system.differentiable_solution(right_side, is_sound)
    _, (response, _) = jax.jvp(partial(fields_of, contact, load), (gap,), (moved,))
    sums = {name: change[name] + response[name] for name in fields}
    reasons = dict.fromkeys(fields, obstacles)
    if control.fixes_mean:
        # No move of the free points that keeps the mean gap does work to first order, nor does it
        # matter which of them are free.
        sums["energy"], reasons["energy"] = change["energy"], obstacles[:1]
    return sums, reasons


def third_derivative(contact: Contact, gap: Field) -> Field:
    """Return f'''(g) at every point [pressure/length^2]."""
    return jax.jvp(contact.curvature, (gap,), (jnp.ones_like(gap),))[1]


def verge_of_contact(net: Field, gap: Field, hessian: Hessian) -> Obstacle:
    """Return the obstacle of a point of hardly any reaction, or hardly any gap."""
    noise = pressure_noise(net, gap)
    stiffness = jnp.max(hessian.multiplier)
    is_on_verge = jnp.any(jnp.where(gap > 0, gap * stiffness, net) <= noise)
    return Obstacle(is_on_verge, _VERGE)


def pressure_noise(net: Field, gap: Field) -> Float[Array, ""]:
    """Return the least pressure that can be told from the residual, and from rounding."""
    eps = jnp.finfo(gap.dtype).eps
    squares = 1e2 * _imbalance(net, gap) ** 2 + (1e3 * eps * net) ** 2
    return jnp.sqrt(total(squares) / gap.size)


def _imbalance(net: Field, gap: Field) -> Field:
    return jnp.where(gap > 0, net, jnp.minimum(net, 0))


def _preconditioner(hessian: Hessian) -> FieldMap:
    multiplier = hessian.multiplier
    softest = softest_wave(multiplier)
    shift = softest + total(jnp.maximum(hessian.curvature, 0)) / hessian.curvature.size
    return partial(apply_multiplier, 1 / (multiplier + shift))
