"""The Hessian of a contact's energy at a gap: an operator, and what eigensolvers ask of it."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxstab.elasticity import apply_multiplier, softest_wave
from jaxstab.grid import total

# Several fields along a leading axis.
Block = Float[Array, "block *grid"]


class SymmetricOperator(eqx.Module):
    """A symmetric operator on fields, with what an eigensolver needs to know of it.

    Attributes:
        bound: a number not below the norm of A.
        scale: the size of A on its lower modes, not above the bound: what residuals are relative
            to.
    """

    bound: eqx.AbstractVar[Float[Array, ""]]
    scale: eqx.AbstractVar[Float[Array, ""]]

    @abstractmethod
    def __call__(self, field: Float[Array, " *grid"]) -> Float[Array, " *grid"]:
        """Apply the operator A."""

    @abstractmethod
    def precondition(
        self,
        field: Float[Array, " *grid"],
        mode: Float[Array, " *grid"],
        eigenvalue: Float[Array, ""],
    ) -> Float[Array, " *grid"]:
        """Return roughly (A - lambda)^-1 times a field, by a positive operator.

        Arguments:
            field: what to apply it to.
            mode: a unit vector near which it should be good.
            eigenvalue: the Rayleigh quotient of that vector.
        """


class Hessian(SymmetricOperator):
    """A = K + D (Rey & Bleyer, eq. 24).

    Arguments:
        multiplier: K on the half spectrum [pressure/length].
        curvature: f''(g), the diagonal of D [pressure/length].
    """

    multiplier: Float[Array, " *modes"]
    curvature: Float[Array, " *grid"]
    bound: Float[Array, ""]
    scale: Float[Array, ""]
    softest: Float[Array, ""]

    def __init__(self, multiplier: Float[Array, " *modes"], curvature: Float[Array, " *grid"]):
        self.multiplier = multiplier
        self.curvature = curvature
        # Computed once, since eigensolvers ask for them at every step.
        stiffest, softening = jnp.max(multiplier), -jnp.min(curvature)
        # K is not negative, so |A| <= max(K + D, -D).
        highest = stiffest + jnp.maximum(jnp.max(curvature), 0)
        self.bound = jnp.maximum(highest, softening)
        # Points of large f'' take no part in lower modes.
        self.scale = jnp.maximum(stiffest, softening)
        self.softest = softest_wave(multiplier)

    def __call__(self, field: Float[Array, " *grid"]) -> Float[Array, " *grid"]:
        """Return A x, at the price of one pair of Fourier transforms."""
        return apply_multiplier(self.multiplier, field) + self.curvature * field

    def restricted(self, mask: Bool[Array, " *grid"]) -> "Hessian":
        """Return an operator that does the same to fields which vanish outside the mask, there."""
        return Hessian(self.multiplier, jnp.where(mask, self.curvature, 0))

    def precondition(
        self,
        field: Float[Array, " *grid"],
        mode: Float[Array, " *grid"],
        eigenvalue: Float[Array, ""],
    ) -> Float[Array, " *grid"]:
        """Return F (K + s)^-1 F times a field, s the elastic part x.Kx of the eigenvalue.

        F = (1 + (f'' - lambda - s) / s)^-1/2 where f'' is above lambda + s, 1 elsewhere: a mode
        decays where the adhesion is that stiff.
        """
        elastic = eigenvalue - total(self.curvature * mode**2)
        shift = jnp.maximum(elastic, self.softest)
        stiff = jnp.maximum(self.curvature - eigenvalue - shift, 0)
        share = jnp.sqrt(shift / (shift + stiff))
        return share * apply_multiplier(1 / (self.multiplier + shift), share * field)
