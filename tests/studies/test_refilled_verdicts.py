"""Verdicts in lanes are those of single contacts, with all that is known of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.stability import coarse_start
from jaxstab.studies.lanes.scheduler import Lanes

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


def assert_lanes_find_what_is_found_alone(case, cases, width):
    """Return the names of the verdicts, found in lanes by the same steps as alone."""
    left = list(cases)

    def take(number, waits):
        taken, left[:] = left[:number], left[number:]
        columns = {name: np.array([row[i] for row in taken]) for i, name in enumerate(NAMES)}
        return taken, columns

    lanes = Lanes(case.programs(), width, take)
    found = {values: outputs for values, outputs, _ in lanes.run()}
    assert 0 < lanes.useful < lanes.paid
    for values in cases:
        alone, here = case(**dict(zip(NAMES, values, strict=True))), found[values]
        for name in ("verdict", "proved", "assessed"):
            assert here[name] == alone[name]
        # Each within its own error, and by the same steps.
        off = np.abs(here["eigenvalues"] - alone["eigenvalues"])
        assert (off <= here["errors"] + alone["errors"]).all() or here["verdict"] == "undecided"
        np.testing.assert_allclose(here["bound"], alone["bound"], rtol=1e-6)
        np.testing.assert_array_equal(here["steps"], alone["steps"])
    return [str(found[values]["verdict"]) for values in cases]


@pytest.mark.nightly
def test_verdicts_in_lanes_are_those_found_alone():
    verdicts = assert_lanes_find_what_is_found_alone(js.cases.verdict(rough, summary), CASES, 4)
    assert verdicts == ["stable", "stable", "held_by_contact", "held_by_contact", "undecided"]


@pytest.mark.nightly
def test_on_a_large_grid_lanes_start_from_the_coarser_one_too(monkeypatch):
    jax.clear_caches()
    monkeypatch.setattr(coarse_start, "_LARGE", GRID.size)
    monkeypatch.setattr(coarse_start, "_FEWEST", GRID.size // 4)
    # The coarser mode is trusted in the first, and not in the second.
    cases = [(5, 0.003, 0.08), (1, 0.02, 0.02)]
    verdicts = assert_lanes_find_what_is_found_alone(js.cases.verdict(rough, summary), cases, 2)
    assert verdicts == ["stable", "held_by_contact"]
    jax.clear_caches()
