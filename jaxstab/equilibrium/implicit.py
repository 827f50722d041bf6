"""Derivatives of an equilibrium with respect to all that went into it."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxstab.contact import Contact
from jaxstab.derivatives import FieldMap, LinearSystem, Obstacle, unless
from jaxstab.elasticity import apply_multiplier, softest_wave
from jaxstab.grid import total
from jaxstab.hessian import Hessian
from jaxstab.loads import Load
from jaxstab.potentials import slope

Field = Float[Array, " *grid"]
Fields = dict[str, Array]

# The fields of an `Equilibrium` that can be differentiated.
DIFFERENTIABLE = ("displacement", "gap", "pressure", "reaction", "mean_pressure", "energy")

# What the residual may do to the smallest eigenvalue, over it.
_MAX_ERROR = 1e-2
_NOT_FOUND = "there is no converged equilibrium (look at its result)"
_VERGE = (
    "a point is on the verge of contact, which it enters or leaves, to within the residual of the "
    "equilibrium. Differentiate at a slightly different load, in float64 or with a finer tolerance"
)
_FOLD = (
    "the equilibrium is at a fold, or nearer to one than its residual can tell. Give the solver a "
    "finer tolerance, or stay away from it"
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


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def differentiable(
    throw: bool, fields: Fields, is_found: Bool[Array, ""], contact: Contact, load: Load
) -> Fields:
    """Return the fields of an equilibrium as differentiable functions of contact and load."""
    return fields


@differentiable.defjvp
def _differentiate(throw: bool, primals: tuple, tangents: tuple) -> tuple[Fields, Fields]:
    _, is_found, contact, load = primals
    fields = differentiable(throw, *primals)
    # Finite stand-ins, so that a failed lane does no harm and what is asked of it is seen.
    anything = jax.random.uniform(jax.random.key(0), contact.heights.shape, contact.heights.dtype)
    gap = jnp.where(is_found, fields["gap"], 1 + anything)
    load = jax.tree.map(lambda leaf: jnp.where(is_found, leaf, 1), load)
    is_free = gap > 0
    control = load.control(contact.heights)
    hessian = contact.hessian(gap)
    net = fields["pressure"] + slope(contact.potential, gap)
    missed = _imbalance(net, gap)
    sharpness = jnp.max(jnp.abs(jnp.where(is_free, third_derivative(contact, gap), 0)))

    not_found = Obstacle(~is_found, _NOT_FOUND)
    verge = verge_of_contact(net, gap, hessian)

    def judge(moved: Field, right_side: Field) -> list[Obstacle]:
        # After Newton and Kantorovich, with the eigenvalue that the solution shows.
        eigenvalue = total(moved * right_side) / total(moved**2)
        error = sharpness * jnp.sqrt(total(missed**2)) / eigenvalue**2
        return [Obstacle(~(error < _MAX_ERROR), _FOLD)]

    system = LinearSystem(
        hessian, _preconditioner(hessian), lambda field: control.project(field, is_free)
    )
    at_gap = partial(fields_of, gap=gap)
    _, (change, imbalance) = jax.jvp(at_gap, (contact, load), tangents[2:])
    moved = system.differentiable_solution(-imbalance, [not_found, verge], throw, judge)
    _, (response, _) = jax.jvp(partial(fields_of, contact, load), (gap,), (moved,))
    changes = {
        name: unless([not_found, verge], change[name] + response[name], throw) for name in fields
    }
    if control.fixes_mean:
        # No move of the free points that keeps the mean gap does work to first order, nor does it
        # matter which of them are free.
        changes["energy"] = unless([not_found], change["energy"], throw)
    return fields, changes


def third_derivative(contact: Contact, gap: Field) -> Field:
    """Return f'''(g) at every point [pressure/length^2]."""
    return jax.jvp(contact.curvature, (gap,), (jnp.ones_like(gap),))[1]


def verge_of_contact(net: Field, gap: Field, hessian: Hessian) -> Obstacle:
    """Return the obstacle of a point of hardly any reaction, or hardly any gap."""
    eps = jnp.finfo(gap.dtype).eps
    squares = 1e2 * _imbalance(net, gap) ** 2 + (1e3 * eps * net) ** 2
    noise = jnp.sqrt(total(squares) / gap.size)
    stiffness = jnp.max(hessian.multiplier)
    is_on_verge = jnp.any(jnp.where(gap > 0, gap * stiffness, net) <= noise)
    return Obstacle(is_on_verge, _VERGE)


def _imbalance(net: Field, gap: Field) -> Field:
    return jnp.where(gap > 0, net, jnp.minimum(net, 0))


def _preconditioner(hessian: Hessian) -> FieldMap:
    multiplier = hessian.multiplier
    softest = softest_wave(multiplier)
    shift = softest + total(jnp.maximum(hessian.curvature, 0)) / hessian.curvature.size
    return partial(apply_multiplier, 1 / (multiplier + shift))
