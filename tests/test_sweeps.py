import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js

LOADS = jnp.linspace(1e-5, 2.0, 32)


@pytest.fixture(scope="module")
def independent(unloading):
    return js.sweep(unloading, js.MeanGap(LOADS))


def assert_same(left, right, **options):
    for a, b in zip(jax.tree.leaves(left), jax.tree.leaves(right), strict=True):
        if jnp.issubdtype(a.dtype, jnp.inexact):
            np.testing.assert_allclose(a, b, **options)
        else:
            np.testing.assert_array_equal(a, b)


def test_a_sweep_equals_single_solves(unloading, independent):
    singles = [js.equilibrate(unloading, js.MeanGap(value)) for value in LOADS]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *singles)
    scale = float(jnp.abs(stacked.gap).max())
    for name in ("gap", "displacement", "pressure", "reaction"):
        swept, single = getattr(independent.equilibrium, name), getattr(stacked, name)
        np.testing.assert_allclose(swept, single, rtol=0, atol=1e-12 * scale)
    assert (independent.equilibrium.num_steps == stacked.num_steps).all()
    assessed = [js.assess_stability(unloading, single) for single in singles]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *assessed)
    assert (independent.stability.verdict == stacked.verdict).all()
    for swept, single in zip(
        independent.stability.pairs.values(), stacked.pairs.values(), strict=True
    ):
        np.testing.assert_allclose(swept.eigenvalue, single.eigenvalue, rtol=0, atol=1e-9)
        assert (swept.num_steps == single.num_steps).all()


def test_an_entry_of_a_sweep_is_a_state_like_any_other(unloading, independent):
    state = independent[9]
    single = js.equilibrate(unloading, js.MeanGap(LOADS[9]))
    shapes = lambda tree: jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), tree)  # noqa: E731
    assert shapes(state.equilibrium) == shapes(single)
    stability = js.assess_stability(unloading, state)
    assert shapes(state.stability) == shapes(stability)
    assert independent.stability.verdict[9] == stability.verdict.name
    back = js.release(unloading, state, state.stability.cone.mode)
    np.testing.assert_allclose(back.gap, single.gap, atol=1e-7)


@pytest.mark.parametrize("bad", [-1.0, 0.0, np.nan])
def test_an_impossible_load_leaves_the_others_identical(unloading, independent, bad):
    loads = js.MeanGap(LOADS.at[11].set(bad))
    spoilt = js.sweep(unloading, loads)
    others = np.delete(np.arange(32), 11)
    keep = lambda tree: jax.tree.map(lambda leaf: np.asarray(leaf)[others], tree)  # noqa: E731
    assert_same(keep(spoilt), keep(independent), rtol=0, atol=0)
    failed = spoilt[11]
    assert failed.equilibrium.result == "infeasible_load"
    assert failed.stability.cone.result == "no_equilibrium"
    assert failed.stability.verdict == "undecided"
    assert np.isnan(failed.equilibrium.gap).all()


def test_the_unloading_study_is_stable_at_both_ends_only(unloading, independent):
    stable = np.asarray(independent.stability.verdict == js.VERDICTS.stable)
    area = np.asarray(independent.equilibrium.contact_area)
    assert area[0] > 0.95
    assert stable[0]
    assert stable[area == 0].all()
    partial = (area > 0.05) & (area < 0.7)
    assert partial.sum() > 5
    held = np.asarray(independent.stability.verdict == js.VERDICTS.held_by_contact)
    assert held[partial].all()


def test_continuation_starts_each_load_from_the_last(unloading):
    loads = js.MeanGap(LOADS[::4])
    swept = js.sweep(unloading, loads, order="continuation")
    last = None
    for i, value in enumerate(loads.value):
        last = js.equilibrate(unloading, js.MeanGap(value), initial=last)
        np.testing.assert_allclose(swept.equilibrium.gap[i], last.gap, atol=1e-10)
        assert swept.equilibrium.num_steps[i] == last.num_steps


def test_continuation_passes_over_a_load_that_fails(unloading):
    values = jnp.array([0.2, -1.0, 0.4])
    swept = js.sweep(unloading, js.MeanGap(values), order="continuation")
    failed = swept.equilibrium.result == js.RESULTS.infeasible_load
    np.testing.assert_array_equal(failed, [False, True, False])
    first = js.equilibrate(unloading, js.MeanGap(0.2))
    third = js.equilibrate(unloading, js.MeanGap(0.4), initial=first)
    np.testing.assert_allclose(swept.equilibrium.gap[2], third.gap, atol=1e-10)


def test_continuation_follows_a_branch_that_independent_solves_leave(hertz):
    loads = js.MeanDisplacement(jnp.array([1.2, 1.302]))
    touching = js.sweep(hertz, loads, order="continuation").equilibrium.contact_area
    apart = js.sweep(hertz, loads).equilibrium.contact_area
    assert touching[1] > 0
    assert apart[1] == 0


@pytest.mark.parametrize("order", ["independent", "continuation"])
def test_a_progress_bar_counts_to_the_end_and_changes_nothing(unloading, capfd, order):
    loads = js.MeanGap(LOADS[::8])
    options = {"order": order}
    silent = js.sweep(unloading, loads, **options)
    assert capfd.readouterr().err == ""
    shown = js.sweep(unloading, loads, progress=True, **options)
    assert "4/4" in capfd.readouterr().err
    assert_same(silent, shown, rtol=0, atol=0)


def test_a_sweep_raises_only_if_asked(unloading):
    loads = js.MeanGap(jnp.array([0.2, -1.0]))
    with pytest.raises(js.SolverError, match=r"1 of 2 loads.*MeanGap\(-1\).*infeasible_load"):
        js.sweep(unloading, loads, throw=True)


def test_sweeps_that_make_no_sense_are_refused(unloading):
    with pytest.raises(ValueError, match=r"shape \(\).*equilibrate"):
        js.sweep(unloading, js.MeanGap(1.0))
    with pytest.raises(ValueError, match="order is 'backwards'"):
        js.sweep(unloading, js.MeanGap(LOADS), order="backwards")
    with pytest.raises(ValueError, match=r"\(3, 3\).*\(32, 32\)"):
        js.sweep(unloading, js.MeanGap(LOADS), initial=jnp.ones((3, 3)))
