"""Viscoelastic contacts in time: against limits, integrals and differences."""

import importlib
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brute_force import periodic_stiffness
from viscoelastic_lines import ANY, RATIOS, TIMES, relaxed_of, viscoelastic

import jaxstab as js


def cycle(number=21, period=4.0, top=0.05, bottom=0.01):
    times = jnp.linspace(0, period, number)
    return times, top - (top - bottom) * (1 - jnp.abs(2 * times / period - 1))


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
    assert np.max(np.abs(found.dissipated)) < 1e-9 * np.max(np.abs(found.work))


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
    [js.MeanDisplacement, lambda u: js.MeanGap(u), lambda u: js.Spring(u, 1.0)],
    ids=["displacement", "gap", "spring"],
)
def test_work_is_stored_dissipated_or_lost_in_jumps(make):
    times, values = cycle()
    found = js.evolve(viscoelastic(), make(values), times, rtol=1e-4)
    missing = found.work - found.stored - found.dissipated - found.lost
    assert np.all(np.diff(found.dissipated) >= 0) and found.dissipated[-1] > 0
    assert np.max(np.abs(missing)) < 1e-3 * np.max(np.abs(found.work))


def test_a_jump_of_the_glassy_solid_is_located_and_its_loss_is_that_of_the_path(hertz, loop):
    # Without a memory that matters, as the relaxed solid of `follow`.
    contact = js.Contact(js.Viscoelastic(hertz.solid, 1e-9, 1.0), hertz.heights, hertz.potential)
    load = js.MeanDisplacement(jnp.array([1.6, 1.2, 1.6]))
    found = js.evolve(contact, load, jnp.arange(3.0), rtol=1e-4, fields=True)
    assert len(loop.jumps) == len(found.dissipation) >= 2
    assert np.array(found.dissipation) == pytest.approx(np.array(loop.jumps.dissipation), rel=1e-3)


def test_a_held_contact_rests_where_the_relaxed_solid_does():
    contact = viscoelastic()
    times = jnp.concatenate([jnp.zeros(1), jnp.logspace(-3, 3, 13)])
    load = js.MeanDisplacement(jnp.full(14, 0.02).at[0].set(0.05))
    found = js.evolve(contact, load, times)
    relaxed = relaxed_of(contact)
    rest = js.equilibrate(relaxed, js.MeanDisplacement(0.02), initial=found.gap)
    assert found.mean_pressure[-1] == pytest.approx(float(rest.mean_pressure), rel=1e-6)
    assert np.max(np.abs(found.gap - rest.gap)) < 1e-8


def test_it_goes_on_from_where_it_ended():
    contact, (times, values) = viscoelastic(), cycle()
    load = js.MeanDisplacement(values)
    whole = js.evolve(contact, load, times, rtol=ANY)
    first = js.evolve(contact, load[:8], times[:8], rtol=ANY)
    rest = js.evolve(contact, load[7:], times[7:], rtol=ANY, initial=first)
    assert rest.mean_pressure == pytest.approx(np.array(whole.mean_pressure[7:]), abs=1e-12)


def test_an_interrupted_evolution_keeps_its_states_and_goes_on(monkeypatch):
    contact, (times, values) = viscoelastic(), cycle(9)
    load = js.MeanDisplacement(values)
    whole = js.evolve(contact, load, times, rtol=ANY)
    module = importlib.import_module("jaxstab.paths.evolution.evolve")
    found, calls = module._march, []

    def interrupted(*inputs):
        calls.append(1)
        if len(calls) > 4:
            raise KeyboardInterrupt
        return found(*inputs)

    monkeypatch.setattr(module, "_march", interrupted)
    with pytest.warns(js.PathInterrupted, match="3 of 8 times"):
        first = js.evolve(contact, load, times, rtol=ANY)
    monkeypatch.undo()
    assert len(first) == len(first.load.value) == 4
    rest = js.evolve(contact, load[3:], times[3:], rtol=ANY, initial=first)
    assert rest.mean_pressure == pytest.approx(np.array(whole.mean_pressure[3:]), abs=1e-12)


def test_after_a_failure_there_are_no_numbers_and_it_goes_on_from_the_last_state():
    contact, times = viscoelastic(), jnp.linspace(0, 4, 5)
    load = js.MeanPressure(jnp.linspace(0, -0.16, 5))
    found = js.evolve(contact, load, times, throw=False, fields=True)
    assert found.result.name.tolist() == 2 * ["successful"] + 3 * ["pulled_off"]
    assert 1 < found.reached < 2
    assert "nan" in repr(found) and "+nan" not in repr(found)
    for name in ("mean_gap", "mean_pressure", "contact_area", "work", "stored", "dissipated"):
        assert np.isnan(getattr(found, name)).tolist() == [False, False, True, True, True]
    assert np.all(np.isnan(found.fields.gap[2:]))
    assert np.isnan(js.growth_rate(found)) and np.isnan(js.growth_rate(found[-1]))
    with pytest.raises(js.SolverError, match="no_equilibrium"):
        js.assess_stability(found[-1])
    # The last state was found, still in contact.
    place = float(jnp.interp(found.reached, times, load.value))
    held = js.MeanPressure(jnp.full(2, place))
    rest = js.evolve(
        contact, held, found.reached + jnp.array([0, 1e-9]), initial=found, fields=True
    )
    assert rest.contact_area[0] > 0
    with pytest.raises(ValueError, match="start from a state that was found"):
        js.evolve(contact, load, times, initial=found[2])


