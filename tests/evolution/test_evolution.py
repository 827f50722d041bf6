"""Viscoelastic contacts in time: against limits, integrals and elastic paths."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness
from fixed_steps import FixedSteps
from viscoelastic_lines import ANY, RATIOS, TIMES, cycle, relaxed_of, viscoelastic

import jaxstab as js


def elastic_gaps(contact, loads):
    """The gaps of an elastic contact, each sought from the one before."""
    gaps = []
    for load in loads:
        initial = gaps[-1] if gaps else None
        gaps.append(js.equilibrate(contact, load, initial=initial).gap)
    return np.array(gaps)


@pytest.mark.parametrize(("ratios", "times"), [((0.0, 0.0), TIMES), (RATIOS, (1e-13, 2e-13))])
def test_a_solid_without_memory_takes_the_elastic_path(ratios, times):
    contact = viscoelastic(ratios, times)
    instants, values = cycle()
    load = js.MeanDisplacement(values)
    found = js.evolve(contact, load, instants, rtol=ANY, fields=True)
    # The parts of the balance are in one unit, however small one of them is.
    assert re.findall(r"(?:work|stored|dissipated|lost) \[(.*?)\]", repr(found)) == 4 * ["nJ/m"]
    assert np.max(np.abs(found.fields.gap - elastic_gaps(relaxed_of(contact), load))) < 1e-9 * 0.02
    assert np.max(np.abs(found.viscous_dissipation)) < 1e-9 * np.max(np.abs(found.work))


def test_a_fast_retraction_is_that_of_the_glassy_solid_on_a_surface_moved_by_the_memory():
    contact = viscoelastic()
    load = js.MeanDisplacement(jnp.linspace(0.01, 0.05, 9))
    found = js.evolve(contact, load, 1e-14 * jnp.arange(9.0), rtol=ANY, fields=True)
    relaxed = relaxed_of(contact)
    start = js.equilibrate(relaxed, load[0])
    u = start.displacement - jnp.mean(start.displacement)
    # p = K_glassy (u - r / (1 + r) u_relaxed), r the sum of the ratios.
    moved = contact.heights - sum(RATIOS) / (1 + sum(RATIOS)) * u
    glassy = js.Contact(js.HalfSpace(contact.grid, 1 + sum(RATIOS)), moved, contact.potential)
    assert found.fields.gap[0] == pytest.approx(np.array(start.gap), abs=1e-9)
    assert np.max(np.abs(found.fields.gap - elastic_gaps(glassy, load))) < 1e-8 * 0.02


def hereditary_gaps(contact, times, values):
    """Gaps of p(t) = int K(t - s) du(s), u linear between the times, by projected Gauss-Seidel."""
    n = contact.grid.shape[0]
    K = periodic_stiffness((n,), (1.0,), 1.0)
    h = np.array(contact.heights)
    w, rho = (float(x) for x in (contact.potential.surface_energy, contact.potential.length))
    history, gaps = [], []
    for i, (time, value) in enumerate(zip(times, values, strict=True)):
        past, now = np.zeros(n), 1.0
        for r, t in zip(RATIOS, TIMES, strict=True):

            def kept(j, t=t, time=time):
                later, earlier = (np.exp(-(time - times[k]) / t) for k in (j, j - 1))
                return t * (later - earlier) / (times[j] - times[j - 1])

            past += r * sum((kept(j) * (history[j] - history[j - 1]) for j in range(1, i)), 0.0)
            if i:
                now += r * kept(i)
                past -= r * kept(i) * history[-1]
        # p = now K u + K past; g >= 0 is searched point by point, mean(u) held by p0.
        force = K @ past
        g = gaps[-1].copy() if gaps else np.maximum(value - h, 1e-3)
        g *= (value - h.mean()) / g.mean()
        for _ in range(4000):
            before = g.copy()
            r = now * (K @ (g + h)) + force + w / rho * np.exp(-g / rho)
            level = r[g > 0].mean()
            for j in range(n):
                residual = now * (K[j] @ (g + h)) + force[j] + w / rho * np.exp(-g[j] / rho) - level
                g[j] = max(g[j] - residual / (now * K[j, j]), 0.0)
            g *= (value - h.mean()) / g.mean()
            if np.max(np.abs(g - before)) < 1e-13:
                break
        gaps.append(g)
        history.append(g + h - np.mean(g + h))
    return np.array(gaps)


def test_gaps_are_those_of_the_hereditary_integral():
    contact = viscoelastic(energy=0.001)
    times, values = cycle(9)
    found = js.evolve(contact, js.MeanDisplacement(values), times, rtol=ANY, fields=True)
    expected = hereditary_gaps(contact, np.array(times), np.array(values))
    assert np.any(expected == 0)
    assert np.max(np.abs(found.fields.gap - expected)) < 1e-6 * 0.02


@pytest.mark.parametrize(
    ("make", "values"),
    [
        # The tension rises and falls smoothly, or ends in a jump.
        pytest.param(js.MeanDisplacement, (0.05, 0.0, 0.09), id="displacement"),
        pytest.param(
            lambda u: js.Spring(u, 0.3),
            (0.05, -0.05, 0.2),
            id="spring",
            marks=pytest.mark.nightly,
        ),
    ],
)
def test_extremes_of_a_run_do_not_depend_on_the_recorded_times(make, values):
    contact = viscoelastic()
    contact = js.Contact(contact.solid, 2 * contact.heights, contact.potential)
    turns = np.arange(3.0)
    run = js.evolve(contact, make(jnp.array(values)), turns)
    assert run.largest_tension > 1.5 * -np.min(run.mean_pressure)
    # Records around the extremes find them.
    near = float(run.largest_tension_time) + 0.1 * np.linspace(-1, 1, 41) ** 3
    often = np.union1d(turns, near)
    dense = js.evolve(contact, make(jnp.interp(often, turns, jnp.array(values))), often)
    pressures = np.asarray(dense.mean_pressure)
    assert run.largest_tension == pytest.approx(-pressures.min(), rel=2e-3)
    assert run.largest_compression == pytest.approx(pressures.max(), rel=2e-3)
    assert run.largest_tension_time == pytest.approx(often[pressures.argmin()], abs=2e-3)
    assert run.largest_compression_time == 1
    # A state is of the same run, which says it in print.
    assert run[1].largest_tension == run.largest_tension
    assert f"largest tension {float(run.largest_tension):.3g} at time " in repr(run)


@pytest.mark.nightly
def test_extremes_of_a_run_that_fails_are_those_of_its_steps():
    contact = viscoelastic()
    pull = js.MeanPressure(jnp.array([0.0, -1.0]))
    run = js.evolve(contact, pull, jnp.array([0.0, 1.0]), throw=False)
    assert run.result[-1] == "pulled_off"
    # The load is linear in time.
    assert 0 < run.largest_tension == pytest.approx(float(run.reached))
    assert run.largest_tension_time == run.reached and run.largest_compression_time == 0


@pytest.mark.nightly
def test_halving_the_steps_quarters_the_error():
    contact = viscoelastic(energy=0.0005)
    pressures = []
    for number in (11, 21, 41, 321):
        times = jnp.linspace(0, 1, number)
        # Without contact, where a contact's edge does not move from point to point.
        load = js.MeanDisplacement(0.06 - 0.02 * jnp.sin(2 * times))
        pressures.append(js.evolve(contact, load, times, rtol=ANY).mean_pressure[-1])
    errors = np.abs(np.array(pressures[:3]) - pressures[3])
    assert np.log2(errors[:2] / errors[1:]) == pytest.approx([2, 2], abs=0.2)


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(js.MeanDisplacement, id="displacement"),
        pytest.param(js.MeanGap, id="gap", marks=pytest.mark.nightly),
        pytest.param(lambda u: js.Spring(u, 1.0), id="spring"),
    ],
)
def test_work_is_stored_dissipated_or_lost_in_jumps(make):
    times, values = cycle()
    found = js.evolve(viscoelastic(), make(values), times, rtol=1e-4)
    missing = found.work - found.stored - found.viscous_dissipation - found.jump_dissipation
    assert np.all(np.diff(found.viscous_dissipation) >= 0) and found.viscous_dissipation[-1] > 0
    assert np.max(np.abs(missing)) < 1e-3 * np.max(np.abs(found.work))


@pytest.mark.nightly
def test_the_work_of_a_dead_load_is_its_force_times_the_way():
    contact = viscoelastic(energy=0.005)
    contact = js.Contact(contact.solid, 4 * contact.heights, contact.potential)
    # Loaded at once, then held: the way turns, and nothing jumps.
    pull, times = -0.0176, jnp.array([0.0, 1e-8, 10.0])
    run = js.evolve(contact, js.MeanPressure(jnp.array([0.0, pull, pull])), times)
    changes = [values[2] - values[1] for values in (run.work, run.stored, run.viscous_dissipation)]
    exchanged = np.sum(np.abs(changes)) / 2
    expected = -pull * contact.area * (run.mean_gap[2] - run.mean_gap[1])
    assert abs(changes[0] - expected) < 1e-3 * exchanged
    assert len(run.jump_times) == 0 and run.num_steps.sum() < 100


@pytest.mark.nightly
def test_a_jump_of_the_glassy_solid_is_located_and_its_loss_is_that_of_the_path(hertz, loop):
    # Without a memory that matters, as the relaxed solid of `follow`.
    contact = js.Contact(js.Viscoelastic(hertz.solid, 1e-9, 1.0), hertz.heights, hertz.potential)
    load = js.MeanDisplacement(jnp.array([1.6, 1.2, 1.6]))
    found = js.evolve(contact, load, jnp.arange(3.0), rtol=1e-4, fields=True)
    assert len(loop.jumps) == len(found.jump_losses) >= 2
    assert np.array(found.jump_losses) == pytest.approx(np.array(loop.jumps.dissipation), rel=1e-3)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_a_jump_in_a_hold_is_the_same_however_long_the_hold_is():
    contact = viscoelastic(ratios=0.5, times=1.0, energy=0.003)
    contact = js.Contact(contact.solid, 2 * contact.heights, contact.potential)
    load = js.Spring([0.1, 0.083, 0.083], 1.0)
    short, long = (js.evolve(contact, load, jnp.array([0, 0.1, end])) for end in (10.0, 1e4))
    assert long.jump_times == pytest.approx(np.array(short.jump_times), rel=1e-4)
    assert long.jump_losses == pytest.approx(np.array(short.jump_losses), rel=1e-4)
    missing = long.work - long.stored - long.viscous_dissipation - long.jump_dissipation
    assert np.max(np.abs(missing)) < 1e-4 * long.jump_dissipation[-1]


def test_a_held_contact_rests_where_the_relaxed_solid_does():
    contact = viscoelastic()
    times = jnp.concatenate([jnp.zeros(1), jnp.logspace(-3, 3, 13)])
    load = js.MeanDisplacement(jnp.full(14, 0.02).at[0].set(0.05))
    found = js.evolve(contact, load, times)
    relaxed = relaxed_of(contact)
    rest = js.equilibrate(relaxed, js.MeanDisplacement(0.02), initial=found.gap)
    assert found.mean_pressure[-1] == pytest.approx(float(rest.mean_pressure), rel=1e-6)
    assert np.max(np.abs(found.gap - rest.gap)) < 1e-8


@pytest.mark.nightly
def test_a_state_of_a_path_starts_at_its_own_load(hertz, loop):
    contact = js.Contact(js.Viscoelastic(hertz.solid, 2.0, 1.0), hertz.heights, hertz.potential)
    state = loop[len(loop) // 2]
    rest = js.equilibrate(hertz, state.load, initial=state)
    load = js.MeanDisplacement(jnp.array([1.4, 1.2, 1.3]))
    gaps = [
        js.evolve(contact, load, jnp.arange(3.0), initial=s, rtol=ANY, fields=True).gap
        for s in (state, rest)
    ]
    assert np.max(np.abs(gaps[0] - gaps[1])) < 1e-9


@pytest.mark.nightly
def test_a_window_has_the_gap_of_its_surface_and_the_glassy_answer():
    grid = js.Grid(16, 2.0)
    solid = js.Viscoelastic(js.FreeHalfSpace(grid, 1.0), 3.0, 1.0)
    law, heights = js.potentials.Exponential(0.005, 0.05), js.surfaces.paraboloid(grid, 1.5)
    places = jnp.max(heights) + jnp.array([5.0, -0.05])
    contact, load = js.Contact(solid, heights, law), js.FarDisplacement(places)
    fast = js.evolve(contact, load, [0, 1e-9], rtol=ANY, fields=True)
    glassy = js.Contact(js.FreeHalfSpace(grid, 4.0), heights, law)
    expected = js.equilibrate(glassy, js.FarDisplacement(places[1]))
    # Far away the relaxed solid was hardly deformed.
    assert fast.gap == pytest.approx(np.array(expected.gap), abs=1e-8)
    assert fast.force[1] == pytest.approx(float(expected.mean_pressure) * 4, rel=1e-7)
    assert np.array_equal(fast[1].equilibrium.gap, fast.gap)
    assert "force" in repr(fast)


@pytest.mark.nightly
def test_full_contact_opens_under_a_mean_gap():
    contact = viscoelastic(energy=0.02)
    relaxed = relaxed_of(contact)
    rest = js.equilibrate(relaxed, js.MeanPressure(0.0))
    assert rest.contact_area == 1
    held = js.MeanGap(jnp.full(2, 0.01))
    found = js.evolve(contact, held, jnp.array([0.0, 1.0]), initial=rest)
    assert np.array(found.mean_gap) == pytest.approx(0.01, rel=1e-9)
    assert np.all(np.isfinite(found.mean_pressure))


@pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=pytest.mark.nightly)])
def test_the_work_is_that_of_the_forces_at_many_times(dtype):
    """A fast attraction and detachment, in few steps; the trapezoidal rule was 4 % off in them."""
    grid = js.Grid((32,), (1.0,))
    x = grid.coordinates[0]
    heights = 0.028 * jnp.cos(2 * jnp.pi * x) + 0.008 * jnp.cos(4 * jnp.pi * x + 1)
    solid = js.Viscoelastic(js.HalfSpace(grid, 1.0, 0.3), [0.1, 57.0], [2.3, 3.8])
    energy = 1.1 * np.pi * 0.02**2 / (2 / 32) / 2
    contact = js.Contact(solid, heights, js.potentials.Exponential(energy, 0.02))
    turns, values = 0.1 * np.array([0, 0.5, 1, 2, 2.5]), 0.02 * np.array([-1.0, 3, 6, 6, -1])
    given = js.Contact(solid, heights.astype(dtype), contact.potential)
    run = js.evolve(given, js.Spring(values, 50.0), turns)
    assert run.work.dtype == dtype

    times = np.union1d(np.linspace(0, turns[-1], 600), turns)
    positions = np.interp(times, turns, values)
    fine = js.evolve(contact, js.Spring(positions, 50.0), times, rtol=1e-4)
    pressures = np.asarray(fine.mean_pressure)
    parts = -(pressures[1:] + pressures[:-1]) / 2 * np.diff(positions)
    work = np.concatenate([[0], np.cumsum(parts)])[np.searchsorted(times, turns)]
    assert np.sum(run.num_steps) < 200
    np.testing.assert_allclose(run.work, work, atol=5e-3 * np.max(work))


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.ResolutionWarning")
def test_a_late_jump_behind_other_loads_is_that_of_many_small_steps():
    # Relaxation times over nearly four decades, with branches far stiffer than the relaxed one.
    ratios, times, k = (6.6, 44.0, 4.1), (0.015, 0.36, 68.0), 0.13
    grid, law = js.Grid((4, 4), 1.0), js.potentials.Exponential(0.003, 0.011)
    heights = np.random.default_rng(24).normal(size=(4, 4))
    heights = 0.05 * (heights - heights.mean()) / heights.std()
    contact = js.Contact(js.Viscoelastic(js.HalfSpace(grid, 1.0), ratios, times), heights, law)
    options = {"rtol": 1e-5, "fields": True}
    pressed = js.evolve(contact, js.MeanPressure([0.0, 0.12]), [0.0, 1.5], **options)
    reached = float(pressed.mean_gap[-1]) + heights.mean()
    held = js.MeanDisplacement([reached, reached + 0.01])
    lifted = js.evolve(contact, held, [1.5, 3.0], initial=pressed, **options)
    far = reached + 0.01 - float(lifted.mean_pressure[-1]) / k
    places = far + np.array([0.0, 0.1, 0.5])
    pulled = js.evolve(contact, js.Spring(places, k), [3.0, 7.0, 23.0], initial=lifted, **options)

    steps, count = FixedSteps(heights, (1.0, 1.0), ratios, times, 0.003, 0.011), 500
    steps.rest(pressed.fields.gap[0])
    # A soft spring presses, and a stiff one holds.
    soft, stiff = 1e-6, 2e5
    _, pressure = steps.go(np.linspace(0, 1.5, count), soft, np.linspace(0, -0.12 / soft, count))
    np.testing.assert_allclose(pressure, 0.12, rtol=1e-5)
    np.testing.assert_allclose(steps.gap, np.ravel(pressed.gap), atol=1e-5)
    _, pressure = steps.go(
        np.linspace(1.5, 3, count), stiff, reached + np.linspace(0, 0.01, count) - pressure / stiff
    )
    np.testing.assert_allclose(lifted.mean_pressure[-1], pressure, rtol=1e-3)
    np.testing.assert_allclose(steps.gap, np.ravel(lifted.gap), atol=1e-5)
    none, _ = steps.go(np.linspace(3, 7, count), k, np.linspace(places[0], places[1], count))
    np.testing.assert_allclose(steps.gap, np.ravel(pulled.fields.gap[1]), atol=1e-4)
    late = np.linspace(7, 23, count)
    (jump,), _ = steps.go(late, k, np.linspace(places[1], places[2], count))
    assert not none and jump - late[1] + late[0] - 0.01 < pulled.jump_times[-1] < jump + 0.01
    np.testing.assert_allclose(steps.gap, np.ravel(pulled.gap), atol=1e-4)
