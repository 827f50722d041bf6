"""Contacts that several tests share, and states that are made or found by other means."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp

import jaxstab as js
from jaxstab import potentials
from jaxstab.core.history import History
from jaxstab.core.units import Units

# For comparisons with finite differences.
TIGHT = js.solvers.PreconditionedConjugateGradient(tolerance=1e-12)


def with_units(detachment):
    """Return a detachment on a line in nm and MPa; a contact with units would compile anew."""
    state = replace(detachment.pull_off, units=Units("nm", "MPa", sides=1))
    return replace(detachment, pull_off=state)


def with_room(sequence):
    """Return a path or a branch with five empty entries in each table, as `jax.jit` returns it."""

    def empty(leaf):
        fill = jnp.nan if leaf.dtype.kind == "f" else 0
        rest = jnp.full((5, *leaf.shape[1:]), fill, leaf.dtype)
        return jnp.concatenate([leaf, rest])

    names = "load", "equilibrium", "index", "jumps", "turns"
    tables = {name: getattr(sequence, name) for name in names if hasattr(sequence, name)}
    return replace(sequence, **jax.tree.map(empty, tables))


class Waves(eqx.Module):
    """The law -strength cos(number g), whose curvature has either sign."""

    strength: jax.Array
    number: jax.Array

    def __init__(self, strength, number=1.0):
        self.strength, self.number = jnp.asarray(strength), jnp.asarray(number)

    def __call__(self, gap):
        return -self.strength * jnp.cos(self.number * gap)


class Parabola(eqx.Module):
    """The law -stiffness g^2 / 2."""

    stiffness: jax.Array = eqx.field(converter=jnp.asarray)

    def __call__(self, gap):
        return -self.stiffness * gap**2 / 2


class Linear(eqx.Module):
    """The law slope g, whose attraction is the same at every gap."""

    slope: jax.Array = eqx.field(converter=jnp.asarray)

    def __call__(self, gap):
        return self.slope * gap


class DenseSolid(js.solids.Solid):
    """A solid given by its matrix, of which constants are an eigenvector."""

    grid: js.Grid
    matrix: jax.Array
    max_stiffness: jax.Array
    min_stiffness: jax.Array

    def apply(self, displacement):
        return (self.matrix @ displacement.ravel()).reshape(displacement.shape)

    def precondition(self, shift):
        inverse = 1 / (jnp.diagonal(self.matrix) + shift)
        return lambda field: inverse.reshape(field.shape) * field


def rough_contact(n, potential, youngs_modulus=1.0, seed=0, rms_height=0.1):
    grid = js.Grid(n)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(seed), k_high=min(32, n // 4), rms_height=rms_height
    )
    return js.Contact(js.HalfSpace(grid, youngs_modulus), heights, potential)


def flat_contact(law):
    grid = js.Grid(8)
    return js.Contact(js.HalfSpace(grid, 1.0), jnp.zeros(grid.shape), law)


def sphere_on_window():
    """Return a sphere in a window, whose law attracts a part of it."""
    grid = js.Grid(8, (1.0, 1.0))
    sphere = js.surfaces.paraboloid(grid, radius=1.5)
    return js.Contact(js.FreeHalfSpace(grid, 1.0), sphere, potentials.Gaussian(0.05, 0.3))


def bisected(contact, load, start, step, holds=lambda state: True, resolution=1e-9):
    """Return the last load at which a warm-started equilibrium holds, by ever smaller steps."""
    state, value = js.equilibrate(contact, load(start)), start
    while abs(step) > resolution:
        new = js.equilibrate(contact, load(value + step), initial=state, throw=False)
        if new.result == "successful" and holds(new):
            state, value = new, value + step
        else:
            step /= 2
    return value


def with_parameters(contact, energy, length, modulus):
    solid = js.HalfSpace(contact.grid, modulus)
    return js.Contact(solid, contact.heights, js.potentials.Exponential(energy, length))


# One program, and not two dozen small ones for each shape.
@partial(jax.jit, static_argnames="load")
def state_of(contact, gap, reaction=1.0, load=js.MeanGap):
    """Return a contact with the same Hessian at a gap, and that gap as its equilibrium.

    The heights are such that the elastic pressure balances reaction and attraction.
    """
    touches = gap == 0
    reaction = jnp.where(touches, reaction, 0.0)
    pressure = reaction - potentials.slope(contact.potential, gap)
    displacement = contact.solid.displacement(pressure)
    contact = eqx.tree_at(lambda contact: contact.heights, contact, displacement - gap)
    mean_pressure = jnp.mean(pressure)
    state = js.results.Equilibrium(
        load=load(mean_pressure if load is js.MeanPressure else jnp.mean(gap)),
        displacement=displacement,
        gap=gap,
        pressure=pressure,
        reaction=reaction,
        in_contact=touches,
        mean_pressure=mean_pressure,
        contact_area=jnp.mean(touches),
        area=contact.grid.area,
        energy=contact.energy(gap),
        residual=jnp.array(1e-9),
        num_steps=jnp.array(0),
        result=js.RESULTS.successful,
        history=History.empty(["residual"]),
    )
    return contact, state


def lennard_jones_force(separation, energy, length):
    x = length / separation
    return energy / 2 * 9 * (x**4 - x**10) / length