def test_after_a_failure_there_are_no_derivatives():
    times, load = jnp.linspace(0, 4, 5), js.MeanPressure(jnp.linspace(0, -0.16, 5))

    def gaps(energy):
        contact = viscoelastic(energy=energy)
        return js.evolve(contact, load, times, rtol=0.1, max_steps=64, throw=False).mean_gap

    _, changes = jax.jvp(gaps, (0.002,), (1.0,))
    assert np.isnan(changes).tolist() == [False, False, True, True, True]
    # Where failed states do not count, they spoil nothing.
    _, pull_back = jax.vjp(gaps, 0.002)
    (found,), (failed,) = (pull_back(jnp.eye(5)[i]) for i in (1, 3))
    assert found == pytest.approx(float(changes[1])) and found != 0
    assert np.isnan(failed)


def test_a_tolerance_below_the_rounding_of_equilibria_is_named():
    times, values = cycle(9)

    def end(energy):
        load, contact = js.MeanDisplacement(values), viscoelastic(energy=energy)
        return js.evolve(contact, load, times, rtol=1e-6, max_steps=16).mean_pressure[-1]

    # Also where derivatives are taken.
    for call in (end, jax.grad(end)):
        with pytest.raises(js.SolverError, match=r"with rtol = 1e-06: store_full.*raise `rtol`"):
            call(0.002)


def test_many_speeds_at_once_are_those_alone():
    times, values = cycle(9)

    def pulled(speed):
        contact = viscoelastic(length=2.0)
        return js.evolve(contact, js.MeanDisplacement(values), times / speed, rtol=1e-2)

    speeds = jnp.array([0.1, 1.0, 10.0])
    runs = [pulled(speed) for speed in speeds]
    alone = np.array([run.mean_pressure for run in runs])
    batch = jax.vmap(pulled)(speeds)
    assert np.array(batch.mean_pressure) == pytest.approx(alone, abs=1e-12)
    assert np.array(batch.force) == pytest.approx(np.array([run.force for run in runs]), abs=1e-12)
    # A batch is a sequence of evolutions.
    assert len(batch) == 3
    assert batch[2][3].work == pytest.approx(float(runs[2][3].work), abs=1e-12)
    assert batch[2].force == pytest.approx(np.array(runs[2].force), abs=1e-12)
    assert batch[2].contact.heights.shape == (32,)
    with pytest.raises(ValueError, match="3 evolutions: choose one"):
        js.growth_rate(batch)
    assert np.ptp(alone[:, -2]) > 1e-4


def test_derivatives_by_law_ratio_time_and_speed_are_those_of_differences():
    times, values = cycle(9)

    def pull(parameters):
        energy, ratio, time, speed = parameters
        one = jnp.ones(())
        contact = viscoelastic(jnp.stack([ratio, one]), jnp.stack([time, one]), energy)
        load = js.MeanDisplacement(values)
        found = js.evolve(contact, load, times / speed, rtol=ANY, max_steps=16)
        return found.force[6] + found.dissipated[6]

    point = jnp.array([0.002, 2.0, 0.1, 1.0])
    gradient = jax.grad(pull)(point)
    for i, derivative in enumerate(gradient):
        step = 1e-5 * point[i] * jnp.eye(4)[i]
        difference = (pull(point + step) - pull(point - step)) / (2e-5 * point[i])
        assert derivative == pytest.approx(float(difference), rel=1e-5)


def test_single_precision_agrees_to_its_digits():
    times, values = cycle(9)
    contact = viscoelastic()
    single = js.Contact(contact.solid, contact.heights.astype("float32"), contact.potential)
    load = js.MeanDisplacement(values)
    both = [js.evolve(c, load, times, rtol=ANY).mean_pressure for c in (contact, single)]
    assert both[1].dtype == "float32"
    assert np.array(both[1]) == pytest.approx(np.array(both[0]), abs=1e-4)


