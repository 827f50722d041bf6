"""Cones of admissible perturbations, and the projection onto them.

V0+ holds the perturbations of zero mean that do not open into the surface where it is touched:
x >= 0 at the points in contact (Rey & Bleyer, eq. 18).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxstab.grid import total


class AdmissibleCone(eqx.Module):
    """V0+: fields that are not negative in contact (Rey & Bleyer, eqs. 18 and 26).

    Attributes:
        in_contact: where perturbations must not be negative.
        fixes_mean: whether they must have zero mean too, as under a prescribed mean gap.
    """

    in_contact: Bool[Array, " *grid"]
    fixes_mean: bool = eqx.field(static=True, default=True)

    @property
    def is_trivial(self) -> Bool[Array, ""]:
        """Whether zero is the only admissible perturbation, as in full contact at a mean gap."""
        return jnp.all(self.in_contact) & self.fixes_mean

    def project(self, field: Float[Array, " *grid"]) -> Float[Array, " *grid"]:
        """Return the nearest field of the cone.

        It is x - s, cut at zero in contact, with the shift s that makes its mean zero: the root
        of a convex, decreasing, piecewise linear function. Newton's method climbs to it from the
        left without passing it, and ends on it exactly. Where the mean is free, s is zero.
        """
        if not self.fixes_mean:
            return self._cut(field)

        def climb(state: tuple[Array, Array]) -> tuple[Array, Array]:
            shift, _ = state
            step = self.newton_step(field - shift)
            return shift + step, (step > 0) & (shift + step > shift)

        # The mean is left of the root: cutting below zero can only raise the sum.
        start = (jnp.mean(field), jnp.array(True))
        shift, _ = jax.lax.while_loop(lambda state: state[1], climb, start)
        return self._cut(field - shift)

    def newton_step(self, field: Float[Array, " *grid"]) -> Float[Array, ""]:
        """Return the first Newton step towards the shift that projects a field."""
        if not self.fixes_mean:
            return jnp.zeros((), field.dtype)
        cut = self._cut(field)
        num_moving = total(jnp.where((cut > 0) | ~self.in_contact, 1, 0).astype(field.dtype))
        return total(cut) / jnp.maximum(num_moving, 1)

    def _cut(self, field: Float[Array, " *grid"]) -> Float[Array, " *grid"]:
        return jnp.where(self.in_contact, jnp.maximum(field, 0), field)
