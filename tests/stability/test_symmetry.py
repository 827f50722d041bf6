"""Unstable states that a symmetric start has led to."""

import warnings

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxstab as js
from jaxstab.stability.symmetry import warn_of_symmetry

LAW = js.potentials.Exponential(0.02, 0.05)
PATTERN = 0.05 * np.cos(2 * np.pi * (np.arange(16) + 0.5) / 16)
NOISE = np.random.default_rng(0).normal(size=16)
GRID = js.Grid((16,), 1.0)


def pressed(surface):
    contact = js.Contact(js.HalfSpace(surface.grid, 1.0), surface, LAW)
    return contact, js.equilibrate(contact, js.MeanGap(0.02))


def mirrored(heights):
    return js.surfaces.Topography(GRID, heights).periodic("mirror")


def repeated(heights):
    grid = js.Grid((32,), 2.0)
    return js.surfaces.Topography(grid, np.tile(heights, 2), is_periodic=True)


@pytest.mark.parametrize(
    ("surface", "symmetry"),
    [
        (mirrored(PATTERN), "a mirror image along x"),
        (mirrored(PATTERN + 0.002 * NOISE), "a mirror image along x"),
        (repeated(PATTERN + 0.002 * NOISE), "a period along x"),
    ],
)
def test_a_state_that_its_symmetry_keeps_in_a_saddle_is_named_with_a_cure(surface, symmetry):
    contact, state = pressed(surface)
    with pytest.warns(
        js.exceptions.SymmetryWarning, match=rf"mode breaks .*: {symmetry}\..*jaxstab\.relax_along"
    ):
        stability = js.assess_stability(contact, state)
    assert stability.verdict == js.VERDICTS.unstable
    released = js.relax_along(contact, state, stability.critical.mode)
    assert released.energy < state.energy - 1e-6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert js.assess_stability(contact, released).verdict != js.VERDICTS.unstable
        # In a trace nothing is known.
        jax.eval_shape(js.assess_stability, contact, state)
        # The mode breaks no symmetry where there is none, and where the surface alone has one.
        tilted = contact.heights.at[3].add(1e-3)
        other = eqx.tree_at(lambda contact: contact.heights, contact, tilted)
        warn_of_symmetry(other, state, stability)
        warn_of_symmetry(contact, released, stability)
