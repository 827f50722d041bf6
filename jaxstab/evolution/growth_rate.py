"""The growth rate of the least stable perturbation of a viscoelastic contact."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.contact import Contact
from jaxstab.contact.hessian import Hessian
from jaxstab.core.checks import require_kind
from jaxstab.core.compile import own_conventions, program
from jaxstab.core.grid import total
from jaxstab.core.implicit import attach, finite, no_derivatives, tangent_of, where_traced
from jaxstab.core.types import Field, Flag, Scalar
from jaxstab.equilibrium.posing import posed_state
from jaxstab.evolution.evolution import Evolution
from jaxstab.loads import Load
from jaxstab.solids import Viscoelastic
from jaxstab.stability.cones import Subspace
from jaxstab.stability.lowest_pair import on_space
from jaxstab.stability.solvers.base import BLOCK_SIZE, noise
from jaxstab.stability.solvers.davidson import Davidson


@own_conventions()
def growth_rate(evolution: Evolution) -> Scalar:
    """Return the rate s at which the least stable perturbation of a state grows [1/time].

    A perturbation x exp(s t) meets the stiffness K(s) = K (1 + sum r_k s t_k / (1 + s t_k)). At
    the rate of growth K(s) + D is singular on the linear space of the critical cone, where the
    points that press stay in contact. The smallest eigenvalue grows with the stiffness; its root is
    found by Newton's method.

    Arguments:
        evolution: one state of an `Evolution` with `fields`, or the last one.

    Returns:
        s; zero where the relaxed solid is stable, infinite where the glassy one is not. For the
        last state it has first derivatives, as `evolve` has; otherwise they are NaN.

    Raises:
        TypeError: for something that is no evolution.
        ValueError: if the gap of the state was not kept.

    Example:
        >>> contact = js.Contact(js.Viscoelastic(solid, (1.0,), (0.1,)), heights, law)
        >>> evolution = js.evolve(contact, js.MeanGap([0.3, 0.05]), [0.0, 1.0])
        >>> f"{js.growth_rate(evolution):.2f}"
        '0.88'
    """
    require_kind(evolution, Evolution, "no evolution: give a state of a result of jaxstab.evolve.")
    contact, equilibrium = evolution.instant
    solid: Any = evolution.contact.solid
    problem = posed_state(contact, equilibrium)
    equilibrium = problem.equilibrium
    glassy = _glassy_stiffening(solid)
    inputs = glassy, problem.contact, equilibrium.load, equilibrium.gap
    found = _singular_stiffening(equilibrium.reaction, *jax.lax.stop_gradient(inputs))
    stiffening, _ = _with_derivatives(found, inputs)
    return _rate(stiffening, glassy, solid.ratios, solid.times)


@program
def _glassy_stiffening(solid: Viscoelastic) -> Scalar:
    return solid.stiffening(0.0)


@program
def _singular_stiffening(
    reaction: Field, glassy: Scalar, contact: Contact, load: Load, gap: Field
) -> tuple[Scalar, Field]:
    """Return the c >= 1 at which c K + D is singular, above `glassy` if that is unstable.

    And the mode on the moving points that has no stiffness there. Newton's method from the glassy
    solid: the smallest eigenvalue is concave in c, as x.A(c) x of each mode lies above it. So the
    first step leads to the left of the root, and the others rise to it. Each squares the error:
    after a step of the root of the precision no digits are left to gain.
    """
    space = Subspace(~(reaction > 0), contact.control(load).fixes_mean)
    solver = Davidson()
    accuracy = float(jnp.finfo(gap.dtype).eps) ** 0.5

    def goes_on(state: tuple) -> Flag:
        c, before, *_, number = state
        return (number < 2) | (c - before > accuracy * c)

    def step(state: tuple) -> tuple:
        c, _, starts, _, number = state
        found = on_space(solver, _hessian_at(c, glassy, contact, load, gap), space, starts)
        mode = found.pair.mode
        slope = _slope(mode, c, glassy, contact, load, gap)
        new = jnp.clip(c - found.pair.eigenvalue / slope, 1, 2 * glassy)
        return new, c, found.modes, mode, number + 1

    starts = contact.grid.device_put(noise(jax.random.key(0), BLOCK_SIZE, gap))
    state = glassy, glassy, starts, jnp.zeros_like(gap), jnp.array(0)
    c, _, _, mode, _ = jax.lax.while_loop(goes_on, step, state)
    return jnp.where(space.is_trivial, 1, c), mode


def _hessian_at(c: Scalar, glassy: Scalar, contact: Contact, load: Load, gap: Field) -> Hessian:
    """Return c K + D, with the load's part; the solid of the contact is the glassy one."""
    solid = contact.solid.scaled(c / glassy)
    control = load.control(solid, contact.heights)
    return Hessian(solid, contact.curvature(gap), control.stiffness)


def _quotient(mode: Field, c: Scalar, *inputs: Any) -> Scalar:
    return total(mode * _hessian_at(c, *inputs)(mode))


def _slope(mode: Field, c: Scalar, *inputs: Any) -> Scalar:
    return jax.jvp(lambda c: _quotient(mode, c, *inputs), (c,), (jnp.ones_like(c),))[1]


@where_traced
def _with_derivatives(found: tuple[Scalar, Field], inputs: tuple) -> tuple[Scalar, Field]:
    stiffening, mode = found
    return attach(_changes_of_stiffening, stiffening, mode, inputs), mode


def _changes_of_stiffening(
    c: Scalar, mode: Field, inputs: tuple, changes: tuple
) -> tuple[Scalar, Flag]:
    """Return dc = -x.dA x / (x.dA/dc x), since the eigenvalue stays zero: a rule."""
    inputs = finite(jnp.isfinite(c), inputs)
    is_found = jnp.isfinite(c)
    # In second derivatives the mode moves.
    mode = attach(no_derivatives, mode, None, inputs)
    work = tangent_of(partial(_quotient, mode, c), inputs, changes)
    slope = _slope(mode, c, *inputs)
    return -work / jnp.where(slope > 0, slope, 1), ~is_found


@program
def _rate(stiffening: Scalar, glassy: Scalar, ratios: Array, times: Array) -> Scalar:
    """Return s of K(s) / K = 1 + sum r_k s t_k / (1 + s t_k), by Newton's method from zero.

    It is zero below the stiffness of the relaxed solid, and infinite from the one of the glassy on.
    The sum is concave, so that s rises to the root, and stops there by rounding. One more step has
    the derivatives of the root.
    """

    def newton(s: Scalar, stiffening: Scalar, ratios: Array, times: Array) -> Scalar:
        turns = 1 + s * times
        missing = stiffening - 1 - jnp.sum(ratios * s * times / turns)
        return s + missing / jnp.sum(ratios * times / turns**2)

    def rises(state: tuple[Scalar, Scalar]) -> Flag:
        s, new = state
        return new > s

    def step(state: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        _, s = state
        return s, newton(s, *fixed)

    is_between = (stiffening > 1) & (stiffening < glassy)
    between = jnp.where(is_between, stiffening, 1)
    fixed = jax.lax.stop_gradient((between, ratios, times))
    zero = jnp.zeros_like(fixed[0])
    root, _ = jax.lax.while_loop(rises, step, (zero, newton(zero, *fixed)))
    rate = newton(root, between, ratios, times)
    rate = jnp.where(stiffening >= glassy, jnp.inf, rate)
    rate = jnp.where(stiffening <= 1, 0, rate)
    return jnp.where(jnp.isnan(stiffening), jnp.nan, rate)
