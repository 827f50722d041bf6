"""A step in time of a viscoelastic contact: an elastic equilibrium on a surface moved by memory.

The solid is springs r_k K in parallel, r_0 = 1 the relaxed one, and each other in series with a
dashpot. The strain of spring k is a displacement v_k, v_k' = w' - v_k / t_k with t_0 infinite, so
that v_0 = w is the displacement relative to the far side, and p = K sum r_k v_k. For w linear in
time within a step dt, with e_k = exp(-dt / t_k) and b_k = (t_k / dt) (1 - e_k),

    v_k(new) = e_k v_k + b_k (w(new) - w),

so that p(new) = K_step (w(new) + m) with K_step = K sum r_k b_k and the memory
m = sum r_k e_k v_k / sum r_k b_k - w. A step is the elastic equilibrium of K_step on the surface
h + m, exact for any dt if w is linear in it, of second order otherwise.
"""

from typing import Annotated, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxstab.contact import Contact
from jaxstab.core.grid import mean, total
from jaxstab.core.types import Field, Scalar
from jaxstab.core.units import LENGTH
from jaxstab.equilibrium import Equilibrium, PreconditionedConjugateGradient
from jaxstab.equilibrium.equilibrate import find_equilibrium, with_derivatives
from jaxstab.loads import Load, MeanDisplacement
from jaxstab.solids.solid import finite_or_zero
from jaxstab.solids.viscoelastic import decay, ramp

_NODES, _WEIGHTS = (values / 2 for values in np.polynomial.legendre.leggauss(8))
_Springs = Float[Array, " springs"]


class Internal(eqx.Module):
    """The memory of a viscoelastic contact, on the grid that it is solved on.

    Attributes:
        gap: g [length].
        strains: v_k of each spring, first w, the displacement relative to the far side [length].
    """

    gap: Annotated[Field, LENGTH]
    strains: Annotated[Float[Array, " springs_and_grid"], LENGTH]


def springs(contact: Contact) -> tuple[_Springs, _Springs]:
    """Return r_k and t_k of all springs, first of the relaxed one."""
    solid: Any = contact.solid
    return (
        jnp.pad(solid.ratios, (1, 0), constant_values=1),
        jnp.pad(solid.times, (1, 0), constant_values=jnp.inf),
    )


def moved_contact(contact: Contact, memory: Internal, dt: Scalar) -> Contact:
    """Return the elastic contact of a step from a state: K_step on h + m."""
    solid: Any = contact.solid
    ratios, times = springs(contact)
    kept = jnp.tensordot(ratios * decay(dt, times), memory.strains, 1) / solid.stiffening(dt)
    return eqx.tree_at(
        lambda contact: (contact.solid, contact.heights),
        contact,
        (solid.step(dt), contact.heights + kept - memory.strains[0]),
    )


def load_on(moved: Contact, contact: Contact, load: Load) -> Load:
    """Return a load as it holds the moved surface: a mean displacement moves along."""
    if not isinstance(load, MeanDisplacement):
        return load
    return load.at(load.value + mean(moved.heights - contact.heights))


def next_state(
    contact: Contact, load: Load, memory: Internal, dt: Scalar
) -> tuple[Internal, Equilibrium]:
    """Return the state after a step, and its elastic equilibrium, differentiable functions."""
    moved = moved_contact(contact, memory, dt)
    held = load_on(moved, contact, load)
    solver, start = PreconditionedConjugateGradient(), memory.gap
    if start is not None and moved.control(held).fixes_mean:
        # Full contact opens everywhere at once.
        start = jnp.where(jnp.max(start) > 0, start, 1)
    found = find_equilibrium(*jax.lax.stop_gradient((moved, held, solver, start)))
    found = with_derivatives(moved, held, found)
    # Relative to the far side the mean is mean(p) / K_step(q = 0) - mean(m), or has no memory.
    stiffness = finite_or_zero(moved.solid.uniform_stiffness)
    is_held = stiffness > 0
    level = mean(found.pressure) / jnp.where(is_held, stiffness, 1)
    level = jnp.where(is_held, level - mean(moved.heights - contact.heights), 0)
    displacement = found.gap + contact.heights
    deformation = displacement - mean(displacement) + level
    _, times = springs(contact)
    e, b = (f(dt, times).reshape(-1, *(1,) * deformation.ndim) for f in (decay, ramp))
    strains = e * memory.strains + b * (deformation - memory.strains[0])
    return Internal(found.gap, strains.at[0].set(deformation)), found


def spring_forms(contact: Contact, memory: Internal) -> _Springs:
    """Return v_k.K v_k of each spring [energy]."""
    return jnp.stack([_form(contact, v, _pressure(contact, v)) for v in memory.strains])


def spring_forms_after(
    contact: Contact, forms: _Springs, old: Internal, new: Internal, dt: Scalar
) -> tuple[_Springs, Scalar]:
    """Return v_k.K v_k after a step, and the energy that its dashpots dissipate [energy].

    The rate is sum r_k v_k.K v_k / t_k. With x = dt / t_k and s = dt * theta, a spring is at
    v_k exp(-x theta) + dw theta ramp(x theta): the integral of its square is in closed form.
    """
    ratios, times = springs(contact)
    change = new.strains[0] - old.strains[0]
    pressure = _pressure(contact, change)
    square = _form(contact, change, pressure)
    cross = jnp.stack([_form(contact, v, pressure) for v in old.strains])
    x, e, b = dt / times, decay(dt, times), ramp(dt, times)
    left, both, gained = _integrals(x)
    dissipated = x * (left * forms + 2 * both * cross + gained * square)
    return e**2 * forms + 2 * e * b * cross + b**2 * square, jnp.sum(ratios * dissipated)


def _pressure(contact: Contact, field: Field) -> Field:
    """Return K of a displacement relative to the far side [pressure]."""
    solid = contact.solid
    uniform = finite_or_zero(solid.uniform_stiffness)
    return solid.with_uniform_stiffness(uniform).apply(field)


def _form(contact: Contact, field: Field, pressure: Field) -> Scalar:
    return contact.grid.cell_area.astype(field.dtype) * total(field * pressure)


def _integrals(x: _Springs) -> tuple[_Springs, _Springs, _Springs]:
    """Return the integrals over theta in (0, 1) of a^2, a c and c^2.

    a = exp(-x theta) and c = theta ramp(x theta): in closed form, but by quadrature for small x,
    where the closed form loses its digits.
    """
    theta, weights = jnp.asarray(_NODES + 0.5, x.dtype), jnp.asarray(_WEIGHTS, x.dtype)
    turns = x[:, None] * theta
    a, c = jnp.exp(-turns), theta * ramp(turns, jnp.ones((), x.dtype))
    y = jnp.maximum(x, 1)
    once, twice = -jnp.expm1(-y) / y, -jnp.expm1(-2 * y) / (2 * y)
    near = a**2 @ weights, (a * c) @ weights, c**2 @ weights
    away = twice, (once - twice) / y, (1 - 2 * once + twice) / y**2
    return jax.tree.map(lambda n, a: jnp.where(x < 1, n, a), near, away)
