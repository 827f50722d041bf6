import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact
from programs import compilations, on_the_cpu
from saved import assert_same_bits

import jaxstab as js
from jaxstab.equilibrium.equilibrate import equilibrium_from

LOADS = jnp.linspace(1e-5, 2.0, 32)


# First here, where a single solve is all that has been compiled.
@on_the_cpu
@pytest.mark.parametrize("order", ["independent", "continuation"])
def test_a_sweep_of_any_length_compiles_nothing_after_a_single_solve(unloading, order):
    single = js.equilibrate(unloading, js.MeanGap(0.2))
    js.assess_stability(unloading, single)
    loads = [js.MeanGap(jnp.linspace(0.1, 2.0, n)) for n in (5, 4)]
    with compilations() as compiled:
        swept = [js.sweep(unloading, load, order=order) for load in loads]
    assert [len(sweep.equilibrium.gap) for sweep in swept] == [5, 4]
    assert compiled == []


@pytest.fixture(scope="module")
def independent(unloading):
    return js.sweep(unloading, js.MeanGap(LOADS))


@pytest.mark.nightly
@on_the_cpu
def test_a_sweep_equals_single_solves_to_the_last_bit(unloading, independent):
    for state, value in zip(independent[::4], LOADS[::4], strict=True):
        single = js.equilibrate(unloading, js.MeanGap(value))
        assert_same_bits(state.equilibrium, single)
        assert_same_bits(state.stability, js.assess_stability(unloading, single))
    np.testing.assert_array_equal(independent.load.value, LOADS)


def test_on_an_accelerator_lengths_share_few_programs(unloading, independent, monkeypatch, capsys):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    loads = js.MeanGap(LOADS[:5])
    swept = js.sweep(unloading, loads, stability=False, progress=True)
    assert "5/5" in capsys.readouterr().err
    # Programs of a batch are rounded otherwise.
    alone = independent[:5].equilibrium
    np.testing.assert_array_equal(swept.equilibrium.num_steps, alone.num_steps)
    np.testing.assert_allclose(swept.equilibrium.gap, alone.gap, rtol=0, atol=1e-13)
    loads = js.MeanGap(LOADS[:6])
    with compilations() as compiled:
        js.sweep(unloading, loads, stability=False)
    assert compiled == []


@pytest.mark.parametrize(
    "order", ["independent", pytest.param("continuation", marks=pytest.mark.nightly)]
)
def test_a_traced_sweep_with_progress_gives_the_same(unloading, order):
    options = {"order": order, "stability": False}
    outside = js.sweep(unloading, js.MeanGap(LOADS[:3]), **options)

    @jax.jit
    def inside():
        return js.sweep(unloading, js.MeanGap(LOADS[:3]), progress=True, **options)

    gap = inside().equilibrium.gap
    np.testing.assert_allclose(gap, outside.equilibrium.gap, rtol=0, atol=1e-12)


@on_the_cpu
def test_stability_can_be_left_out(unloading, independent):
    swept = js.sweep(unloading, js.MeanGap(LOADS[:4]), stability=False, throw=True)
    assert swept.stability is None
    assert_same_bits(swept.equilibrium, independent[:4].equilibrium)
    with pytest.raises(ValueError, match="stability=True"):
        js.plots.stability_curve(swept)
    with pytest.raises(js.exceptions.SolverError, match=r"1 of 1 loads.*infeasible_load"):
        js.sweep(unloading, js.MeanGap(-LOADS[:1]), stability=False, throw=True)


def interrupt_at(number, monkeypatch):
    calls = []

    def solve(*arguments, **options):
        calls.append(None)
        if len(calls) == number:
            signal.raise_signal(signal.SIGINT)
        return equilibrium_from(*arguments, **options)

    monkeypatch.setattr("jaxstab.loading.sweep.equilibrium_from", solve)


@on_the_cpu
@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_sweep_returns_what_is_done(unloading, independent, monkeypatch):
    interrupt_at(4, monkeypatch)
    with pytest.warns(js.exceptions.SweepInterrupted, match="3 of 32 loads"):
        swept = js.sweep(unloading, js.MeanGap(LOADS))
    assert_same_bits(swept, independent[:3])


