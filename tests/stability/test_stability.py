import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import dense_hessian, smallest_on_zero_mean
from problems import Waves, rough_contact, state_of

import jaxstab as js


def check_admissible(pair, in_contact):
    mode = np.asarray(pair.mode)
    np.testing.assert_allclose(np.linalg.norm(mode), 1)
    assert abs(mode.sum()) < 1e-10
    assert mode[np.asarray(in_contact)].min(initial=0) >= 0


def test_hertz_without_contact_equals_a_dense_eigensolver(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.302))
    stability = js.assess_stability(hertz, equilibrium)
    assert stability.cone.eigenvalue == pytest.approx(0.1634, abs=5e-5)
    exact = smallest_on_zero_mean(dense_hessian(hertz, equilibrium.gap))
    assert stability.cone.eigenvalue == pytest.approx(exact, abs=1e-6)
    assert stability.verdict == js.VERDICTS.stable
    assert stability.cone.error < 1e-4


def random_state(contact, seed, touching):
    """Return a contact and a state of it with a random gap, and so a random D."""
    keys = jax.random.split(jax.random.key(seed))
    gap = jax.random.uniform(keys[0], (16, 16), minval=0.01)
    return state_of(contact, jnp.where(jax.random.uniform(keys[1], gap.shape) < touching, 0.0, gap))


@pytest.mark.nightly
def test_adhesion_that_outweighs_the_stiffness_everywhere_does_not_upset_it():
    contact, state = random_state(rough_contact(16, Waves(70.0, 3.0)), 3, 0)
    pair = js.assess_stability(contact, state).cone
    exact = smallest_on_zero_mean(dense_hessian(contact, state.gap))
    assert contact.solid.max_stiffness < 50 < -exact
    assert pair.eigenvalue == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("touching", [0.05, 0.5, 0.95])
def test_with_contact_the_answer_is_admissible_and_optimal(touching):
    contact = rough_contact(16, Waves(1.0, 3.0))
    contact, state = random_state(contact, 1, touching)
    pair = js.assess_stability(contact, state).cone
    check_admissible(pair, state.in_contact)
    matrix = dense_hessian(contact, state.gap)
    mode = np.asarray(pair.mode).ravel()
    np.testing.assert_allclose(mode @ matrix @ mode, pair.eigenvalue, rtol=1e-9)
    # Optimality on the cone, by hand: A x - lambda x balances z e + y, y >= 0 where x = 0.
    free = mode > 0
    free |= ~np.asarray(state.in_contact).ravel()
    force = matrix @ mode - float(pair.eigenvalue) * mode
    multiplier = force[free].mean()
    scale = np.abs(np.linalg.eigvalsh(matrix)).max()
    assert np.linalg.norm(force[free] - multiplier) < 1e-6 * scale
    assert (force[~free] - multiplier).min(initial=0) > -1e-6 * scale
    # The eigenvalue lies above the lower bound.
    assert smallest_on_zero_mean(matrix) <= pair.eigenvalue + 1e-9 * scale


def test_it_converges_near_full_contact(unloading):
    equilibrium = js.equilibrate(unloading, js.MeanGap(1e-5))
    assert 0.9 < equilibrium.contact_area < 1
    stability = js.assess_stability(unloading, equilibrium)
    assert stability.cone.eigenvalue > 0
    assert stability.verdict == js.VERDICTS.stable


def test_histories_of_algorithm_1_show_all_indicators_falling(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.2))
    pair = js.assess_stability(hertz, equilibrium, js.ProximalIteration()).cone
    steps = np.asarray(pair.history.steps)
    records = int(np.isfinite(steps).sum())
    assert steps[records - 1] == pair.num_steps
    for name in ("residual", "epsilon", "eta"):
        values = np.asarray(pair.history.values[name])
        assert np.isfinite(values[:records]).all()
        assert np.isnan(values[records:]).all()
        assert values[records - 1] < 1e-4 * values[:3].max()
    assert pair.residual <= pair.history.values["residual"][records - 1] <= 1e-7


