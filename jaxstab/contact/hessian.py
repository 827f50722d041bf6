"""The Hessian of a contact's energy at a gap: an operator, with its bounds for eigensolvers."""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxstab.core import model
from jaxstab.core.grid import mean, total
from jaxstab.core.types import Field, FieldMap, Mask, Scalar
from jaxstab.solids.solid import Solid, apart_from_mean

# Several fields along a leading axis.
Block = Float[Array, "block *grid"]


class SymmetricOperator(eqx.Module):
    """A symmetric operator on fields, with the properties that an eigensolver needs.

    Attributes:
        bound: a number not below the norm of A.
        scale: the size of A on its lower modes, not above the bound: residuals are relative
            to.
    """

    bound: eqx.AbstractVar[Scalar]
    scale: eqx.AbstractVar[Scalar]

    @abstractmethod
    def __call__(self, field: Field) -> Field:
        """Apply the operator A."""

    @abstractmethod
    def preconditioner(self, mode: Field, eigenvalue: Scalar) -> FieldMap:
        """Return a positive operator that is roughly (A - lambda)^-1."""


class Hessian(SymmetricOperator):
    """A = K + D (Rey & Bleyer, eq. 24), and the part of the load.

    Arguments:
        solid: K.
        curvature: f''(g), the diagonal of D [pressure/length].
        stiffness: the load's, on the mean of a perturbation [pressure/length], or None.
        mask: the points that may move, None for all.
    """

    solid: Solid
    curvature: Field
    stiffness: Scalar | None
    mask: Mask | None
    bound: Scalar
    scale: Scalar

    def __init__(
        self,
        solid: Solid,
        curvature: Field,
        stiffness: Scalar | None = None,
        mask: Mask | None = None,
    ):
        if mask is not None:
            curvature = jnp.where(mask, curvature, 0)
        self.curvature = curvature
        self.stiffness = stiffness
        self.mask = mask
        # Computed once, since eigensolvers ask for them at every step.
        stiffest = solid.max_stiffness
        softening = -jnp.min(self.curvature)
        stiffening = jnp.maximum(jnp.max(self.curvature), 0)
        if stiffness is None:
            self.solid = solid.with_uniform_stiffness(0)
            highest = stiffest
        else:
            self.solid = solid.with_uniform_stiffness(stiffness)
            highest = jnp.maximum(stiffest, stiffness)
            if solid.punch is not None:
                highest = stiffest + stiffness * mean(solid.punch**2)
        # K is not negative, so |A| <= max(K + D, -D).
        self.bound = jnp.maximum(highest + stiffening, softening)
        # Points of large f'' take no part in lower modes, nor do points that are stiffly held.
        self.scale = jnp.maximum(stiffest, softening)

    def __call__(self, field: Field) -> Field:
        """Return A x, at the price of one application of K."""
        return model.hessian(self.solid.apply, self.curvature, field)

    def restriction(self, mask: Mask) -> "Hessian":
        """Return an operator that does the same to fields which vanish outside the mask, there."""
        return Hessian(self.solid, self.curvature, self.stiffness, mask)

    def preconditioner(self, mode: Field, eigenvalue: Scalar) -> FieldMap:
        """Return F (K + s)^-1 F, s the elastic part x.Kx of the eigenvalue.

        F = (1 + (f'' - lambda - s) / s)^-1/2 where f'' is above lambda + s, 1 elsewhere: a mode
        decays where the adhesion is that stiff.
        """
        elastic = eigenvalue - total(self.curvature * mode**2)
        shift = jnp.clip(elastic, self.solid.min_stiffness, self.solid.max_stiffness)
        stiff = jnp.maximum(self.curvature - eigenvalue - shift, 0)
        factor = jnp.sqrt(shift / (shift + stiff))
        inverse = self.inverse(shift)
        return lambda field: factor * inverse(factor * field)

    def inverse(self, shift: Scalar) -> FieldMap:
        """Return roughly the inverse of K + shift on fields that vanish outside the mask."""
        inverse = self.solid.precondition(shift)
        stiffness = self.stiffness
        if stiffness is None:
            return inverse
        mask = self.mask
        if mask is None:
            mask = jnp.ones_like(self.curvature, bool)
        return lambda field: apart_from_mean(inverse, field, mask, stiffness, shift)
