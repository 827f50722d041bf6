"""Prony series from measured relaxation and creep, and time-temperature superposition."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import jaxstab as js
from jaxstab.solids import Arrhenius, RelaxationWarning, ShiftTable, WilliamsLandelFerry

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
    law = WilliamsLandelFerry(C1, C2, REFERENCE)
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


@pytest.mark.nightly
def test_a_shift_stays_with_a_solid_in_a_file(tmp_path):
    law = WilliamsLandelFerry(C1, C2, REFERENCE)
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
        ("from_relaxation", (1.0, 2.0), (3.0, -1.0), r"relaxation modulus is -1\.0 at \(1,\)"),
        ("from_relaxation", (1.0, 2.0, 3.0), (-1e-3, -2e-3, 1e-3), "modulus is -0.001 at"),
        ("from_relaxation", (-1.0, 2.0), (3.0, 1.0), r"time is -1\.0"),
        ("from_creep", (0.0,), (0.2,), "no value after the time 0"),
        ("from_relaxation", (1.0, 2.0), (3.0, 3.0), "elastic solid of modulus 3: use that"),
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
    with pytest.raises(ValueError, match="must rise, as a solid relaxes faster"):
        fit(SOLID, SWEEP, values, -HEAT)
    short = (SWEEP < 1) & (HEAT != 20)
    with pytest.raises(ValueError, match=r"of the 4 temperatures have no relaxation modulus in"):
        fit(SOLID, SWEEP[short], values[short], HEAT[short])
    for given in ({"reference_temperature": 20.0}, {"shift": WilliamsLandelFerry(C1, C2, 20.0)}):
        with pytest.raises(ValueError, match="have no temperatures: give the temperature of each"):
            fit(SOLID, SWEEP[:13], values[:13], **given)
    with pytest.raises(TypeError, match="float is no shift: give one of jaxstab"):
        fit(SOLID, SWEEP, values, HEAT, shift=8.0)
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
            WilliamsLandelFerry(*bad)
    for law, bad, named in (
        (Arrhenius, (-1.0, 300.0), "activation energy is -1"),
        (Arrhenius, (1e5, 0.0), "reference temperature is 0.0: it must be positive"),
        (ShiftTable, ((0.0, 1.0), (1.0,), 0.0), r"\(2,\), the shift factors \(1,\)"),
        (ShiftTable, ((1.0, 0.0), (1.0, 2.0), 0.0), "temperatures of a table must increase"),
        (ShiftTable, ((0.0, 1.0), (1.0, -2.0), 0.0), r"shift factor is -2\.0 at \(1,\)"),
        (ShiftTable, ((0.0, 1.0), (1.0, 0.5), 2.0), r"temperature is 2\.0: the table is from 0"),
    ):
        with pytest.raises(ValueError, match=named):
            law(*bad)


def warned(fit, *args, **kwargs):
    """Return a fitted solid, and what it warned of."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = fit(SOLID, *args, **kwargs)
    assert all(each.category is RelaxationWarning for each in caught)
    return found, " | ".join(str(each.message) for each in caught)


# Of a plateau, a spectrum that goes on beyond the data, a time beyond them, and few data.
SLOW = [
    ("plateau", TIMES, lambda t: 1 + 6 * np.exp(-t / 0.47), False),
    ("spectrum", np.logspace(-2, 2, 41), lambda t: 1 + 6 * (1 + t) ** -0.3, True),
    ("time", np.logspace(-2, 2, 41), lambda t: 1 + 6 * np.exp(-t / 100), True),
    ("few", np.logspace(-2, 2, 6), lambda t: 1 + 6 * np.exp(-t / 300), True),
]


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize(("name", "times", "law", "is_open"), SLOW, ids=[x[0] for x in SLOW])
def test_the_relaxed_modulus_is_known_as_well_as_its_error_says(name, times, law, is_open, noise):
    random = 1 + noise * np.random.default_rng(2).normal(size=times.size)
    found, told = warned(js.Viscoelastic.from_relaxation, times, law(times) * random)
    # The truth is one.
    assert abs(modulus(found) - 1) <= found.relaxed_error * modulus(found)
    assert ("no plateau" in told) == is_open
    assert (found.relaxed_error > 0.5) == is_open


