"""The power law of the barrier before a jump, over the distance of the load from it.

Near a fold the energy along the mode is a cubic, and the barrier grows with the power 3/2. Near a
release a negative curvature overcomes a reaction, and the power is 2. The next term of the
expansion is higher by one power, and tells how far the law holds.
"""

from dataclasses import replace
from functools import partial
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.branches.response import opening_of_point, response
from jaxstab.contact import Contact
from jaxstab.core.display import Outcome, inline
from jaxstab.core.grid import mean_over, total
from jaxstab.core.types import Field, FieldMap, Mask, Scalar
from jaxstab.core.units import NUMBER, Dimension
from jaxstab.equilibrium.derivatives import free_system, third_derivative
from jaxstab.loads import Load
from jaxstab.states.kinds import KINDS

# The error of the law at the end of its range, and its next term there: further ones add to it.
_ERROR = 0.2
_NEXT_TERM = 0.15


class BarrierLaw(Outcome):
    """The barrier at a small distance s of the load before a jump: C s^e.

    Attributes:
        exponent: e, 3/2 at a fold and 2 at a release; NaN at a touch, and at a bifurcation: there
            the load does not drive the mode, which breaks a symmetry.
        coefficient: C [energy over the load to that power]; NaN in the same cases.
        range: the distance of the load up to which C s^e is within about 20 % of the barrier, by
            the next term of its expansion and the first change of other contact points [as the
            load]; NaN in the same cases.
        load_unit: the quantity of the load, "length" or "pressure".

    Example:
        >>> path = js.follow(contact, js.MeanGap([0.3, 0.03, 0.3]), fields=True)
        >>> [f"{jump.barrier_law.exponent:.1f}" for jump in path.jumps]
        ['1.5', '2.0']
    """

    exponent: Annotated[Scalar, NUMBER]
    coefficient: Annotated[Scalar, Dimension("energy/load^exponent")]
    range: Annotated[Scalar, Dimension("load")]
    load_unit: str = eqx.field(static=True)

    __repr__ = inline

    def barrier(self, distance: Scalar) -> Scalar:
        """Return C s^e at a distance of the load, in its units [energy].

        Beyond `range` that is no estimate: the barrier may be several times as low or as high.
        """
        return self.coefficient * jnp.abs(distance) ** self.exponent

    def in_units_of(self, pressure: Scalar) -> "BarrierLaw":
        """Return the same with pressures in another unit, given in the old one."""
        unit = jnp.ones_like(pressure)
        if self.load_unit == "pressure":
            unit = pressure
        coefficient = self.coefficient * unit**self.exponent / pressure
        return BarrierLaw(self.exponent, coefficient, self.range / unit, self.load_unit)


class _Expansion(eqx.Module):
    """The state and the saddle at a small distance s of the load, and the barrier between them.

    From the end of the branch the state is at s y - sqrt(s) w x, the saddle at s (y + v x) +
    sqrt(s) w x. There y is a response to the load, and x the move from one to the other.

    Attributes:
        exponent: e of the law.
        size: C over the area of a cell.
        next_term: c in C s^e (1 + c s).
        side: the sign of the change of the load, and so of y.
        spread: w.
        lead: v.
    """

    exponent: Scalar
    size: Scalar
    next_term: Scalar
    side: Scalar
    spread: Scalar
    lead: Scalar


