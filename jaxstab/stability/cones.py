"""Spaces and cones of perturbations, and the projections onto them.

V0+ holds the perturbations of zero mean that do not penetrate the surface where it is touched:
x >= 0 at the points in contact (Rey & Bleyer, eq. 18). The critical cone is smaller: x = 0 where
contact presses, since lifting off there costs energy at first order.

A surface that yields where its pressure is H can be indented there further, never less. So x <= 0
at such points, at no cost of first order: they are one-sided in both cones, with the other sign.
"""

import equinox as eqx
import jax.numpy as jnp

from jaxstab.core import model
from jaxstab.core.grid import total
from jaxstab.core.types import Field, Flag, Mask, Scalar


class Subspace(eqx.Module):
    """Fields that vanish outside a mask.

    Attributes:
        is_moving: where they need not vanish.
        fixes_mean: whether they must have zero mean too.
    """

    is_moving: Mask
    fixes_mean: bool = eqx.field(static=True, default=True)

    @property
    def is_trivial(self) -> Flag:
        """Whether zero is its only field."""
        return _count(self.is_moving) <= self.fixes_mean

    def project(self, field: Field) -> Field:
        """Return the nearest field of the space."""
        if self.fixes_mean:
            return model.onto_space(field, self.is_moving)
        return jnp.where(self.is_moving, field, 0)


class AdmissibleCone(eqx.Module):
    """Fields that are nowhere negative on one mask, and vanish on another.

    V0+ (Rey & Bleyer, eqs. 18 and 26) is one-sided at all points in contact and held at none.

    Attributes:
        one_sided: where perturbations must not be negative, or not have another sign.
        held: where they must vanish, out of that mask; nowhere if None.
        fixes_mean: whether they must have zero mean too, as under a prescribed mean gap.
        is_trivial: whether zero is the only admissible perturbation, as in full contact at a mean
            gap.
        sign: 1, or -1 where perturbations must not be positive; None if there are no such points.
    """

    one_sided: Mask
    held: Mask | None
    fixes_mean: bool = eqx.field(static=True)
    is_trivial: Flag
    sign: Field | None

    def __init__(
        self,
        one_sided: Mask,
        held: Mask | None = None,
        fixes_mean: bool = True,
        sign: Field | None = None,
    ):
        self.one_sided = one_sided
        self.held = held
        self.fixes_mean = fixes_mean
        self.sign = sign
        # Computed once, since the programs of a search ask for it. All one-sided points count as
        # one: if the mean is fixed, they need another point to move against.
        num_free = _count(self.is_moving & ~one_sided)
        if sign is None:
            num_sides = jnp.any(one_sided)
        else:
            moving = self.is_moving & one_sided
            num_sides = jnp.any(moving & (sign > 0)) + 1 * jnp.any(moving & (sign < 0))
        self.is_trivial = num_free + num_sides <= fixes_mean

    @property
    def is_moving(self) -> Mask:
        """Where perturbations need not vanish."""
        if self.held is None:
            return jnp.ones_like(self.one_sided)
        return ~self.held

    @property
    def hull(self) -> Subspace:
        """The smallest linear space around the cone."""
        return Subspace(self.is_moving, self.fixes_mean)

    def hull_if(self, drops_constraints: Flag) -> "AdmissibleCone":
        """Return the cone, or if it drops its constraints the linear space around it.

        Of a space with no other field than zero all projections are exactly zero.
        """
        changed = self.one_sided & ~drops_constraints, self.is_trivial & ~drops_constraints
        return eqx.tree_at(lambda cone: (cone.one_sided, cone.is_trivial), self, changed)

    def inward(self, field: Field) -> Field:
        """Return a field times the sign of the cone: positive where it leads into the cone."""
        return model.inward(field, self.sign)

    def excludes(self, field: Field) -> Mask:
        """Return where a field has the wrong sign."""
        return self.one_sided & (self.inward(field) < 0)

    def face(self, inward: Field) -> Subspace:
        """Return the smallest linear space of the cone's faces around one of its fields.

        Given is that field by its `inward` components.
        """
        return Subspace(self.is_moving & (~self.one_sided | (inward > 0)), self.fixes_mean)

    def project(self, field: Field) -> Field:
        """Return the nearest field of the cone.

        Where its mean is free, the field is only cut at zero.
        """
        if not self.fixes_mean:
            return model.onto_one_sided(field, self.one_sided, self.is_moving, self.sign)
        if self.sign is None:
            return model.onto_cone(field, self.one_sided, self.is_moving)
        return model.onto_cone_of_signs(field, self.one_sided, self.is_moving, self.sign)


def _count(mask: Mask) -> Scalar:
    return total(mask.astype(jnp.float32))
