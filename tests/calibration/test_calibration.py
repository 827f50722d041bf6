"""Fits to curves with known noise: the truth is recovered, with errors that cover it."""

import importlib
import signal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact
from programs import compilations

import jaxstab as js

LOAD = js.MeanGap(jnp.linspace(0.05, 0.5, 16))
GAMMA, RHO = 0.02, 0.1


def potential(contact):
    return contact.potential


@pytest.fixture(scope="module")
def start():
    return rough_contact(16, js.potentials.Exponential(0.04, 0.07))


@pytest.fixture(scope="module")
def exact(start):
    truth = eqx.tree_at(potential, start, js.potentials.Exponential(GAMMA, RHO))
    solve = jax.vmap(lambda load: js.equilibrate(truth, load, throw=False).mean_pressure)
    return solve(LOAD)


@pytest.mark.nightly
def test_errors_are_those_of_linear_least_squares_also_of_loads_that_tell_nothing():
    grid = js.Grid((32,))
    contact = js.Contact(
        js.HalfSpace(grid, 1.0), js.surfaces.sinusoid(grid, 0.02), js.potentials.NoAdhesion()
    )
    # Half of them are out of contact.
    loads = js.MeanGap(jnp.linspace(0.004, 0.036, 16))
    noise = 5e-4 * np.random.default_rng(0).normal(size=16)
    slope = np.array([js.equilibrate(contact, load).mean_pressure for load in loads])
    assert (slope == 0).sum() >= 7
    fit = js.calibrate(
        contact, loads, slope + noise, where=lambda c: c.solid.youngs_modulus, tolerance=1e-8
    )
    modulus = 1 + noise @ slope / (slope @ slope)
    misfit = (modulus - 1) * slope - noise
    error = np.sqrt(misfit @ misfit / 15 / (slope @ slope))
    np.testing.assert_allclose([fit.parameters, fit.standard_errors], [modulus, error], rtol=1e-5)


@pytest.fixture(scope="module")
def exact_fit(start, exact):
    with compilations() as compiled:
        fit = js.calibrate(start, LOAD, exact)
    # The curve and the area, beside three for the resolution of the contact: a search is NumPy's.
    assert compiled.count("jit(curve)") == 1 and len(compiled) <= 5
    return fit


@pytest.mark.parametrize(
    "order", [pytest.param("independent", marks=pytest.mark.nightly), "continuation"]
)
def test_an_exact_curve_gives_potential_and_modulus_exactly(start, exact, exact_fit, order):
    is_default = order == "continuation"
    fit = exact_fit if is_default else js.calibrate(start, LOAD, exact, order=order)
    law, modulus = fit.parameters
    found = [law.surface_energy, law.length, modulus]
    np.testing.assert_allclose(found, [GAMMA, RHO, 1.0], rtol=1e-5)
    np.testing.assert_allclose(fit.mean_pressure, exact, atol=1e-6 * abs(exact).max())
    assert fit.residual <= 1e-6 and fit.num_minima == 1
    assert fit.contact.solid.youngs_modulus == modulus


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [0, 3])
def test_an_interrupt_loses_no_fit_that_has_ended(start, exact, number, monkeypatch):
    module = importlib.import_module("jaxstab.calibration.search")
    minimise = module.minimise
    done = []

    def interrupted(*args):
        if len(done) == number:
            signal.raise_signal(signal.SIGINT)
        done.append(minimise(*args))
        return done[-1]

    monkeypatch.setattr(module, "minimise", interrupted)
    if number == 0:
        with pytest.raises(KeyboardInterrupt):
            js.calibrate(start, LOAD, exact)
        return
    with pytest.warns(js.exceptions.FitWarning, match="interrupted: 3 fits are done"):
        fit = js.calibrate(start, LOAD, exact)
    assert fit.result == "interrupted"
    law, modulus = fit.parameters
    np.testing.assert_allclose([law.surface_energy, law.length, modulus], [GAMMA, RHO, 1.0], 1e-5)