def barrier_law(
    contact: Contact, load: Load, gap: Field, kind: KINDS, mode: Field, point: Mask
) -> BarrierLaw:
    """Return the law at the last state of a branch, given its mode, or the released point.

    With a = x.dr/dl and k = sum f'''(g) x^3 at a fold, C = 4 sqrt(2) / 3 |a|^(3/2) / |k|^(1/2). At
    a release C = (x.dr/dl)^2 / (2 |x.Ax|), x being the move that opens the point. The next term is
    that of the energy at the moves of `_Expansion`, as it is stationary there.
    """
    net, gap_rate, net_rate = response(contact, load, gap)
    control = contact.control(load)
    hessian = contact.hessian(gap, control)
    is_free = gap > 0
    is_release = kind == KINDS.release
    # A law may be singular at zero gap, where the points that stay closed do not feel it.
    third, fourth, fifth = (
        jnp.where(is_free | point, x, 0) for x in _higher_derivatives(contact, gap)
    )
    move = jnp.where(is_release, opening_of_point(contact, load, gap, point), mode)
    cubic = total(third * move**3)
    # At a fold state and saddle lie on opposite sides along the mode, which bends the curve. Along
    # the mode nothing resists, and all else follows across it.
    turn = jnp.where(is_release, 0, total(move * net_rate) / cubic)
    forces = jnp.stack([hessian(move), net_rate - turn * third * move**2])
    system = free_system(contact, control, gap)
    across = partial(_project_across, system.project, jnp.where(is_release, 0, mode))
    system = replace(system, project=across)

    def response_to(force: Field) -> tuple[Field, Field]:
        change = system.differentiable_solution(-force)
        return change, hessian(change)

    # A mode has relaxed already.
    changes, relief = jax.lax.map(response_to, forces.at[0].multiply(is_release))
    move = move + changes[0]
    rate = gap_rate + changes[1]
    # A load that holds the mean balances any uniform pressure.
    pulled, pushed = (rest - mean_over(is_free, rest) for rest in forces + relief)
    drive = move * net_rate
    slope = total(drive)

    def at_release() -> _Expansion:
        bend = total(move * pulled)
        side = jnp.sign(slope)
        lead = jnp.abs(slope / bend)
        size = slope**2 / jnp.where(bend < 0, -2 * bend, jnp.nan)
        here = side * rate
        term = total(third * ((here + lead * move) ** 3 - here**3)) / 6 / size
        return _Expansion(jnp.full_like(size, 2), size, term, side, jnp.zeros_like(size), lead)

    def at_fold() -> _Expansion:
        # The slope of the energy at the amplitude b sqrt(s) along the mode is (b^2 - w^2) s k / 2.
        # Its next parts are odd and even in b: in second and in first order they add to the term.
        side = -jnp.sign(slope * cubic)
        square = 2 * jnp.abs(slope / cubic)
        size = 2 / 3 * jnp.abs(cubic) * square**1.5
        here = side * rate
        along = square * move**2
        odd = total(move**2 * (third * here + along * fourth / 6))
        bent = along * (fourth * here + along * fifth / 20) / 6
        even = total(move * (third * here**2 / 2 + bent))
        term = 3 / (cubic * square) * (odd**2 / (2 * cubic) - even)
        rounding = jnp.finfo(gap.dtype).eps ** 0.25 * total(jnp.abs(drive))
        power = jnp.where(jnp.abs(slope) > rounding, jnp.full_like(size, 1.5), jnp.nan)
        return _Expansion(power, size, term, side, jnp.sqrt(square), jnp.zeros_like(size))

    law = jax.lax.cond(is_release, at_release, at_fold)
    # Gaps of free points, and reactions of the others, and how these move.
    left = jnp.where(is_free, gap, net)
    apart = jnp.where(is_free, move, pulled)
    along = jnp.where(is_free, rate, pushed)
    # A gap that closes, instead of falling below zero by d, costs at most K_ii d^2 / 2, where K_ii
    # is about half of the largest stiffness: at a release it counts once that is the error.
    delay = jnp.sqrt(4 * _ERROR * law.size / contact.solid.max_stiffness)
    along = law.side * along + jnp.where(is_free & is_release, delay, 0)
    half = law.spread * apart
    whole = law.lead * apart
    zeros = _zero(left, jnp.stack([-half, half]), jnp.stack([along, along + whole]))
    first = jnp.min(jnp.where(point, jnp.inf, zeros))
    reach = jnp.minimum(_NEXT_TERM / jnp.abs(law.next_term), first)
    is_known = (kind != KINDS.uncertain) & jnp.isfinite(law.exponent)
    coefficient = law.size * contact.grid.cell_area
    exponent, coefficient, reach = (
        jnp.where(is_known, x, jnp.nan) for x in (law.exponent, coefficient, reach)
    )
    return BarrierLaw(exponent, coefficient, reach, load.unit)


def _higher_derivatives(contact: Contact, gap: Field) -> tuple[Field, Field, Field]:
    """Return the third, fourth and fifth derivative of the law at every point."""
    one = (jnp.ones_like(gap),)

    def third_and_fourth(gap: Field) -> tuple[Field, Field]:
        return jax.jvp(partial(third_derivative, contact), (gap,), one)

    (third, fourth), (_, fifth) = jax.jvp(third_and_fourth, (gap,), one)
    return third, fourth, fifth


def _project_across(project: FieldMap, direction: Field, field: Field) -> Field:
    """Return the part of a projected field across a unit vector of the space, or zero."""
    inside = project(field)
    return inside - total(direction * inside) * direction


def _zero(value: Field, half: Field, whole: Field) -> Field:
    """Return the least s > 0 at which value + half sqrt(s) + whole s falls to zero, or infinity."""
    value = jnp.maximum(value, jnp.finfo(value.dtype).tiny)
    root = 2 * value / (jnp.sqrt(half**2 - 4 * value * whole) - half)
    # The square root is NaN where there is none.
    return jnp.where(root > 0, root, jnp.inf) ** 2
