"""Spaces and cones of perturbations, and the projections onto them.

V0+ holds the perturbations of zero mean that do not open into the surface where it is touched:
x >= 0 at the points in contact (Rey & Bleyer, eq. 18). The critical cone is smaller: x = 0 where
contact presses, since lifting off there costs energy at first order.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxstab.core.grid import centred, total
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
            return centred(field, self.is_moving)
        return jnp.where(self.is_moving, field, 0)


class AdmissibleCone(eqx.Module):
    """Fields that are nowhere negative on one mask, and vanish on another.

    V0+ (Rey & Bleyer, eqs. 18 and 26) is one-sided at all points in contact and held at none.

    Attributes:
        one_sided: where perturbations must not be negative.
        held: where they must vanish, nowhere if None.
        fixes_mean: whether they must have zero mean too, as under a prescribed mean gap.
    """

    one_sided: Mask
    held: Mask | None = None
    fixes_mean: bool = eqx.field(static=True, default=True)

    @property
    def is_moving(self) -> Mask:
        """Where perturbations need not vanish."""
        return jnp.ones_like(self.one_sided) if self.held is None else ~self.held

    @property
    def is_trivial(self) -> Flag:
        """Whether zero is the only admissible perturbation, as in full contact at a mean gap."""
        num_moving = _count(self.is_moving)
        num_free = _count(self.is_moving & ~self.one_sided)
        if not self.fixes_mean:
            return num_moving == 0
        return (num_free == 0) | (num_moving == 1)

    @property
    def hull(self) -> Subspace:
        """The smallest linear space around the cone."""
        return Subspace(self.is_moving, self.fixes_mean)

    def face(self, field: Field) -> Subspace:
        """Return the smallest linear space of the cone's faces around one of its fields."""
        return Subspace(self.is_moving & (~self.one_sided | (field > 0)), self.fixes_mean)

    def project(self, field: Field) -> Field:
        """Return the nearest field of the cone.

        It is x - s, cut at zero where one-sided, with the shift s that makes its mean zero: the
        root of a convex, decreasing, piecewise linear function. The first step of Newton's method,
        from no shift, leads to the left of it. The others climb to it without passing it, and reach
        it when no more points are cut. Where the mean is free, s is zero.
        """
        if not self.fixes_mean:
            return self._cut(field)

        def climb(state: tuple[Array, ...]) -> tuple[Array, ...]:
            shift, last, _, is_first = state
            shift += self._step(field - shift, last)
            # Each set holds the next: as many points are the same ones.
            number = self._num_uncut(field - shift)
            goes_on = (number < last) | (is_first & (number > last))
            return shift, number, goes_on, jnp.array(False)

        yes = jnp.array(True)
        start = jnp.zeros((), field.dtype), self._num_uncut(field), yes, yes
        shift, *_ = jax.lax.while_loop(lambda state: state[2], climb, start)
        return self._cut(field - shift)

    def newton_step(self, field: Field) -> Scalar:
        """Return the first Newton step towards the shift that projects a field."""
        if not self.fixes_mean:
            return jnp.zeros((), field.dtype)
        return self._step(field, self._num_uncut(field))

    def _step(self, field: Field, num_uncut: Array) -> Array:
        return total(jnp.where(self._is_uncut(field), field, 0)) / jnp.maximum(num_uncut, 1)

    def _num_uncut(self, field: Field) -> Array:
        return total(self._is_uncut(field).astype(field.dtype))

    def _is_uncut(self, field: Field) -> Mask:
        return self.is_moving & ((field > 0) | ~self.one_sided)

    def _cut(self, field: Field) -> Field:
        cut = jnp.where(self.one_sided, jnp.maximum(field, 0), field)
        return cut if self.held is None else jnp.where(self.held, 0, cut)


def _count(mask: Mask) -> Scalar:
    return total(mask.astype(jnp.float32))
