"""Prony series from measured relaxation and creep, and time-temperature superposition."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import jaxstab as js

SOLID = js.HalfSpace(js.Grid(16), 2.0, 0.3)
TIMES = np.logspace(-3, 2, 51)
# Moduli, and times on the grid of a fit and between its points.
SERIES = [((6.0,), (0.1,)), ((6.0,), (0.47,)), ((9.0, 30.0, 2.0), (0.01, 0.119, 3.3))]
RELAXED = 3.0
# A law, and sweeps over three decades at five temperatures, in degrees Celsius.
C1, C2, REFERENCE = 8.0, 110.0, 20.0
HEAT = np.repeat([-20.0, 0.0, 20.0, 40.0, 60.0], 13)
SWEEP = np.tile(np.logspace(-1, 2, 13), 5)


def shift(temperature):
    return 10 ** (-C1 * (temperature - REFERENCE) / (C2 + temperature - REFERENCE))


def relaxation(moduli, times, t):
    return RELAXED + np.exp(-np.divide.outer(t, times)) @ np.array(moduli)


def creep(moduli, times, t):
    """Return the strain under a unit stress, of springs and Maxwell elements in parallel.

    The strain e and the dashpots' strains d follow from sum E (e - d) + E_relaxed e = 1 and
    t_k d'_k = e - d_k.
    """
    moduli = np.array(moduli)
    total = RELAXED + moduli.sum()
    rates = (np.outer(np.ones(len(moduli)), moduli / total) - np.eye(len(moduli))) / np.array(
        times
    )[:, None]
    source = 1 / (total * np.array(times))
    ends = np.linalg.solve(rates, -source)
    dashpots = [ends - expm(rates * one) @ ends for one in t]
    return (1 + np.array(dashpots) @ moduli) / total


def modulus(solid):
    return float(solid.relaxed.youngs_modulus)


def assert_series(found, moduli, times):
    """Each term is shared by the nearest times of a fit."""
    np.testing.assert_allclose(modulus(found), RELAXED, rtol=2e-3)
    for one, time in zip(moduli, times, strict=True):
        near = abs(np.log10(np.asarray(found.times) / time)) < 0.25
        sum_near = modulus(found) * np.asarray(found.ratios)[near].sum()
        np.testing.assert_allclose(sum_near, one, rtol=0.03)


@pytest.mark.parametrize(("moduli", "times"), SERIES)
def test_a_series_is_found_from_its_relaxation(moduli, times):
    measured = relaxation(moduli, times, TIMES)
    found = js.Viscoelastic.from_relaxation(SOLID, TIMES[::-1], measured[::-1])
    assert_series(found, moduli, times)
    fitted = modulus(found) * (1 + np.exp(-np.divide.outer(TIMES, found.times)) @ found.ratios)
    missed = np.max(abs(fitted - measured) / measured)
    np.testing.assert_allclose(missed, found.fit_error, rtol=1e-6, atol=1e-14)
    assert found.fit_error < 5e-3
    assert found.relaxed.poisson_ratio == SOLID.poisson_ratio and found.shift is None


@pytest.mark.parametrize(("moduli", "times"), SERIES)
def test_a_series_is_found_from_its_creep(moduli, times):
    measured = creep(moduli, times, TIMES)
    found = js.Viscoelastic.from_creep(SOLID, TIMES, measured)
    assert_series(found, moduli, times)
    assert found.fit_error < 5e-3
    # Its creep, by the same equations, is as far from the data as it says.
    scaled = modulus(found) / RELAXED
    again = creep(RELAXED * np.asarray(found.ratios), found.times, TIMES) / scaled
    missed = np.max(abs(again - measured) / measured)
    np.testing.assert_allclose(missed, found.fit_error, rtol=1e-6, atol=1e-13)


def test_the_creep_of_a_standard_linear_solid_is_exact():
    # J = 1 / E - (1 / E - 1 / (E + E_1)) exp(-t / tau), with t_1 (E + E_1) / E = tau, on the grid.
    tau, added = 0.1, 6.0
    retarded = 1 / RELAXED - 1 / (RELAXED + added)
    measured = 1 / RELAXED - retarded * np.exp(-TIMES / tau)
    found = js.Viscoelastic.from_creep(SOLID, TIMES, measured)
    np.testing.assert_allclose(found.times, [tau * RELAXED / (RELAXED + added)], rtol=1e-9)
    np.testing.assert_allclose(found.ratios, [added / RELAXED], rtol=1e-9)
    np.testing.assert_allclose(modulus(found), RELAXED, rtol=1e-9)
    assert found.fit_error < 1e-12
    assert creep([added], found.times, TIMES) == pytest.approx(measured, rel=1e-9)


def test_the_relaxation_beside_a_creep_is_exact_over_many_decades():
    # As many decades as of sweeps at many temperatures.
    wide = np.logspace(-12, 6, 37)
    retardation, compliances = np.logspace(-11, 5, 9), np.logspace(-9, 0, 9)
    measured = 1e-9 + -np.expm1(-np.divide.outer(wide, retardation)) @ compliances
    found = js.Viscoelastic.from_creep(SOLID, wide, measured)
    assert found.fit_error < 1e-6
    # s E(s) s J(s) = 1 at rates between.
    s = np.logspace(-7, 13, 41)
    transform = modulus(found) * (1 + (s[:, None] / (s[:, None] + 1 / found.times)) @ found.ratios)
    inverse = 1e-9 + (1 / (1 + np.outer(s, retardation))) @ compliances
    np.testing.assert_allclose(transform * inverse, 1, rtol=1e-5)


def sweeps(kind, noise=0.0):
    """Return the fit, the reduced argument, and the values of a solid at five temperatures."""
    moduli, times = (90.0, 30.0, 9.0), (1e-3, 0.05, 2.0)
    random = 1 + noise * np.random.default_rng(3).normal(size=SWEEP.size)
    if kind == "oscillation":
        turns = 1j * np.outer(SWEEP * shift(HEAT), times)
        values = RELAXED + (turns / (1 + turns)) @ moduli
        return js.Viscoelastic.from_storage_and_loss, SWEEP, (values.real * random, values.imag)
    reduced = SWEEP / shift(HEAT)
    if kind == "relaxation":
        return (
            js.Viscoelastic.from_relaxation,
            SWEEP,
            (relaxation(moduli, times, reduced) * random,),
        )
    return js.Viscoelastic.from_creep, SWEEP, (creep(moduli, times, reduced) * random,)


@pytest.mark.parametrize("kind", ["oscillation", "relaxation", "creep"])
def test_the_constants_of_a_shift_over_the_temperature_are_recovered(kind):
    fit, arguments, values = sweeps(kind)
    found = fit(SOLID, arguments, *values, HEAT)
    assert found.fit_error < 0.02
    assert found.shift.reference_temperature == REFERENCE
    temperatures = np.linspace(-20, 60, 9)
    factors = np.log10(found.shift.factor(temperatures))
    np.testing.assert_allclose(factors, np.log10(shift(temperatures)), atol=0.03)
    np.testing.assert_allclose([found.shift.c1, found.shift.c2], [C1, C2], rtol=0.03)
    np.testing.assert_allclose(modulus(found), RELAXED, rtol=0.02)
    # Another reference gives the same solid, at another temperature.
    other = fit(SOLID, arguments, *values, HEAT, reference_temperature=50.0)
    np.testing.assert_allclose(other.shift.reference_temperature, 50)
    warm = found.at_temperature(50.0)
    np.testing.assert_allclose(np.log10(warm.times[0] / other.times[0]), 0, atol=0.2)
    np.testing.assert_allclose(
        warm.storage_and_loss(1.0), other.storage_and_loss(1.0), rtol=0.02, atol=1e-3
    )


def test_noise_and_deviations_of_the_temperature_leave_the_shift_near():
    fit, arguments, values = sweeps("oscillation", noise=0.02)
    # As an instrument notes it, beside its order of sweeps.
    wobble = HEAT + 0.1 * np.sin(np.arange(HEAT.size))
    order = np.random.default_rng(0).permutation(HEAT.size)
    columns = (column[order] for column in (arguments, *values, wobble))
    found = fit(SOLID, *columns, reference_temperature=REFERENCE)
    assert 0.02 < found.fit_error < 0.1
    factors = np.log10(found.shift.factor(np.array([-20.0, 0.0, 40.0, 60.0])))
    expected = np.log10(shift(np.array([-20.0, 0.0, 40.0, 60.0])))
    np.testing.assert_allclose(factors, expected, atol=0.1)


def test_a_shift_is_a_law_that_can_be_given_moved_batched_and_differentiated():
    law = js.solids.WilliamsLandelFerry(C1, C2, REFERENCE)
    temperatures = np.array([-20.0, 20.0, 47.0])
    np.testing.assert_allclose(law.factor(temperatures), shift(temperatures))
    moved = law.referred_to(47.0)
    np.testing.assert_allclose(moved.factor(temperatures), shift(temperatures) / shift(47.0))
    solid = js.Viscoelastic(SOLID, (2.0, 1.0), (0.1, 1.0), law)
    warm = solid.at_temperature(47.0)
    np.testing.assert_allclose(warm.times, shift(47.0) * np.array([0.1, 1.0]))
    np.testing.assert_allclose(warm.at_temperature(REFERENCE).times, solid.times, rtol=1e-12)
    np.testing.assert_allclose(warm.shift.c2, moved.c2)
    batch = jax.jit(jax.vmap(lambda t: solid.at_temperature(t).times))(jnp.array([20.0, 47.0, -95]))
    np.testing.assert_allclose(batch[:2], [solid.times, warm.times])
    assert np.isnan(batch[2]).all()
    slope = jax.grad(lambda t: jnp.log10(law.factor(t)))(47.0)
    np.testing.assert_allclose(slope, -C1 * C2 / (C2 + 27) ** 2)


def test_a_shift_stays_with_a_solid_in_a_file(tmp_path):
    law = js.solids.WilliamsLandelFerry(C1, C2, REFERENCE)
    solid = js.Viscoelastic(SOLID, 2.0, 0.1, law)
    heights = js.surfaces.paraboloid(SOLID.grid, 2.0)
    contact = js.Contact(solid, heights, js.potentials.Exponential(0.1, 0.2))
    js.save(tmp_path / "state.nc", contact, js.equilibrate(contact, js.MeanGap(0.3)))
    kept, _ = js.load(tmp_path / "state.nc")
    assert kept.solid.shift.factor(40.0) == law.factor(40.0)
    assert "c1=8, c2=110, reference_temperature=20" in repr(kept.solid)


@pytest.mark.parametrize(
    ("name", "times", "values", "named"),
    [
        ("from_relaxation", (1.0, 2.0, 1.0), (3.0, 2.0, 3.0), r"time 1\.0 is given 2 times: avera"),
        ("from_relaxation", (1.0, 2.0), (3.0, -1.0), r"relaxation modulus is -1\.0 at \(1,\)"),
        ("from_relaxation", (0.0, 2.0), (3.0, 1.0), r"time is 0\.0"),
        ("from_relaxation", (1.0, 2.0), (3.0, 3.0), "elastic solid of modulus 3: use that"),
        ("from_relaxation", (1.0, 2.0, 4.0), np.exp([-1, -2, -4.0]), "liquid. Give later times"),
        ("from_creep", (1.0, 2.0), (0.2, np.nan), "creep compliance is nan"),
        ("from_creep", (1.0, 2.0), (0.2, 0.2), "elastic solid of modulus 5: use that"),
        ("from_creep", (0.1, 1.0, 10.0), (0.1, 1.0, 10.0), "at once is 0.*give earlier times"),
        ("from_creep", (1.0, 2.0), (0.2,), r"\(2,\) of the time, \(1,\) of the creep compliance"),
    ],
)
def test_relaxation_and_creep_of_no_solid_are_named(name, times, values, named):
    with pytest.raises(ValueError, match=named):
        getattr(js.Viscoelastic, name)(SOLID, times, values)


def test_temperatures_without_a_shift_are_refused_with_the_cure():
    fit = js.Viscoelastic.from_relaxation
    values = relaxation((90.0, 30.0, 9.0), (1e-3, 0.05, 2.0), SWEEP / shift(HEAT))
    two = HEAT < 10
    for chosen, at in ((two, "-20, 0"), (HEAT < -10, "-20")):
        with pytest.raises(ValueError, match=f"temperatures {at}, .*give data at 3 or more"):
            fit(SOLID, SWEEP[chosen], values[chosen], HEAT[chosen])
    with pytest.raises(ValueError, match=r"given 2 times at the temperature -20: average"):
        fit(SOLID, np.append(SWEEP, SWEEP[0]), np.append(values, 1.0), np.append(HEAT, HEAT[0]))
    with pytest.raises(ValueError, match="must rise, as a solid relaxes faster"):
        fit(SOLID, SWEEP, values, -HEAT)
    short = (SWEEP < 1) & (HEAT != 20)
    with pytest.raises(ValueError, match=r"of the 4 temperatures have no relaxation modulus in"):
        fit(SOLID, SWEEP[short], values[short], HEAT[short])
    with pytest.raises(ValueError, match="data have no temperatures: give the temperature of each"):
        fit(SOLID, SWEEP[:13], values[:13], reference_temperature=20.0)
    with pytest.raises(ValueError, match=r"temperature is -200.0: the law diverges at -9"):
        fit(SOLID, SWEEP, values, HEAT, reference_temperature=-200.0)
    with pytest.raises(ValueError, match="temperature is nan"):
        fit(SOLID, SWEEP, values, np.where(HEAT == 0, np.nan, HEAT))
    with pytest.raises(ValueError, match=r"has no shift.*give it as `shift`"):
        js.Viscoelastic(SOLID, 1.0, 1.0).at_temperature(20.0)
    for bad, named in (
        ((-1.0, 1.0, 0.0), "C1 is -1"),
        ((1.0, 0.0, 0.0), "C2 is 0"),
        ((1.0, 1.0, np.inf), "reference temperature is inf"),
    ):
        with pytest.raises(ValueError, match=named):
            js.solids.WilliamsLandelFerry(*bad)
