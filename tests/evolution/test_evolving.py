"""Viscoelastic contacts in time: going on, interrupts, failures and refusals."""

import importlib
import signal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from programs import compilations
from viscoelastic_lines import ANY, cycle, relaxed_of, viscoelastic

import jaxstab as js


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
    module = importlib.import_module("jaxstab.evolution.evolve")
    found, calls = module.follow_leg, []

    def interrupted(*inputs):
        calls.append(1)
        if len(calls) > 4:
            raise KeyboardInterrupt
        return found(*inputs)

    monkeypatch.setattr(module, "follow_leg", interrupted)
    with pytest.warns(js.exceptions.PathInterrupted, match="3 of 8 times"):
        first = js.evolve(contact, load, times, rtol=ANY)
    monkeypatch.undo()
    assert len(first) == len(first.load.value) == 4
    rest = js.evolve(contact, load[3:], times[3:], rtol=ANY, initial=first)
    assert rest.mean_pressure == pytest.approx(np.array(whole.mean_pressure[3:]), abs=1e-12)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_after_the_last_time_loses_nothing(monkeypatch):
    contact, (times, values) = viscoelastic(), cycle(9)
    whole = js.evolve(contact, js.MeanDisplacement(values), times, rtol=ANY)
    module = importlib.import_module("jaxstab.evolution.evolve")
    stack = module.stack_of

    def interrupted(*inputs):
        signal.raise_signal(signal.SIGINT)
        return stack(*inputs)

    monkeypatch.setattr(module, "stack_of", interrupted)
    with pytest.warns(js.exceptions.PathInterrupted, match="after its last time; it is complete"):
        found = js.evolve(contact, js.MeanDisplacement(values), times, rtol=ANY)
    np.testing.assert_array_equal(found.work, whole.work)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.nightly
def test_after_a_failure_there_are_no_numbers_and_it_goes_on_from_the_last_state():
    contact, times = viscoelastic(), jnp.linspace(0, 4, 5)
    load = js.MeanPressure(jnp.linspace(0, -0.16, 5))
    found = js.evolve(contact, load, times, throw=False, fields=True)
    assert found.result.name.tolist() == 2 * ["successful"] + 3 * ["pulled_off"]
    assert 1 < found.reached < 2
    assert "nan" in repr(found) and "+nan" not in repr(found)
    for name in (
        "mean_gap",
        "mean_pressure",
        "contact_area",
        "work",
        "stored",
        "viscous_dissipation",
    ):
        assert np.isnan(getattr(found, name)).tolist() == [False, False, True, True, True]
    assert np.all(np.isnan(found.fields.gap[2:]))
    assert np.isnan(js.growth_rate(found)) and np.isnan(js.growth_rate(found[-1]))
    with pytest.raises(js.exceptions.SolverError, match="no_equilibrium"):
        js.assess_stability(found[-1])
    with pytest.raises(TypeError, match="holds its equilibrium: give no other beside it"):
        js.assess_stability(found[-1], found[-1].instant[1])
    # The last state was found, still in contact.
    place = float(jnp.interp(found.reached, times, load.value))
    held = js.MeanPressure(jnp.full(2, place))
    rest = js.evolve(
        contact, held, found.reached + jnp.array([0, 1e-9]), initial=found, fields=True
    )
    assert rest.contact_area[0] > 0
    with pytest.raises(ValueError, match="start from a state that was found"):
        js.evolve(contact, load, times, initial=found[2])


def test_another_contact_and_load_compile_nothing():
    times, values = cycle(9)
    js.evolve(viscoelastic(), js.MeanDisplacement(values), times, rtol=ANY)
    with compilations() as compiled:
        js.evolve(viscoelastic(energy=0.0021), js.MeanDisplacement(1.01 * values), times, rtol=ANY)
    assert not compiled


@pytest.mark.nightly
def test_a_tolerance_below_the_rounding_of_equilibria_is_named():
    times, values = cycle(9)

    def end(energy):
        load, contact = js.MeanDisplacement(values), viscoelastic(energy=energy)
        return js.evolve(contact, load, times, rtol=1e-6, max_steps=16).mean_pressure[-1]

    # Also where derivatives are taken.
    for call in (end, jax.grad(end)):
        with pytest.raises(
            js.exceptions.SolverError, match=r"with rtol = 1e-06: store_full.*raise `rtol`"
        ):
            call(0.002)


@pytest.mark.parametrize(
    ("error", "options", "sentence"),
    [
        (ValueError, {"until": -1.0}, r"until is -1\.0"),
        (ValueError, {"until": [1.0, 2.0]}, r"until has shape \(2,\): give one number"),
        (TypeError, {"initial": jnp.zeros(32)}, r"Array.* is no state: give one of equilibrate or"),
    ],
)
def test_mistakes_of_a_lifetime_are_named(error, options, sentence):
    with pytest.raises(error, match=sentence):
        js.lifetime(viscoelastic(), js.MeanPressure(0.1), **options)


def test_mistakes_are_named():
    contact, (times, values) = viscoelastic(), cycle()
    load = js.MeanDisplacement(values)
    # In the precision of the contact they are one time.
    single = js.Contact(contact.solid, contact.heights.astype("float32"), contact.potential)
    alike = 1e6 + 0.01 * times
    unknown = load.at(values.at[3].set(jnp.nan))
    for error, arguments, options, sentence in [
        (TypeError, (relaxed_of(contact), load, times), {}, "HalfSpace is no solid with relaxatio"),
        (ValueError, (contact, load, times[1:]), {}, r"\(20,\).*\(21,\)"),
        (ValueError, (contact, load, times.at[3].set(0.0)), {}, "the times must increase"),
        (ValueError, (contact, unknown, times), {}, r"The load is nan at \(3,\)"),
        (ValueError, (single, load, alike), {}, r"1000000\.0 at \(\d,\): the times must increase"),
        (
            js.exceptions.SolverError,
            (contact, load.at(values - 1), times),
            {},
            "no start at t = 0, under",
        ),
        (ValueError, (contact, load, times), {"max_steps": 0}, "max_steps is 0"),
        (ValueError, (contact, load, times), {"rtol": [1e-3, 1e-4]}, r"rtol has shape \(2,\)"),
    ]:
        with pytest.raises(error, match=sentence):
            js.evolve(*arguments, **options)
    with pytest.raises(TypeError, match=r"lifetime works on known numbers.* outside of jax\.jit"):
        jax.jit(lambda value: js.lifetime(contact, js.MeanPressure(value)))(0.1)
    found = js.evolve(contact, load, times, rtol=ANY)
    with pytest.raises(ValueError, match="fields=True"):
        _ = found[3].memory
    with pytest.raises(TypeError, match="Contact is no evolution"):
        js.growth_rate(contact)


@pytest.mark.nightly
def test_times_that_do_not_increase_have_no_states_under_jit():
    contact, (times, values) = viscoelastic(), cycle(5)

    @jax.jit
    def found(times, rtol):
        load = js.MeanDisplacement(values)
        return js.evolve(contact, load, times, rtol=rtol, max_steps=4, throw=False)

    run = found(times.at[2].set(times[1]), ANY)
    assert np.isnan(run.mean_pressure).tolist() == [False, False, True, True, True]
    assert run.result.name.tolist() == 2 * ["successful"] + 3 * ["unordered_times"]
    assert run.num_steps.sum() == 1
    # Nor has any time after the first at a tolerance that is refused otherwise.
    assert found(times, -1.0).result.name.tolist() == ["successful"] + 4 * ["store_full"]


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