@pytest.mark.parametrize("slowness", [0.001, 0.01, 0.03])
def test_oscillations_that_end_before_the_plateau_say_so(slowness):
    # A fractional Zener solid, with tan delta from 0.1 to 0.36 at 0.01 Hz.
    frequencies = 2 * np.pi * np.logspace(-2, 3, 26)
    powers = (1j * frequencies * slowness) ** 0.5
    moduli = 0.5 + 10 * powers / (1 + powers)
    fit = js.Viscoelastic.from_storage_and_loss
    found, told = warned(fit, frequencies, moduli.real, moduli.imag)
    tangent = moduli[0].imag / moduli[0].real
    assert f"tan delta {tangent:.2g} at its end): no plateau" in told
    assert f"{float(found.relaxed_error):.0%} (`relaxed_error`)" in told
    assert 0.02 < modulus(found) - 0.5 <= found.relaxed_error * modulus(found)
    assert found.fit_error < 0.01


LATE = np.logspace(-2, 2, 41)


@pytest.mark.parametrize(
    ("compliances", "viscosity"),
    [
        (1 + LATE, 1.0),
        (1 + LATE / 50 + 0.5 * -np.expm1(-LATE), 50.0),
        (1 + np.sqrt(LATE), None),
    ],
    ids=["maxwell", "burgers", "andrade"],
)
def test_a_compliance_that_still_rises_is_a_liquid(compliances, viscosity):
    found, told = warned(js.Viscoelastic.from_creep, LATE, compliances)
    assert "creep compliance has no plateau: the data are of a liquid" in told
    assert found.fit_error < 5e-3 and found.relaxed_error >= 1
    assert modulus(found) < 0.05 / compliances[-1]
    if viscosity is not None:
        # Its flow is the integral of the relaxation modulus.
        flow = modulus(found) * np.sum(found.ratios * found.times)
        assert flow == pytest.approx(viscosity, rel=0.03)
    # Noise on the plateau of a solid is no flow.
    random = np.random.default_rng(0).normal(size=(5, LATE.size))
    for noise in random:
        solid = (0.5 - 0.4 * np.exp(-LATE)) * (1 + 0.02 * noise)
        found, told = warned(js.Viscoelastic.from_creep, LATE, solid)
        assert not told and abs(modulus(found) - 2) <= found.relaxed_error * modulus(found)


def test_a_liquid_is_fitted_with_its_slowest_times():
    stress = 3 * np.exp(-LATE / 5)
    found, told = warned(js.Viscoelastic.from_relaxation, LATE, stress)
    assert "no plateau: the data are of a liquid" in told and "up to the time 100" in told
    assert found.relaxed_error >= 1 and modulus(found) < stress[-1]
    assert modulus(found) * np.sum(found.ratios * found.times) == pytest.approx(15, rel=0.01)
    turns = 0.1 * LATE
    moduli = 3 * turns / (1j + turns) * turns / (turns - 1j) * (turns + 1j) / turns
    fit = js.Viscoelastic.from_storage_and_loss
    found, told = warned(fit, LATE, moduli.real, moduli.imag)
    assert "the data are of a liquid" in told and found.fit_error < 0.02
    assert modulus(found) * np.sum(found.ratios * found.times) == pytest.approx(0.3, rel=0.02)


def test_data_as_they_are_measured_are_averaged_and_without_noise_about_zero():
    fit = js.Viscoelastic.from_relaxation
    stress = 1 + 6 * np.exp(-TIMES / 0.1)
    clean = fit(SOLID, TIMES, stress)
    # Each fifth value twice, 1 % above and below, and the time before the step.
    times = np.concatenate([[0.0], TIMES, TIMES[::5]])
    values = np.concatenate([[99.0], stress, 0.99 * stress[::5]])
    values[1 : 1 + TIMES.size : 5] *= 1.01
    found, told = warned(fit, times, values)
    assert "1 values at the time 0 are left out" in told
    assert "11 repeated times are averaged: one relaxation modulus is up to 0.01" in told
    np.testing.assert_allclose(found.ratios, clean.ratios, rtol=1e-6)
    # At other temperatures they are no repetitions.
    oscillation, arguments, (storage, loss) = sweeps("oscillation")
    twice = [np.append(x, x[:3]) for x in (arguments, storage, loss, HEAT)]
    repeated, told = warned(oscillation, *twice)
    assert "3 repeated frequencies are averaged: one storage modulus is up to 0 of" in told
    known = oscillation(SOLID, arguments, storage, loss, HEAT)
    np.testing.assert_allclose(repeated.shift.c1, known.shift.c1)
    # A force that ends in its noise, and a loss that does.
    noise = np.random.default_rng(1).normal(size=TIMES.size)
    found, told = warned(fit, TIMES, 6 * np.exp(-TIMES / 0.1) + 0.01 * noise)
    assert "times are left out, at which the relaxation modulus is negative or no larger" in told
    assert modulus(found) < 0.03
    turns = 1j * TIMES * 0.1
    moduli = 1 + turns / (1 + turns)
    found, told = warned(oscillation, TIMES, moduli.real, moduli.imag + 2e-3 * noise)
    assert "frequencies are left out, at which the storage modulus or loss modulus is neg" in told
    assert modulus(found) == pytest.approx(1, rel=5e-3)


