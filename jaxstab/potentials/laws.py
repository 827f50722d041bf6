"""Ready-made laws: modules that map one gap to an energy per area."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from jaxstab.core.checks import known, parameter, require, require_positive
from jaxstab.core.display import in_full
from jaxstab.core.docstrings import described
from jaxstab.core.types import Scalar

_ARGUMENTS = {
    "surface_energy": "w, the work of adhesion per area, gamma_1 + gamma_2 - gamma_12 of the two "
    "surfaces; between equal ones twice the surface energy of each [energy/area]",
    "length": "rho, the range [length]",
}


class _RangedLaw(eqx.Module):
    """A law with a work of adhesion [energy/area] and a range [length]."""

    surface_energy: Scalar
    length: Scalar

    __repr__ = in_full

    def __init__(self, surface_energy: ArrayLike, length: ArrayLike):
        self.surface_energy = parameter(surface_energy)
        self.length = parameter(length)
        energy = known(self.surface_energy)
        finite = (energy >= 0) & (energy < np.inf)
        require("The surface energy", energy, finite, "it must be finite and not negative.")
        require_positive("The length of the potential", self.length)

    def _reduced(self, gap: Scalar) -> Scalar:
        # By a product: over a whole field, a quotient takes longer than all the rest.
        return gap * (1 / self.length)


@described(_ARGUMENTS, "if w is negative or rho is not positive")
class Exponential(_RangedLaw):
    """f(g) = -w exp(-g / rho) (Rey & Bleyer, eq. 45)."""

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy * jnp.exp(-self._reduced(gap))


@described(_ARGUMENTS, "if w is negative or rho is not positive")
class Gaussian(_RangedLaw):
    """f(g) = -w exp(-g^2 / (2 rho^2)) (Rey & Bleyer, eq. 46)."""

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy * jnp.exp(-(self._reduced(gap) ** 2) / 2)


@described(_ARGUMENTS, "if w is negative or rho is not positive")
class Rational(_RangedLaw):
    """f(g) = -w / (1 + g^2 / rho^2) (Rey & Bleyer, eq. 47), a long-range law."""

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        return -self.surface_energy / (1 + self._reduced(gap) ** 2)


@described(
    _ARGUMENTS,
    "if w is negative, or rho or the smoothing is not positive",
    smoothing="s / rho, over which the attraction falls from 73 to 27 % of sigma",
)
class Dugdale(_RangedLaw):
    """f' = sigma / (1 + exp((g - rho) / s)): the attraction sigma up to a gap rho, then none.

    The edge of Dugdale's step is smoothed over s; sigma is such that f(0) = -w. Its wall is contact
    itself.
    """

    smoothing: Scalar

    def __init__(self, surface_energy: ArrayLike, length: ArrayLike, smoothing: ArrayLike = 0.1):
        super().__init__(surface_energy, length)
        self.smoothing = parameter(smoothing)
        require_positive("The smoothing of the potential", self.smoothing)

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        edge = 1 / self.smoothing
        left = jax.nn.softplus(edge * (1 - self._reduced(gap)))
        return -self.surface_energy * left / jax.nn.softplus(edge)


@described(_ARGUMENTS, "if w or z0 is not positive", length="z0, the gap at the minimum [length]")
class LennardJones(_RangedLaw):
    """f(g) = w / 2 ((z0 / g)^9 - 3 (z0 / g)^3): the 9-3 law between a solid and a wall.

    It repels below z0, where it is least, at -w; no gap closes against it.
    """

    def __init__(self, surface_energy: ArrayLike, length: ArrayLike):
        super().__init__(surface_energy, length)
        require_positive("The surface energy of a law with a core", self.surface_energy)

    def __call__(self, gap: Scalar) -> Scalar:
        """Return the energy per area at a gap [length]."""
        attraction = 1 / self._reduced(gap) ** 3
        # In this form infinite, not undefined, at zero gap.
        return self.surface_energy / 2 * attraction * (attraction**2 - 3)


class NoAdhesion(eqx.Module):
    """f(g) = 0: contact without adhesion."""

    def __call__(self, gap: Scalar) -> Scalar:
        """Return zero energy per area at any gap [length]."""
        return jnp.zeros_like(gap)
