"""Proofs of verdicts: against every face of the cone and dense algebra, and as they are told."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import (
    dense_hessian,
    matrix_of,
    periodic_stiffness,
    smallest_on_cone,
    smallest_on_zero_mean,
)
from problems import DenseSolid, rough_contact, state_of

import jaxstab as js

SHAPE = (4, 4)


def nearly_closed(seed, load=js.MeanGap):
    """Return a contact closed but for three to six points, softer than its softest waves."""
    random = np.random.default_rng(seed)
    gap = np.zeros(SHAPE)
    open_points = random.choice(gap.size, random.integers(3, 7), replace=False)
    gap.flat[open_points] = random.uniform(0.05, 0.5, open_points.size)
    solid = js.HalfSpace(js.Grid(SHAPE), 1.0)
    length = 0.3
    energy = random.uniform(0.9, 1.6) * float(solid.min_stiffness) * length**2
    law = js.potentials.Exponential(energy, length)
    contact = js.Contact(solid, np.zeros(SHAPE), law)
    return state_of(contact, jnp.asarray(gap), reaction=1.0, load=load)


@pytest.fixture(scope="module")
def judged():
    problems = [nearly_closed(seed) for seed in range(13)]
    return [(*problem, js.assess_stability(*problem)) for problem in problems]


def test_a_bound_is_never_above_the_minimum_and_proves_what_the_lower_bound_does_not(judged):
    certified = 0
    for contact, state, stability in judged:
        matrix = dense_hessian(contact, state.gap)
        exact = smallest_on_cone(matrix, np.asarray(state.in_contact).ravel())
        rounding = 1e-12 * np.linalg.norm(matrix, 2)
        assert stability.cone.bound <= exact + rounding
        if stability.cone.proved:
            np.testing.assert_allclose(stability.cone.eigenvalue, exact, atol=stability.cone.error)
        if stability.verdict == "stable" and stability.proved:
            assert exact > 0
        certified += bool(stability.lower_bound.eigenvalue < 0 < stability.cone.bound)
        below = smallest_on_zero_mean(matrix) - stability.lower_bound.bound
        assert -rounding <= below <= 2 * stability.lower_bound.error + rounding
    assert certified >= 5


def test_a_certificate_is_the_least_eigenvalue_of_a_stiffened_matrix(judged):
    stiffness = periodic_stiffness(SHAPE, (1.0, 1.0), 1.0)
    values, waves = np.linalg.eigh(stiffness)
    certified = [x for x in judged if x[2].lower_bound.eigenvalue < 0 < x[2].cone.bound]
    for contact, state, stability in certified:
        touches = np.asarray(state.in_contact).ravel()
        hessian = dense_hessian(contact, state.gap)
        adhesion = np.mean(np.diag(hessian - stiffness)[touches])
        for share in (0.5, 0.25):
            level = share * float(stability.cone.eigenvalue) - adhesion
            kernel = waves * np.maximum(level - values, 0) @ waves.T
            softening = (kernel[0, 0] - kernel) * np.outer(touches, touches)
            assert softening.min() > -1e-12
            least = smallest_on_zero_mean(hessian - softening)
            if least > 0:
                break
        assert 0 <= least - stability.cone.bound < 1e-5 * np.linalg.norm(hessian, 2)


def test_what_is_only_found_is_said_to_hold_locally(judged):
    found = [s for _, _, s in judged if s.verdict == "stable" and not s.proved]
    proved = [s for _, _, s in judged if s.verdict == "stable" and s.proved]
    assert found and proved
    _, state, stability = next(x for x in judged if x[2] is found[0])
    sweep = js.results.Sweep(state.load, state, stability)
    assert "stable, locally" in repr(sweep)
    assert "proved           False" in repr(stability)


@pytest.mark.nightly
def test_on_a_linear_space_and_by_a_mode_the_verdict_is_proved():
    contact = rough_contact(32, js.potentials.Exponential(0.06, 0.06), rms_height=0.05)
    states = {g: js.equilibrate(contact, js.MeanGap(g)) for g in (0.1, 0.5)}
    held, apart = (js.assess_stability(contact, state) for state in states.values())
    assert held.verdict == "held_by_contact" and held.proved and held.critical.proved
    assert apart.verdict == "stable" and apart.proved
    assert all(pair.proved for pair in apart.pairs.values())
    modes = js.lowest_modes(contact, states[0.1], 3)
    assert modes.proved.all() and (modes.bound <= modes.eigenvalue).all()
    failed = js.assess_stability(
        contact, states[0.1], js.solvers.ProjectedLOBPCG(max_steps=1), throw=False
    )
    assert not failed.cone.proved and not failed.proved


@pytest.mark.nightly
def test_proofs_are_the_same_in_a_batch_and_in_single_precision():
    problems = [nearly_closed(seed, load=js.MeanPressure) for seed in range(4)]
    alone = [js.assess_stability(*problem) for problem in problems]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *problems)
    batch = jax.vmap(lambda contact, state: js.assess_stability(contact, state, throw=False))(
        *stacked
    )
    np.testing.assert_array_equal(batch.proved, [s.proved for s in alone])
    for name in ("lower_bound", "cone", "critical"):
        np.testing.assert_allclose(
            getattr(batch, name).bound, [getattr(s, name).bound for s in alone], rtol=1e-5
        )
    contact, state = jax.tree.map(
        lambda leaf: leaf.astype(jnp.float32) if leaf.dtype == jnp.float64 else leaf,
        nearly_closed(0),
    )
    single = js.assess_stability(contact, state, throw=False)
    double = js.assess_stability(*nearly_closed(0))
    assert single.cone.bound <= double.cone.bound + 1e-3 * abs(double.cone.eigenvalue)


def test_a_solid_without_waves_has_no_certificate_but_a_verdict(judged):
    contact, state, stability = next(x for x in judged if x[2].cone.bound > 0)
    solid = contact.solid
    matrix = jnp.asarray(matrix_of(solid.apply, SHAPE))
    dense = DenseSolid(solid.grid, matrix, solid.max_stiffness, solid.min_stiffness)
    again = js.assess_stability(js.Contact(dense, contact.heights, contact.potential), state)
    np.testing.assert_allclose(again.cone.eigenvalue, stability.cone.eigenvalue, rtol=1e-6)
    assert again.verdict == "stable" and not again.proved
