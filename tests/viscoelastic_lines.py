"""Viscoelastic contacts of a line, small enough for many histories."""

import jax.numpy as jnp

import jaxstab as js

RATIOS, TIMES = (2.0, 1.0), (0.1, 1.0)
# A tolerance that no step misses: a step for each of the given times.
ANY = 1e9


def line(n=32, length=1.0, height=0.02):
    return js.Grid((n,), length), height * jnp.cos(2 * jnp.pi * jnp.arange(n) / n + 0.3)


def viscoelastic(ratios=RATIOS, times=TIMES, energy=0.002, n=32, length=1.0, heights=None):
    grid, wave = line(n, length)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0), ratios, times)
    law = js.potentials.Exponential(energy, 0.02)
    heights = wave if heights is None else heights
    return js.Contact(solid, heights, law, unit="µm", pressure_unit="MPa")


def relaxed_of(contact):
    return js.Contact(contact.solid.relaxed, contact.heights, contact.potential)


def cycle(number=21, period=4.0, top=0.05, bottom=0.01):
    """Return times, and values that fall and rise again, at equal distances."""
    times = jnp.linspace(0, period, number)
    return times, top - (top - bottom) * (1 - jnp.abs(2 * times / period - 1))