# These contacts jump, on surfaces of different seeds.
TRUE = np.array([0.02, 0.1, 0.15])
RETRACTION = jnp.linspace(0.02, 0.5, 20)


def contact_with(parameters, seed):
    energy, length, modulus = parameters
    law = js.potentials.Exponential(energy, length)
    return rough_contact(16, law, youngs_modulus=modulus, seed=seed)


def measured(loads, seed, noise, number=0):
    """A curve as it is measured, and its noise relative to its largest pressure."""
    states = js.sweep(contact_with(TRUE, seed), loads, order="continuation", stability=False)
    pressures = np.asarray(states.equilibrium.mean_pressure)
    normal = np.random.default_rng(number).normal(size=pressures.size)
    return pressures + noise * abs(pressures).max() * normal


def found(fit):
    """The parameters of a fit and their standard errors."""
    numbers = [jax.tree.leaves(x) for x in (fit.parameters, fit.standard_errors)]
    return np.array(numbers)


@pytest.mark.nightly
@pytest.mark.parametrize("leg", [RETRACTION, RETRACTION[::-1]], ids=["retraction", "approach"])
def test_curves_with_jumps_are_fitted_in_the_order_of_the_measurement(leg):
    loads = js.MeanGap(leg)
    for seed, factors in enumerate([(2, 0.7, 1.3), (0.5, 1.5, 0.7)]):
        guess = contact_with(TRUE * factors, seed)
        values, _ = found(js.calibrate(guess, loads, measured(loads, seed, 0)))
        np.testing.assert_allclose(values, TRUE, rtol=1e-5)
    away = []
    for number in range(1, 5):
        guess, curve = (
            contact_with(1.2 * TRUE, number % 2),
            measured(loads, number % 2, 0.01, number),
        )
        values, errors = found(js.calibrate(guess, loads, curve))
        assert (errors < 0.05 * TRUE).all()
        away.append(abs(values - TRUE) / errors)
    # Student's t with 17 degrees of freedom leaves 6 % beyond two.
    assert np.mean(np.array(away) < 2) >= 0.85 and np.max(away) < 3.5


@pytest.mark.nightly
def test_several_starts_are_tried_and_the_best_fit_counts():
    loads = js.MeanGap(RETRACTION)
    curve = measured(loads, 0, 0.01, 1)
    guess = contact_with(TRUE * (2, 0.7, 1.3), 0)
    fit = js.calibrate(guess, loads, curve, starts=3)
    assert fit.losses.shape == (3,) and fit.loss <= fit.losses.min()
    assert "not_computed" not in fit.results.name
    values, errors = found(fit)
    assert (abs(values - TRUE) < 2 * errors).all()


def test_failure_is_told(start, exact):
    with pytest.raises(
        js.exceptions.SolverError, match=r"The fit did not converge in 1 steps.*max_steps"
    ):
        js.calibrate(start, LOAD, exact, max_steps=1)
    unreachable = js.MeanGap(LOAD.value.at[3].set(-1.0))
    fit = js.calibrate(start, unreachable, exact, throw=False)
    assert fit.result == js.RESULTS.nonfinite
    with pytest.raises(js.exceptions.SolverError, match=r"1 of 16 loads have no.* number 3 .*unit"):
        js.calibrate(start, unreachable, exact)
    # A weight of zero leaves it out.
    weights = jnp.ones(16).at[3].set(0)
    fit = js.calibrate(start, unreachable, exact, weights=weights)
    np.testing.assert_allclose(fit.parameters[0].length, RHO, rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean_pressure": jnp.ones(3)}, "as many of one as of the other"),
        ({"mean_pressure": jnp.full(16, jnp.nan)}, "curve is nan at"),
        ({"weights": -jnp.ones(16)}, "not negative"),
        ({"weights": jnp.ones(3)}, "The weights have shape"),
        ({"load_error": jnp.ones(3)}, "error of the loads has shape"),
        ({"forces": jnp.ones(16)}, "Give the measurements once"),
        ({"baseline": True, "mean_pressure": jnp.ones(16)}, "differ from the others"),
        ({"order": "random"}, "choose"),
        ({"load": js.MeanGap(jnp.ones(2)), "mean_pressure": jnp.ones(2)}, "2 parameters for 2"),
        ({"weights": jnp.zeros(16).at[0].set(1)}, "2 parameters for 1"),
        ({"mean_pressure": jnp.zeros(16)}, "norm of the measurements is 0.0: .* differ from zero"),
        # The mean of equal numbers is rounded.
        ({"baseline": True, "mean_pressure": jnp.full(16, 0.1)}, "differ from the others"),
        ({"starts": 0}, "starts is 0: give at least 1"),
        ({"max_steps": 0}, "max_steps is 0: give at least 1"),
        ({"tolerance": 0.0}, "tolerance is 0.0: it must be positive"),
        ({"where": lambda contact: (contact.potential,) * 2}, "picks a parameter twice"),
    ],
)
def test_impossible_input_is_refused(start, exact, change, message):
    arguments = {"load": LOAD, "mean_pressure": exact, "where": potential} | change
    with pytest.raises(ValueError, match=message):
        js.calibrate(start, **arguments)