def test_mistakes_are_named():
    contact, (times, values) = viscoelastic(), cycle()
    load = js.MeanDisplacement(values)
    relaxed = relaxed_of(contact)
    with pytest.raises(TypeError, match="HalfSpace is no solid with relaxation times"):
        js.evolve(relaxed, load, times)
    with pytest.raises(ValueError, match=r"\(20,\).*\(21,\)"):
        js.evolve(contact, load, times[1:])
    with pytest.raises(ValueError, match="the times must increase"):
        js.evolve(contact, load, times.at[3].set(0.0))
    # In the precision of the contact they are one time.
    single = js.Contact(contact.solid, contact.heights.astype("float32"), contact.potential)
    with pytest.raises(ValueError, match=r"1000000\.0 at \(\d,\): the times must increase, in flo"):
        js.evolve(single, load, 1e6 + 0.01 * times)
    with pytest.raises(js.SolverError, match="has no start at t = 0, under MeanDisplacement"):
        js.evolve(contact, js.MeanDisplacement(values - 1), times)
    with pytest.raises(ValueError, match="max_steps is 0"):
        js.evolve(contact, load, times, max_steps=0)
    with pytest.raises(ValueError, match=r"until is -1\.0"):
        js.lifetime(contact, js.MeanPressure(0.1), until=-1.0)
    with pytest.raises(TypeError, match=r"lifetime works on known numbers.* outside of jax\.jit"):
        jax.jit(lambda value: js.lifetime(contact, js.MeanPressure(value)))(0.1)
    found = js.evolve(contact, load, times, rtol=ANY)
    with pytest.raises(ValueError, match="fields=True"):
        _ = found[3].internal
    with pytest.raises(TypeError, match="Contact is no evolution"):
        js.growth_rate(contact)


def test_times_that_do_not_increase_have_no_states_under_jit():
    contact, (times, values) = viscoelastic(), cycle(5)

    @jax.jit
    def found(times):
        load = js.MeanDisplacement(values)
        return js.evolve(contact, load, times, rtol=ANY, max_steps=4, throw=False)

    run = found(times.at[2].set(times[1]))
    assert np.isnan(run.mean_pressure).tolist() == [False, False, True, True, True]
    assert run.result.name.tolist() == 2 * ["successful"] + 3 * ["unordered_times"]
    assert run.num_steps.sum() == 1


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


def test_full_contact_opens_under_a_mean_gap():
    contact = viscoelastic(energy=0.02)
    relaxed = relaxed_of(contact)
    rest = js.equilibrate(relaxed, js.MeanPressure(0.0))
    assert rest.contact_area == 1
    held = js.MeanGap(jnp.full(2, 0.01))
    found = js.evolve(contact, held, jnp.array([0.0, 1.0]), initial=rest)
    assert np.array(found.mean_gap) == pytest.approx(0.01, rel=1e-9)
    assert np.all(np.isfinite(found.mean_pressure))


@pytest.fixture(scope="module")
def begun():
    times, values = cycle(3)
    return js.evolve(viscoelastic(), js.MeanDisplacement(values), times, rtol=ANY)


def test_an_initial_evolution_of_a_contact_that_is_built_anew_is_taken(begun):
    again = js.evolve(viscoelastic(), begun.load, begun.times, rtol=ANY, initial=begun)
    assert again.result[-1] == "successful"


@pytest.mark.parametrize(
    ("other", "differing"),
    [
        ({"energy": 0.003}, "potential"),
        ({"ratios": (2.0, 1.5)}, "solid"),
        ({"ratios": 3.0, "times": 1.0}, "solid"),
        ({"n": 16}, "solid and another heights"),
    ],
)
def test_an_initial_evolution_of_another_contact_is_refused(begun, other, differing):
    load, times = begun.load, begun.times
    with pytest.raises(ValueError, match=f"another {differing} than the contact"):
        js.evolve(viscoelastic(**other), load, times, rtol=ANY, initial=begun)


def test_lifetime_ends_between_the_relaxed_and_the_glassy_pull_off():
    contact = viscoelastic(energy=0.001)
    relaxed = relaxed_of(contact)
    pull = js.pull_off(relaxed)
    strength = float(pull.load.value)
    assert strength < 0
    assert js.lifetime(contact, js.MeanPressure(0.99 * strength)) == np.inf
    times = [js.lifetime(contact, js.MeanPressure(part * strength)) for part in (1.001, 1.01, 1.1)]
    assert times[0] > 2 * times[1] > 4 * times[2] > 0
    assert js.lifetime(contact, js.MeanPressure(100 * strength)) == 0


@pytest.mark.parametrize("part", [2, 9])
def test_a_lifetime_in_coarse_steps_is_the_one_in_fine_steps(part):
    contact = viscoelastic(energy=0.003)
    relaxed = relaxed_of(contact)
    rest = js.equilibrate(relaxed, js.MeanDisplacement(0.01))
    held = js.Spring(float(np.linspace(0.128, 0.1335, 40)[part]), 0.5)
    # In shorter steps the contact outlasts the interval in which longer ones lost it.
    times = [js.lifetime(contact, held, initial=rest, rtol=rtol) for rtol in (0.03, 1e-3)]
    assert times[0] == pytest.approx(times[1], rel=0.1)
