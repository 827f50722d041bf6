"""The power law of the barrier before a jump, over the distance of the load from it.

Near a fold the energy along the mode is a cubic, and the barrier grows with the power 3/2. Near a
release a negative curvature overcomes a reaction, and the power is 2.
"""

from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxstab.contact import Contact
from jaxstab.core.display import Outcome, inline
from jaxstab.core.grid import total
from jaxstab.core.types import Field, Mask, Scalar
from jaxstab.core.units import NUMBER, Dimension
from jaxstab.equilibrium.derivatives import third_derivative
from jaxstab.loads import Load
from jaxstab.paths.kinds import KINDS
from jaxstab.paths.response import free_space, opening, response


class BarrierLaw(Outcome):
    """The barrier at a small distance s of the load before a jump: C s^e.

    Attributes:
        exponent: e, 3/2 at a fold and 2 at a release; NaN at a touch, and at a bifurcation: there
            the load does not drive the mode, which breaks a symmetry.
        coefficient: C [energy over the load to that power]; NaN in the same cases.
        load_unit: the quantity of the load, "length" or "pressure".
    """

    exponent: Annotated[Scalar, NUMBER]
    coefficient: Annotated[Scalar, Dimension("energy/load^exponent")]
    load_unit: str = eqx.field(static=True)

    __repr__ = inline

    def barrier(self, distance: Scalar) -> Scalar:
        """Return the barrier at a distance of the load, in the units of the load [energy]."""
        return self.coefficient * jnp.abs(distance) ** self.exponent

    def in_units_of(self, pressure: Scalar) -> "BarrierLaw":
        """Return the same with pressures in another unit, given in the old one."""
        power = 1 - self.exponent if self.load_unit == "pressure" else 1
        return BarrierLaw(self.exponent, self.coefficient / pressure**power, self.load_unit)


def barrier_law(
    contact: Contact, load: Load, gap: Field, kind: KINDS, mode: Field, point: Mask
) -> BarrierLaw:
    """Return the law at the last state of a branch, given its mode, or the released point.

    With a = x.dr/dl and k = sum f'''(g) x^3 at a fold, C = 4 sqrt(2) / 3 |a|^(3/2) / |k|^(1/2). At
    a release C = (x.dr/dl)^2 / (2 |x.Ax|), x being the move that opens the point.
    """
    net_rate = response(contact, load, gap).net_rate

    def at_release() -> tuple[Scalar, Scalar]:
        move = opening(contact, load, gap, point)
        bend = total(move * contact.hessian(gap, contact.control(load))(move))
        slope = total(move * net_rate)
        coefficient = slope**2 / jnp.where(bend < 0, -2 * bend, jnp.nan)
        return jnp.full_like(coefficient, 2), coefficient

    def at_fold() -> tuple[Scalar, Scalar]:
        space = free_space(contact, load, gap)
        forces = mode * space.project(net_rate)
        cubic = total(third_derivative(contact, gap) * mode**3)
        coefficient = 4 * 2**0.5 / 3 * jnp.abs(total(forces)) ** 1.5 / jnp.sqrt(jnp.abs(cubic))
        rounding = jnp.finfo(gap.dtype).eps ** 0.25 * total(jnp.abs(forces))
        is_driven = jnp.abs(total(forces)) > rounding
        power = jnp.where(is_driven, jnp.full_like(coefficient, 1.5), jnp.nan)
        return power, power / 1.5 * coefficient

    law = jax.lax.cond(kind == KINDS.release, at_release, at_fold)
    exponent, coefficient = (jnp.where(kind == KINDS.uncertain, jnp.nan, x) for x in law)
    return BarrierLaw(exponent, coefficient * contact.grid.cell_area, load.unit)