@pytest.mark.parametrize("transformed", [jax.jit, jax.vmap])
def test_transformations_are_refused(start, exact, transformed):
    def loss(curve):
        return js.calibrate(start, LOAD, curve).loss

    with pytest.raises(TypeError, match="calibrate works on known numbers"):
        transformed(loss)(exact[None])


class Bonds(eqx.Module):
    """An exponential law with a number of bonds that is no parameter."""

    strength: jax.Array
    bonds: jax.Array

    def __call__(self, gap):
        return -self.bonds * self.strength * jnp.exp(-gap / RHO)


@pytest.mark.nightly
def test_what_is_not_determined_or_no_number_is_not_fitted(start, exact):
    law = Bonds(jnp.array(0.008), jnp.array(2))
    fit = js.calibrate(eqx.tree_at(potential, start, law), LOAD, exact, where=potential)
    np.testing.assert_allclose(fit.parameters.strength, GAMMA / 2, rtol=1e-6)
    assert fit.parameters.bonds == 2
    assert fit.covariance.shape == (1, 1)


def test_a_pick_that_is_written_anew_is_not_compiled_anew(start, exact, exact_fit):
    with compilations() as compiled:
        again = js.calibrate(
            start,
            LOAD,
            exact,
            where=lambda contact: (contact.potential, contact.solid.youngs_modulus),
        )
    assert compiled == []
    np.testing.assert_array_equal(again.covariance, exact_fit.covariance)
    with pytest.raises(TypeError, match="may only pick"):
        js.calibrate(start, LOAD, exact, where=lambda contact: 2 * contact.potential.length)


class Offset(eqx.Module):
    """An exponential law with a constant pressure, which may have any sign."""

    strengths: jax.Array
    push: jax.Array

    def __call__(self, gap):
        return -self.strengths[0] * jnp.exp(-gap / self.strengths[1]) - self.push * gap


def push(contact):
    return contact.potential.push


@pytest.mark.nightly
def test_a_parameter_of_any_sign_is_fitted_in_any_units(start, exact):
    unit = 1e-9
    law = Offset(unit * jnp.array([GAMMA, RHO / unit]), jnp.array(0.0))
    guess = js.Contact(js.HalfSpace(start.grid, unit), start.heights, law)
    fit = js.calibrate(guess, LOAD, unit * (exact + 0.004), where=push)
    np.testing.assert_allclose(fit.parameters, 0.004 * unit, rtol=1e-5)


def test_single_precision_is_refused(start, exact):
    single = js.Contact(start.solid, start.heights.astype(jnp.float32), start.potential)
    with pytest.raises(TypeError, match="float32: a fit needs float64"):
        js.calibrate(single, LOAD, exact, where=potential)


def test_a_load_that_prescribes_the_pressure_is_refused(start, exact):
    with pytest.raises(TypeError, match="MeanPressure"):
        js.calibrate(start, js.MeanPressure(exact), exact)
