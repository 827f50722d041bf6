"""Thermal detachment beside quadratures of exact barriers."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import sphere_on_window, with_units
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator

import jaxstab as js

WORK, RANGE = 0.03, 0.2
RATES = np.geomspace(1, 1e6, 4)
PARTS = np.array([0.05, 0.5, 0.95])


def exact_quantiles(barrier, tensions, energy, attempts, rates=RATES):
    """Return by a fine quadrature the tensions before which parts have detached."""
    hazard = cumulative_trapezoid(attempts * np.exp(-barrier / energy), tensions, initial=0)
    detached = 1 - np.exp(-hazard / rates[:, None])
    return np.array([np.interp(PARTS, one, tensions) for one in detached])


def flat_exponential():
    """Return a law, tensions, and the barriers of a flat surface, a release of the power 2."""
    last = WORK / RANGE
    tensions = np.linspace(0.3 * last, last, 400_001)
    barrier = WORK - RANGE * tensions * (1 - np.log(tensions / last))
    return js.potentials.Exponential(WORK, RANGE), tensions, barrier, 2


def flat_lennard_jones():
    """Return the same of a fold, of the power 3/2, at the tension at which the law is steepest."""
    law = js.potentials.LennardJones(WORK, RANGE)
    gaps = np.linspace(0.9, 20, 1_000_001) * RANGE
    energy, slope = (np.asarray(f(gaps)) for f in (jax.vmap(law), jax.vmap(jax.grad(law))))
    top = int(slope.argmax())
    tensions = np.linspace(0.3, 1, 100_001) * slope[top]
    near = np.interp(tensions, slope[: top + 1], gaps[: top + 1])
    far = np.interp(-tensions, -slope[top:], gaps[top:])
    lost = np.interp(far, gaps, energy) - np.interp(near, gaps, energy)
    return law, tensions, lost - tensions * (far - near), 3 / 2


@pytest.mark.parametrize(
    "flat", [flat_exponential, pytest.param(flat_lennard_jones, marks=pytest.mark.nightly)]
)
def test_flat_surfaces_detach_as_by_the_quadrature_of_the_exact_barrier(detaching, flat):
    line, _ = detaching
    law, tensions, barrier, power = flat()
    contact = js.Contact(line.solid, jnp.zeros(12), law)
    energy, attempts = 2e-6, 1e12
    options = {"thermal_energy": energy, "attempt_rate": attempts}
    found = js.detachment(contact, js.MeanPressure(-tensions[0]), rate=RATES, **options)
    strongest = tensions[-1]
    expected = exact_quantiles(barrier, tensions, energy, attempts)
    lowering = strongest + np.asarray(found.quantile(PARTS))
    np.testing.assert_allclose(lowering, strongest - expected, rtol=5e-3)
    np.testing.assert_allclose(found.median, -expected[:, 1], rtol=2e-4)
    np.testing.assert_allclose(found.survival(-expected[1])[1], 1 - PARTS, atol=5e-3)
    assert found.num_passes < 12
    # The lowering to this power falls by kT / C for each ln(rate), B = C s^power.
    near = np.searchsorted(tensions, 0.999 * strongest)
    coefficient = barrier[near] / (strongest - tensions[near]) ** power
    right, wrong = (
        -np.diff(lowering[:, 1] ** other) / np.diff(np.log(RATES)) for other in (power, 3.5 - power)
    )
    np.testing.assert_allclose(right * coefficient / energy, 1, atol=0.1)
    assert np.ptp(right) / right.mean() < 0.05 < np.ptp(wrong) / wrong.mean()


@pytest.mark.nightly
def test_a_rough_line_detaches_as_by_the_branch_around_its_pull_off(detaching):
    contact, _ = detaching
    options = {"fields": True, "max_step": 0.003, "max_states": 150}
    branch = js.continuation(contact, js.MeanPressure(jnp.array([0.0, -1.0])), **options)
    tension = -np.asarray(branch.load.value)
    potential = np.asarray(branch.equilibrium.energy) - tension * branch.equilibrium.mean_gap
    (turn,) = np.asarray(branch.turns.state)
    stable = PchipInterpolator(tension[: turn + 1], potential[: turn + 1])
    saddle = PchipInterpolator(tension[turn:][::-1], potential[turn:][::-1])
    tensions = np.linspace(0.05, tension[turn], 100_001)
    energy, attempts = 2e-4, 1e9
    expected = exact_quantiles(saddle(tensions) - stable(tensions), tensions, energy, attempts)
    load = js.MeanPressure(-0.05)
    options = {"thermal_energy": energy, "attempt_rate": attempts}
    found = js.detachment(contact, load, rate=RATES, **options)
    assert found.is_direct
    # Those of the slowest rate begin before the load.
    np.testing.assert_allclose(found.quantile(PARTS)[1:], -expected[1:], rtol=2e-4)
    error = np.abs(found.quantile(PARTS)[1:] + expected[1:])
    assert (error < found.quantile_error(PARTS)[1:] + 1e-5).all()
    held = js.detachment(contact, load, **options)
    pass_ = js.transition(contact, load, branch[0], None)
    life = 1 / pass_.rate(energy, attempts)
    np.testing.assert_allclose([held.mean_life, found.mean_life], life, rtol=1e-8)
    assert held.num_passes == 1
    with pytest.raises(ValueError, match=r"load is held.*give `rate`"):
        _ = held.median


@pytest.mark.nightly
def test_a_load_that_grows_from_zero_has_the_work_of_separation_as_its_barrier(detaching):
    line, _ = detaching
    contact = js.Contact(line.solid, jnp.zeros(12), line.potential)
    options = {"thermal_energy": 1e-3, "attempt_rate": 1e3, "rate": 1e-3}
    found = js.detachment(contact, js.MeanPressure(0.0), **options)
    np.testing.assert_allclose(found.barriers[0], WORK, rtol=1e-8)
    np.testing.assert_allclose(found.mean_life, np.exp(30) / 1e3, rtol=1e-6)
    _, tensions, _, _ = flat_exponential()
    tensions = np.linspace(1e-9, tensions[-1], 400_001)
    barrier = WORK - RANGE * tensions * (1 - np.log(tensions / tensions[-1]))
    expected = exact_quantiles(barrier, tensions, 1e-3, 1e3, np.array([1e-3]))
    np.testing.assert_allclose(found.quantile(PARTS), -expected[0], rtol=5e-4)
    # A rate at which thermal motion has no time.
    options["rate"] = 1e9
    found = js.detachment(contact, js.MeanPressure(0.0), **options)
    assert found.median == found.pull_off.load.value
    assert found.survival(0.99999 * found.median) > 0.99
    assert found.survival(1.00001 * found.median) == 0


@pytest.mark.nightly
def test_without_a_load_the_barrier_is_that_of_the_deepest_state_on_the_way(detaching):
    """The limit of those of small tensions, and the work to separate the state of least energy."""
    line, _ = detaching
    heights = js.surfaces.self_affine(line.grid, jax.random.key(29), k_high=4, rms_height=0.15)
    contact = js.Contact(line.solid, heights, js.potentials.Exponential(0.01, 0.03))
    rest = js.MeanPressure(0.0)
    starts = np.random.default_rng(29).uniform(0, 0.2, (8, 12))
    states = [js.equilibrate(contact, rest, initial=gap) for gap in starts]
    least = min(float(state.energy) for state in states)
    options = {"thermal_energy": 1e-6, "attempt_rate": 1.0}
    # Of a state that presses, too, from which the contact is unloaded to the load.
    pressed = js.equilibrate(contact, js.MeanPressure(0.02))
    found = js.detachment(contact, rest, initial=pressed, **options)
    np.testing.assert_allclose(found.barriers[0], -least, rtol=1e-7)
    assert not found.is_direct
    held = js.equilibrate(contact, rest)
    assert held.energy > 0.5 * least
    before = float(found.barriers[0])
    for part in (1e-6, 1e-3):
        pull = js.MeanPressure(part * found.pull_off.load.value)
        barrier = float(js.detachment(contact, pull, **options).barriers[0])
        # So far out the attraction is a small part of the load.
        lift = -0.03 * np.log(-float(pull.value) * 0.03 / 0.01) + 0.4
        assert 0 < before - barrier < -float(pull.value) * lift
        before = barrier


@pytest.mark.nightly
def test_a_state_at_the_load_but_for_rounding_is_one_to_begin_from(detaching):
    contact, _ = detaching
    options = {"thermal_energy": 2e-4, "attempt_rate": 1e9}
    for value in (0.0, -0.05):
        load = js.MeanPressure(value)
        state = js.equilibrate(contact, load)
        # The state at rest may carry a tension of rounding, as here beyond the load.
        rounded = replace(state, mean_pressure=state.mean_pressure - 1e-12)
        found = js.detachment(contact, load, initial=rounded, **options)
        default = js.detachment(contact, load, **options)
        assert found.loads[0] == value
        np.testing.assert_allclose(found.barriers[0], default.barriers[0], rtol=1e-8)


@pytest.fixture(scope="module")
def jumping(detaching):
    """A contact whose state jumps before its pull-off, through a release, and its path."""
    line, _ = detaching
    heights = js.surfaces.self_affine(line.grid, jax.random.key(33), k_high=5, rms_height=0.08)
    contact = js.Contact(line.solid, heights, js.potentials.Exponential(0.02, 0.07))
    path = js.follow(contact, js.MeanPressure(jnp.array([0.0, -0.06])), fields=True)
    assert len(path.jumps) == 2
    return contact, path


@pytest.mark.nightly
def test_barriers_go_on_through_a_jump_as_those_of_the_state_that_holds_longest(jumping):
    contact, path = jumping
    energy = 3e-5
    options = {"thermal_energy": energy, "attempt_rate": 1e6, "rate": 1e3}
    found = js.detachment(contact, js.MeanPressure(-0.04), **options)
    assert not found.is_direct and found.num_passes < 20
    # The state behind the jump also lives at smaller tensions.
    jump = float(path.jumps.load.value[0])
    loads = js.MeanPressure(jump * jnp.array([1.0, 0.97]))
    back = js.follow(contact, loads, initial=path.jumps.after[0], fields=True)
    changes = 0
    for part in (0.96, 0.973, 0.99, 0.999, 1.001, 1.02):
        load = js.MeanPressure(part * jump)
        states = [path.jumps.before[0].gap, back[-1].equilibrium.gap]
        if part < 0.97:
            states = states[:1]
        if part > 1:
            states = [path.jumps.after[0].gap]
        climbs = [float(js.transition(contact, load, gap, None).there) for gap in states]
        between = np.interp(-load.value, -found.loads, found.barriers)
        np.testing.assert_allclose(between, max(climbs), atol=0.02 * energy)
        changes += climbs[0] < max(climbs) - 0.1 * energy
    assert changes == 2


@pytest.mark.nightly
def test_shortly_before_a_jump_the_life_is_that_of_both_states(jumping):
    """By the rates over the saddles between both, and out of the second."""
    contact, path = jumping
    energy = 1e-6
    load = js.MeanPressure(0.995 * path.jumps.load.value[0])
    before, after = (states[0].gap for states in (path.jumps.before, path.jumps.after))
    on, back = js.transition(contact, load, before, after).barrier
    out = js.transition(contact, load, after, None).there
    assert on + out - back < out
    onwards, backwards, outwards = (np.exp(-float(x) / energy) for x in (on, back, out))
    life = (onwards + backwards + outwards) / (onwards * outwards)
    options = {"thermal_energy": energy, "attempt_rate": 1.0}
    start = js.equilibrate(contact, load, initial=before)
    found = js.detachment(contact, load, initial=start, **options)
    np.testing.assert_allclose(np.log(float(found.mean_life)), np.log(life), rtol=0.01)


def test_a_detachment_prints_its_quantiles_with_units(detaching):
    contact, _ = detaching
    options = {"thermal_energy": 2e-4, "attempt_rate": 1e9}
    found = js.detachment(contact, js.MeanPressure(-0.08), rate=[1.0, 1e3], **options)
    found = with_units(found)
    head, life, barrier, passes, columns, _, *rows = repr(found).splitlines()
    assert head.startswith("Detachment: mean pressure -0.08 MPa, pull-off without thermal motion")
    assert "mean life" in life and "kT" in barrier and "computed barriers" in passes
    assert "rate" in columns and "median force [" in columns and len(rows) == 2
    assert "rate" not in repr(replace(found, rate=None))
    assert "minima between" in repr(replace(found, is_direct=jnp.array(False)))


def test_loads_and_numbers_without_a_detachment_are_refused_with_the_cure(detaching):
    contact, _ = detaching
    options = {"thermal_energy": 1e-4, "attempt_rate": 1e6, "rate": 1.0}
    pull = js.MeanPressure(-0.05)
    with pytest.raises(ValueError, match=r"load is 0.1: give a tension"):
        js.detachment(contact, js.MeanPressure(0.1), **options)
    with pytest.raises(ValueError, match=r"without thermal motion .* at -0.100757: give a smaller"):
        js.detachment(contact, js.MeanPressure(-0.2), **options)
    with pytest.raises(TypeError, match=r"Spring.*give a MeanPressure that pulls.*soft spring"):
        js.detachment(contact, js.Spring(0.1, 1.0), **options)
    with pytest.raises(ValueError, match="takes one load"):
        js.detachment(contact, js.MeanPressure(-jnp.ones(2)), **options)
    for name in options:
        for bad in (0.0, -1.0, np.nan):
            with pytest.raises(ValueError, match="must be positive and finite"):
                js.detachment(contact, pull, **{**options, name: bad})
    with pytest.raises(TypeError, match="detachment works on known numbers"):
        jax.jit(lambda x: js.detachment(contact, js.MeanPressure(x), **options).median)(-0.05)
    start = js.equilibrate(contact, js.MeanPressure(-0.08), initial=jnp.full(12, 1e-3))
    with pytest.raises(ValueError, match=r"initial state is at -0.08: give one at a smaller"):
        js.detachment(contact, pull, initial=start, **options)
    without = js.Contact(contact.solid, contact.heights, js.potentials.NoAdhesion())
    with pytest.raises(js.exceptions.SolverError, match="no_attraction"):
        js.detachment(without, pull, **options)
    found = js.detachment(contact, js.MeanPressure(-0.095), **options)
    with pytest.raises(ValueError, match=r"probability is 1.5: give numbers from 0 to 1"):
        found.quantile(1.5)


# On a window the mean gap is no measure of the work of the load.
@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.WindowWarning")
def test_barriers_of_a_window_are_those_of_its_passes():
    contact = sphere_on_window()
    options = {"thermal_energy": 3e-4, "attempt_rate": 1e9, "rate": 1.0}
    found = js.detachment(contact, js.MeanPressure(-0.06), **options)
    tension = -float(found.quantile(0.2))
    start = js.equilibrate(contact, js.MeanPressure(0.0))
    there = js.transition(contact, js.MeanPressure(-tension), start, None).there
    between = np.interp(tension, -np.asarray(found.loads), found.barriers)
    np.testing.assert_allclose(between, there, atol=0.01 * 3e-4)
    assert found.num_passes < 6
