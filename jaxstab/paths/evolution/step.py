"""A step in time of a viscoelastic contact: an elastic equilibrium on a surface moved by memory.

The internal variables are displacements v_k of the branches, v_k' = w' - v_k / t_k, with w the
displacement relative to the far side, and p = K (w + sum r_k v_k). For w linear in time within a
step dt, with e_k = exp(-dt / t_k) and b_k = (t_k / dt) (1 - e_k), a branch ends at

    v_k(new) = e_k v_k + b_k (w(new) - w),

so that p(new) = K_step (w(new) + m) with K_step = K (1 + sum r_k b_k) and the memory
m = sum r_k (e_k v_k - b_k w) / (1 + sum r_k b_k). A step is the elastic equilibrium of K_step on
the surface h + m, exact for any dt if w is linear in it, of second order otherwise.
"""

from typing import Annotated

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
from jaxstab.potentials import energy_density
from jaxstab.solids.viscoelastic import decay, ramp

_NODES, _WEIGHTS = (values / 2 for values in np.polynomial.legendre.leggauss(8))
_NODES = _NODES + 0.5


class Internal(eqx.Module):
    """All that a viscoelastic contact remembers, on the grid that it is solved on.

    Attributes:
        gap: g [length].
        deformation: w, the displacement relative to the far side [length].
        branches: v_k, the elastic displacement of each branch [length].
    """

    gap: Annotated[Field, LENGTH]
    deformation: Annotated[Field, LENGTH]
    branches: Annotated[Float[Array, " terms_and_grid"], LENGTH]


class Medium(eqx.Module):
    """A contact with its memory.

    Attributes:
        contact: that of the relaxed solid, on the grid that it is solved on.
        ratios: r_k.
        times: t_k [time].
    """

    contact: Contact
    ratios: Float[Array, " terms"]
    times: Float[Array, " terms"]

    @property
    def uniform_stiffness(self) -> Scalar:
        """K at q = 0, zero where the mean has no memory [pressure/length]."""
        stiffness = self.contact.solid.uniform_stiffness
        return jnp.where(jnp.isfinite(stiffness), stiffness, 0).astype(self.contact.heights.dtype)

    def pressure_of(self, field: Field) -> Field:
        """Return K of a displacement relative to the far side [pressure]."""
        level = mean(field)
        waves = self.contact.solid.with_uniform_stiffness(0).apply(field - level)
        return waves + self.uniform_stiffness * level

    def moved(self, memory: Internal, dt: Scalar) -> Contact:
        """Return the elastic contact of a step from a state: K_step on h + m."""
        kept = self.ratios * ramp(dt, self.times)
        stiffening = 1 + jnp.sum(kept)
        left = jnp.tensordot(self.ratios * decay(dt, self.times), memory.branches, 1)
        height = (left - jnp.sum(kept) * memory.deformation) / stiffening
        contact = self.contact
        return eqx.tree_at(
            lambda contact: (contact.solid, contact.heights),
            contact,
            (contact.solid.scaled(stiffening), contact.heights + height),
        )

    def load_on(self, moved: Contact, load: Load) -> Load:
        """Return a load as it holds the moved surface: a mean displacement moves along."""
        if not isinstance(load, MeanDisplacement):
            return load
        return load.at(load.value + mean(moved.heights - self.contact.heights))

    def advance(
        self, memory: Internal, load: Load, dt: Scalar
    ) -> tuple[Internal, Equilibrium, Scalar]:
        """Return the state after a step, its elastic equilibrium, and the place of the far side.

        The equilibrium is differentiable, and so is all that follows from it.
        """
        moved = self.moved(memory, dt)
        held = self.load_on(moved, load)
        solver = PreconditionedConjugateGradient()
        found = find_equilibrium(*jax.lax.stop_gradient((moved, held, solver, memory.gap)))
        found = with_derivatives(moved, held, found)
        stiffness = self.uniform_stiffness * moved.solid.max_stiffness
        stiffness = stiffness / self.contact.solid.max_stiffness
        height = mean(moved.heights - self.contact.heights)
        has_mean = stiffness > 0
        level = mean(found.pressure) / jnp.where(has_mean, stiffness, 1) - height
        level = jnp.where(has_mean, level, 0)
        displacement = found.gap + self.contact.heights
        far = mean(displacement) - level
        deformation = displacement - far
        shares = decay(dt, self.times), ramp(dt, self.times)
        e, b = (share.reshape(-1, *(1,) * deformation.ndim) for share in shares)
        branches = e * memory.branches + b * (deformation - memory.deformation)
        return Internal(found.gap, deformation, branches), found, far

    def adhesion(self, gap: Field) -> Scalar:
        """Return sum f(g) over the surface [energy]."""
        density = energy_density(self.contact.potential, gap)
        return total(density) * self.contact.grid.cell_area.astype(density.dtype)