@pytest.mark.parametrize("kind", ["oscillation", "relaxation", "creep"])
@pytest.mark.parametrize("given", ["Arrhenius", "ShiftTable"])
def test_known_shifts_join_two_temperatures(kind, given):
    energy, hot = 1.2e5, np.array([280.0, 300.0])
    law = Arrhenius(energy, 290.0)
    # ln a_T = E_a / R (1 / T - 1 / T0).
    factors = np.exp(energy / 8.314462618 * (1 / hot - 1 / 290))
    np.testing.assert_allclose(law.factor(hot), factors, rtol=1e-9)
    if given == "ShiftTable":
        law = ShiftTable(hot, 7 * factors, 280.0)
        np.testing.assert_allclose(law.factor(hot), factors / factors[0], rtol=1e-12)
        middle = np.sqrt(factors[1] / factors[0])
        np.testing.assert_allclose(law.factor(290.0), middle, rtol=1e-12)
        factors = factors / factors[0]
    arguments = np.tile(np.logspace(-2, 2, 25), 2)
    temperatures = np.repeat(hot, 25)
    a = np.repeat(factors, 25)
    if kind == "oscillation":
        turns = 1j * arguments * a * 0.5
        moduli = RELAXED + 6 * turns / (1 + turns)
        values = moduli.real, moduli.imag
    else:
        values = ({"relaxation": relaxation, "creep": creep}[kind]((6.0,), (0.5,), arguments / a),)
    names = {"oscillation": "storage_and_loss"}
    fit = getattr(js.Viscoelastic, f"from_{names.get(kind, kind)}")
    found = fit(SOLID, arguments, *values, temperatures, shift=law)
    assert_series(found, (6.0,), (0.5,))
    assert found.shift.reference_temperature == law.reference_temperature
    moved = fit(SOLID, arguments, *values, temperatures, shift=law, reference_temperature=300.0)
    ratio = factors[1]
    assert_series(moved, (6.0,), (0.5 * ratio,))
    np.testing.assert_allclose(moved.at_temperature(280.0).shift.factor(300.0), ratio / factors[0])


def test_laws_of_shifts_are_batched_and_differentiated():
    law, table = Arrhenius(1e5, 300.0), ShiftTable([280.0, 300.0], [8.0, 1.0], 300.0)
    for each, inside in ((law, 290.0), (table, 290.0)):
        batch = jax.jit(jax.vmap(lambda t, law=each: law.factor(t)))(jnp.array([inside, -1.0]))
        np.testing.assert_allclose(batch[0], each.factor(inside), rtol=1e-12)
        assert np.isnan(batch[1])
    slope = jax.grad(lambda t: jnp.log(law.factor(t)))(290.0)
    np.testing.assert_allclose(slope, -1e5 / 8.314462618 / 290**2)
    slope = jax.grad(lambda t: jnp.log(table.factor(t)))(290.0)
    np.testing.assert_allclose(slope, -np.log(8) / 20)
    with pytest.raises(ValueError, match=r"temperature is -1\.0: give it in kelvin"):
        law.factor(-1.0)


def test_constants_of_a_shift_have_errors_that_hold():
    temperatures = np.repeat([10.0, 20.0, 30.0], 13)
    arguments = np.tile(np.logspace(-1, 2, 13), 3)
    powers = (0.1j * arguments * shift(temperatures)) ** 0.5
    moduli = 1 + 100 * powers / (1 + powers)
    fit = js.Viscoelastic.from_storage_and_loss
    missed = []
    for seed in range(3):
        first, second = 1 + 0.01 * np.random.default_rng(seed).normal(size=(2, 39))
        values = moduli.real * first, moduli.imag * second
        found = fit(SOLID, arguments, *values, temperatures, reference_temperature=REFERENCE)
        errors = np.array(found.shift.errors)
        missed.append((np.array([found.shift.c1 - C1, found.shift.c2 - C2])) / errors)
        assert 0.02 < errors[0] / C1 < 0.3
        # At another reference they are those of the same law.
        there = found.shift.referred_to(0.0)
        at = np.asarray(found.shift.covariance)
        back = there.referred_to(REFERENCE)
        np.testing.assert_allclose(back.covariance, at, rtol=1e-9)
        part = float(found.shift.c2 / there.c2)
        np.testing.assert_allclose(there.errors[1] / there.c2, part * np.sqrt(at[1, 1]))
    assert np.max(np.abs(missed)) < 3
    assert WilliamsLandelFerry(C1, C2, 0.0).errors is None