@on_the_cpu
@pytest.mark.usefixtures("interruptible")
def test_a_sweep_shared_with_other_processes_returns_no_part(unloading, monkeypatch):
    monkeypatch.setattr(jax, "process_count", lambda: 2)
    interrupt_at(4, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        js.sweep(unloading, js.MeanGap(LOADS))


@on_the_cpu
@pytest.mark.usefixtures("interruptible")
def test_a_sweep_interrupted_at_its_first_load_has_nothing_to_return(unloading, monkeypatch):
    interrupt_at(1, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        js.sweep(unloading, js.MeanGap(LOADS))


def test_an_entry_of_a_sweep_is_a_state_like_any_other(unloading, independent):
    state = independent[9]
    single = js.equilibrate(unloading, js.MeanGap(LOADS[9]))
    shapes = lambda tree: jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), tree)  # noqa: E731
    assert shapes(state.equilibrium) == shapes(single)
    stability = js.assess_stability(unloading, state)
    assert shapes(state.stability) == shapes(stability)
    assert independent.stability.verdict[9] == stability.verdict.name
    back = js.relax_along(unloading, state, state.stability.cone.mode)
    np.testing.assert_allclose(back.gap, single.gap, atol=1e-7)


@on_the_cpu
@pytest.mark.parametrize("bad", [-1.0, np.nan])
def test_an_impossible_load_leaves_the_others_identical(unloading, independent, bad):
    spoilt = js.sweep(unloading, js.MeanGap(LOADS[10:13].at[1].set(bad)))
    assert_same_bits(spoilt[::2], independent[10:13:2])
    failed = spoilt[1]
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
    swept = js.sweep(unloading, loads, order="continuation", stability=False)
    last = None
    for i, value in enumerate(loads.value):
        last = js.equilibrate(unloading, js.MeanGap(value), initial=last)
        np.testing.assert_array_equal(swept.equilibrium.gap[i], last.gap)
        assert swept.equilibrium.num_steps[i] == last.num_steps


def test_continuation_passes_over_a_load_that_fails(unloading):
    values = jnp.array([0.2, -1.0, 0.4])
    swept = js.sweep(unloading, js.MeanGap(values), order="continuation", stability=False)
    failed = swept.equilibrium.result == js.RESULTS.infeasible_load
    np.testing.assert_array_equal(failed, [False, True, False])
    first = js.equilibrate(unloading, js.MeanGap(0.2))
    third = js.equilibrate(unloading, js.MeanGap(0.4), initial=first)
    np.testing.assert_array_equal(swept.equilibrium.gap[2], third.gap)


def test_continuation_goes_on_apart_after_a_pull_off():
    contact = rough_contact(16, js.potentials.Exponential(0.02, 0.05), rms_height=0.05)
    pressures = jnp.array([0.0, -0.05, -0.4, -0.2, -0.001, 0.0, 0.05, 0.0])

    def sweep(value):
        load = js.MeanPressure(value)
        return js.sweep(contact, load, order="continuation", stability=False).equilibrium

    held, apart = [js.RESULTS.successful.name], [js.RESULTS.pulled_off.name]
    for found in (sweep(pressures), jax.jit(sweep)(pressures)):
        assert found.result.name.tolist() == held * 2 + apart * 4 + held * 2
        assert (found.contact_area[2:6] == 0).all()
    pressed = js.equilibrate(contact, js.MeanPressure(0.05))
    np.testing.assert_allclose(found.gap[6], pressed.gap, atol=1e-6)


def test_continuation_follows_a_branch_that_independent_solves_leave(hertz):
    loads = js.MeanDisplacement(jnp.array([1.2, 1.302]))
    touching, apart = (
        js.sweep(hertz, loads, order=order, stability=False).equilibrium.contact_area
        for order in ("continuation", "independent")
    )
    assert touching[1] > 0
    assert apart[1] == 0


@pytest.mark.parametrize("order", ["independent", "continuation"])
def test_a_progress_bar_counts_to_the_end_and_changes_nothing(unloading, capsys, order):
    loads = js.MeanGap(LOADS[::8])
    options = {"order": order, "stability": False}
    silent = js.sweep(unloading, loads, **options)
    assert capsys.readouterr().err == ""
    shown = js.sweep(unloading, loads, progress=True, **options)
    assert "4/4" in capsys.readouterr().err
    assert_same_bits(silent, shown)


def test_a_sweep_raises_only_if_asked(unloading):
    loads = js.MeanGap(jnp.array([0.2, -1.0]))
    with pytest.raises(
        js.exceptions.SolverError, match=r"1 of 2 loads.*MeanGap\(-1\).*infeasible_load"
    ) as told:
        js.sweep(unloading, loads, throw=True)
    assert list(told.value.found.equilibrium.result == "successful") == [True, False]


def test_sweeps_that_make_no_sense_are_refused(unloading):
    with pytest.raises(ValueError, match=r"shape \(\).*equilibrate"):
        js.sweep(unloading, js.MeanGap(1.0))
    with pytest.raises(ValueError, match="order is 'backwards'"):
        js.sweep(unloading, js.MeanGap(LOADS), order="backwards")
    with pytest.raises(ValueError, match=r"\(3, 3\).*\(32, 32\)"):
        js.sweep(unloading, js.MeanGap(LOADS), initial=jnp.ones((3, 3)))