class Forms(eqx.Module):
    """The quadratic forms of K on the deformation and on each branch [energy].

    Attributes:
        deformation: w.Kw.
        branches: v_k.K v_k.
    """

    deformation: Scalar
    branches: Float[Array, " terms"]

    @classmethod
    def of(cls, medium: Medium, memory: Internal) -> "Forms":
        """Return the forms of a state."""
        cell = medium.contact.grid.cell_area.astype(memory.gap.dtype)

        def form(field: Field) -> Scalar:
            return cell * total(field * medium.pressure_of(field))

        return cls(form(memory.deformation), jnp.stack([form(v) for v in memory.branches]))

    def energy(self, medium: Medium) -> Scalar:
        """Return the elastic energy of the springs: w.Kw / 2 + sum r_k v_k.K v_k / 2 [energy]."""
        return (self.deformation + jnp.sum(medium.ratios * self.branches)) / 2

    def after(
        self, medium: Medium, old: Internal, new: Internal, dt: Scalar
    ) -> tuple["Forms", Scalar]:
        """Return the forms after a step, and the energy that its dashpots dissipate.

        The rate is sum r_k v_k.K v_k / t_k. With x = dt / t_k and s = dt * theta, a branch is at
        v_k exp(-x theta) + dw theta ramp(x theta): the integral of its square is in closed form.
        """
        change = new.deformation - old.deformation
        cell = medium.contact.grid.cell_area.astype(change.dtype)
        pressure = cell * medium.pressure_of(change)
        square, mixed = total(change * pressure), total(old.deformation * pressure)
        cross = jnp.stack([total(v * pressure) for v in old.branches])
        e, b = decay(dt, medium.times), ramp(dt, medium.times)
        forms = Forms(
            self.deformation + 2 * mixed + square,
            e**2 * self.branches + 2 * e * b * cross + b**2 * square,
        )
        x = dt / medium.times
        left, both, gained = _integrals(x)
        rate = left * self.branches + 2 * both * cross + gained * square
        return forms, jnp.sum(medium.ratios * x * rate)


def _integrals(x: Float[Array, " terms"]) -> tuple[Array, Array, Array]:
    """Return the integrals over theta in (0, 1) of a^2, a c and c^2.

    a = exp(-x theta) and c = theta ramp(x theta): in closed form, but by quadrature for small x,
    where the closed form loses its digits.
    """
    theta = jnp.asarray(_NODES, x.dtype)
    turns = x[:, None] * theta
    fall, rise = jnp.exp(-turns), theta * ramp(turns, jnp.ones((), x.dtype))
    weights = jnp.asarray(_WEIGHTS, x.dtype)
    near = fall**2 @ weights, (fall * rise) @ weights, rise**2 @ weights
    y = jnp.maximum(x, 1)
    once, twice = -jnp.expm1(-y) / y, -jnp.expm1(-2 * y) / (2 * y)
    away = twice, (once - twice) / y, (1 - 2 * once + twice) / y**2
    return tuple(jnp.where(x < 1, n, a) for n, a in zip(near, away, strict=True))  # pyright: ignore[reportReturnType]