def test_temperatures_that_lie_near_do_not_determine_the_constants():
    temperatures = np.repeat([18.0, 20.0, 22.0], 13)
    arguments = np.tile(np.logspace(-1, 2, 13), 3)
    powers = (0.1j * arguments * shift(temperatures)) ** 0.5
    moduli = 1 + 100 * powers / (1 + powers)
    first, second = 1 + 0.02 * np.random.default_rng(3).normal(size=(2, 39))
    fit = js.Viscoelastic.from_storage_and_loss
    values = moduli.real * first, moduli.imag * second
    found, told = warned(fit, arguments, *values, temperatures)
    assert "temperatures from 18 to 22 do not determine the constants" in told
    assert found.shift.c1 > 2 * C1
    assert found.shift.errors[0] > found.shift.c1
    # The factor between them is known.
    factor = float(found.shift.factor(22.0) / found.shift.factor(18.0))
    assert np.log10(factor) == pytest.approx(np.log10(shift(22.0) / shift(18.0)), abs=0.05)


def test_curves_that_no_law_joins_are_named():
    # The slowest step is by Arrhenius, as below a glass transition.
    temperatures = np.array([-40.0, -20.0, 0.0, 20.0, 40.0, 60.0])
    logs = np.log10(shift(temperatures))
    logs[0] = logs[1] + 0.8
    reduced = np.repeat(10**logs, 7)
    arguments = np.tile(np.logspace(-1, 2, 7), 6)
    powers = (1e-5j * arguments * reduced) ** 0.5
    moduli = 1 + 100 * powers / (1 + powers)
    fit = js.Viscoelastic.from_storage_and_loss
    values = arguments, moduli.real, moduli.imag, np.repeat(temperatures, 7)
    found, told = warned(fit, *values)
    assert "From the temperature -40 to -20 the curves are -0.80 decades apart" in told
    table = ShiftTable(temperatures, 10**logs, REFERENCE)
    known, told = warned(fit, *values, shift=table)
    assert "decades apart" not in told and known.fit_error < 0.01 < found.fit_error


# Rounded moduli of a polymer at 0.1 to 100 Hz and at eight temperatures, from freq_user_raw.csv of
# NREL/pyvisco (BSD 3), and the shift factors in its time_user_raw__shift_factors.csv.
POLYMER = np.repeat([47.5, 55.0, 62.5, 70.0, 77.5, 85.0, 92.5, 100.0], 4)
STORAGE = np.array(
    [
        [2387, 2984, 3584, 4196],
        [1481, 2110, 2761, 3443],
        [910, 1424, 2044, 2738],
        [571, 923, 1447, 2112],
        [395, 604, 984, 1562],
        [313, 427, 671, 1120],
        [275, 338, 483, 795],
        [257, 296, 381, 586],
    ],
    float,
).ravel()
LOSS = np.array(
    [
        [498, 500, 479, 511],
        [416, 479, 498, 538],
        [301, 410, 478, 540],
        [187, 309, 425, 523],
        [107, 206, 340, 473],
        [60.5, 126, 245, 398],
        [36.5, 75.5, 162, 308],
        [25.2, 47, 104, 223],
    ]
).ravel()
FREQUENCIES = np.tile([0.1, 1.0, 10.0, 100.0], 8)
PUBLISHED = np.array([-10.140, -11.444, -12.518, -13.449, -14.284, -15.029, -15.680, -16.228])


@pytest.mark.parametrize("kind", ["oscillation", "relaxation"])
def test_shifts_of_measured_sweeps_are_those_that_a_fitting_tool_ships(kind):
    if kind == "oscillation":
        values = 2 * np.pi * FREQUENCIES, STORAGE, LOSS
        fit = js.Viscoelastic.from_storage_and_loss
    else:
        # As the tool takes them.
        values = 1 / FREQUENCIES, STORAGE
        fit = js.Viscoelastic.from_relaxation
    found, _ = warned(fit, *values, POLYMER)
    factors = np.log10(np.asarray(found.shift.factor(POLYMER[::4])))
    away = (factors - factors[0]) - (PUBLISHED - PUBLISHED[0])
    assert np.abs(np.diff(away)).max() < 0.1
    assert np.abs(away).max() < 0.2
