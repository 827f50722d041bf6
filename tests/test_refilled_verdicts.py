"""Verdicts in lanes are those of single contacts, with all that is known of them."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxstab as js
from jaxstab.refill import Lanes

GRID = js.Grid(16)
# Stable without contact, stable by a bound that is proved, held by contact, and no equilibrium.
CASES = [(0, 0.003, 0.2), (0, 0.003, 0.06), (1, 0.02, 0.02), (2, 0.08, 0.2), (0, 0.003, -1.0)]
NAMES = ("seed", "energy", "gap")


def rough(seed, energy, gap):
    heights = js.surfaces.self_affine(GRID, jax.random.key(seed), k_high=4, rms_height=0.05)
    law = js.potentials.Exponential(energy, 0.05)
    return js.Contact(js.HalfSpace(GRID, 1.0), heights, law), js.MeanGap(gap)


def summary(contact, equilibrium, stability):
    pairs = stability.pairs.values()
    return {
        "eigenvalues": jnp.stack([pair.eigenvalue for pair in pairs]),
        "errors": jnp.stack([pair.error for pair in pairs]),
        "steps": jnp.stack([pair.num_steps for pair in pairs]),
        "bound": stability.cone.bound,
        "verdict": stability.verdict,
        "proved": stability.proved,
        "assessed": stability.result,
    }


def test_verdicts_in_lanes_are_those_found_alone():
    case, left = js.cases.verdict(rough, summary), list(CASES)

    def take(number, waits):
        taken, left[:] = left[:number], left[number:]
        columns = {name: np.array([row[i] for row in taken]) for i, name in enumerate(NAMES)}
        return taken, columns

    lanes = Lanes(case.programs(), 4, take)
    found = {values: outputs for values, outputs, _ in lanes.run()}
    assert 0 < lanes.tally.useful < lanes.tally.paid
    verdicts = [str(found[values]["verdict"]) for values in CASES]
    assert verdicts == ["stable", "stable", "held_by_contact", "held_by_contact", "undecided"]
    for values in CASES:
        alone, here = case(**dict(zip(NAMES, values, strict=True))), found[values]
        for name in ("verdict", "proved", "assessed"):
            assert here[name] == alone[name]
        # Each within its own error, and by the same steps.
        off = np.abs(here["eigenvalues"] - alone["eigenvalues"])
        assert (off <= here["errors"] + alone["errors"]).all() or here["verdict"] == "undecided"
        np.testing.assert_allclose(here["bound"], alone["bound"], rtol=1e-6)
        np.testing.assert_array_equal(here["steps"], alone["steps"])