def test_algorithm_1_takes_the_steps_that_its_condition_allows(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.2))
    # A law that attracts at all gaps adds nothing to the bound on |A|.
    beta = float(hertz.solid.max_stiffness)
    default = js.assess_stability(hertz, equilibrium, js.ProximalIteration()).cone
    given = js.ProximalIteration(tau=1 / beta, sigma=beta / 2)
    pair = js.assess_stability(hertz, equilibrium, given).cone
    assert pair.eigenvalue == pytest.approx(-4.5537, abs=5e-5)
    assert pair.num_steps == default.num_steps
    long = js.ProximalIteration(tau=1.1 / beta, sigma=beta / 2)
    with pytest.raises(js.exceptions.SolverError, match=r"long_steps.*Lower `tau` or `sigma`"):
        js.assess_stability(hertz, equilibrium, long)
    with pytest.raises(ValueError, match=r"tau is -1\.0"):
        js.ProximalIteration(tau=-1.0)


def test_a_step_limit_raises_or_is_coded(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.302))
    solver = js.ProximalIteration(max_steps=50)
    with pytest.raises(
        js.exceptions.SolverError,
        match=r"cone eigenvalue.*after 50 steps.*residual is.*max_steps_reached",
    ):
        js.assess_stability(hertz, equilibrium, solver)
    stability = js.assess_stability(hertz, equilibrium, solver, throw=False)
    assert stability.cone.result == js.RESULTS.max_steps_reached
    assert stability.verdict == js.VERDICTS.undecided


def test_a_verdict_needs_an_error_smaller_than_the_eigenvalue(hertz):
    equilibrium = js.equilibrate(hertz, js.MeanDisplacement(1.2976))
    solver = js.solvers.ProjectedLOBPCG(tolerance=1e-2)
    stability = js.assess_stability(hertz, equilibrium, solver)
    assert 0 < stability.cone.eigenvalue < stability.cone.error
    assert stability.verdict == js.VERDICTS.undecided


def test_a_failed_equilibrium_is_not_assessed(hertz):
    failed = js.equilibrate(hertz, js.MeanGap(-1.0), throw=False)
    with pytest.raises(
        js.exceptions.SolverError, match="There is nothing to assess: no_equilibrium"
    ):
        js.assess_stability(hertz, failed)
    with pytest.raises(ValueError, match=r"state was not found \(infeasible_load\)"):
        js.equilibrate(hertz, js.MeanGap(1.0), initial=failed)
    stability = js.assess_stability(hertz, failed, throw=False)
    assert stability.cone.result == js.RESULTS.no_equilibrium
    assert stability.verdict == js.VERDICTS.undecided
    assert np.isnan(stability.cone.eigenvalue)


def test_an_equilibrium_of_another_grid_is_refused(hertz, unloading):
    other = js.equilibrate(rough_contact(16, js.potentials.NoAdhesion()), js.MeanGap(1.0))
    with pytest.raises(ValueError, match=r"\(16, 16\).*\(32, 32\)"):
        js.assess_stability(hertz, other)


def test_the_eigenvalue_is_the_second_difference_of_the_energy_along_the_mode(unloading):
    equilibrium = js.equilibrate(unloading, js.MeanGap(0.5))
    pair = js.assess_stability(unloading, equilibrium).cone
    assert pair.eigenvalue < 0
    amplitude = 1e-4 / float(jnp.abs(pair.mode).max())
    area = float(unloading.grid.cell_area)

    def energy(t):
        return float(unloading.energy(equilibrium.gap + t * pair.mode)) / area

    second = (energy(amplitude) - 2 * energy(0) + energy(-amplitude)) / amplitude**2
    assert second == pytest.approx(float(pair.eigenvalue), rel=1e-3)
