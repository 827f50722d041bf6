"""Fits to curves as an instrument records them: unknown zeros, missing points, several minima."""

import warnings

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.optimize import brentq, curve_fit, least_squares
from scipy.signal import lfilter
from scipy.stats import t as student

import jaxstab as js
from jaxstab.calibration.least_squares import Evaluation, FitProblem, Measured, minimise

# Flat surfaces under a spring: a scalar equation, solved below without jaxstab.
ENERGY, RANGE, STIFFNESS = 0.02, 0.1, 5.0
OFFSET, BASELINE, SIDE = 0.03, 0.01, 2.0
POSITIONS = np.linspace(0.5, -0.02, 24)
TRUTH = np.array([ENERGY, RANGE, OFFSET, BASELINE])


def forces_of(positions, energy, length, offset, baseline):
    """Forces k (g - z) + F0 where they balance the attraction, or where the gap is closed."""

    def one(position):
        def out_of_balance(gap):
            return STIFFNESS * (gap - position) + energy / length * np.exp(-gap / length)

        if out_of_balance(0.0) > 0:
            return -STIFFNESS * position
        return STIFFNESS * (brentq(out_of_balance, 0, 5, xtol=1e-14) - position)

    return SIDE * np.array([one(position) for position in positions - offset]) + baseline


def flat(energy, length):
    grid = js.Grid((4,), (SIDE,))
    law = js.potentials.Exponential(energy, length)
    solid = js.HalfSpace(grid, 100.0)
    return js.Contact(solid, jnp.zeros(4), law, unit="µm", pressure_unit="MPa")


def fit_flat(forces, **options):
    options = {"where": lambda contact: contact.potential, "offset": True, "baseline": True} | (
        options
    )
    return js.calibrate(flat(0.03, 0.07), js.Spring(POSITIONS, STIFFNESS), forces=forces, **options)


def noisy(number, size=POSITIONS.size):
    noise = 2e-3 * np.random.default_rng(number).normal(size=size)
    return forces_of(POSITIONS, *TRUTH) + noise


def found(fit):
    law = fit.parameters
    return np.array([law.surface_energy, law.length, fit.offset, fit.baseline])


@pytest.mark.nightly
def test_offset_and_baseline_are_those_of_another_fit_of_the_closed_form():
    forces = noisy(0)
    fit = fit_flat(forces, tolerance=1e-8)
    values, covariance = curve_fit(forces_of, POSITIONS, forces, p0=TRUTH, xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(found(fit), values, rtol=1e-4)
    errors = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), errors, rtol=0.1)
    np.testing.assert_allclose([fit.offset_error, fit.baseline_error], errors[2:], rtol=0.1)
    np.testing.assert_allclose(fit.force, forces_of(POSITIONS, *values), atol=1e-6)
    assert fit.names == ("potential.surface_energy", "potential.length", "offset", "baseline")
    rows = [line.split() for line in str(fit).splitlines()[3:]]
    assert tuple(row[0] for row in rows) == fit.names
    shown = np.array([[float(number) for number in row[1:3]] for row in rows])
    np.testing.assert_allclose(shown, np.column_stack([found(fit), errors]), rtol=0.1, atol=1e-5)
    np.testing.assert_allclose(shown[:, 0], found(fit), rtol=1e-5)
    # The curve is a force on a line, per length: 1 MPa µm = 1 N/m.
    assert [row[3] for row in rows] == ["J/m²", "µm", "µm", "N/m"]


def test_the_error_of_all_loads_together_is_that_of_a_fit_to_moved_loads():
    forces = noisy(0)
    drift = np.linspace(0, 1e-3, POSITIONS.size)
    plain, raised = fit_flat(forces), fit_flat(forces, load_error=drift)
    np.testing.assert_array_equal(found(raised), found(plain))
    zeros = {"where": lambda contact: contact.potential, "offset": True, "baseline": True}
    load = js.Spring(POSITIONS + drift, STIFFNESS)
    moved = js.calibrate(raised.contact, load, forces=forces, tolerance=1e-8, **zeros)
    np.testing.assert_allclose(
        np.diag(raised.covariance - plain.covariance),
        (found(moved) - found(plain)) ** 2,
        rtol=0.1,
    )
    errors = [raised.standard_errors.length, raised.offset_error]
    np.testing.assert_allclose(errors, np.sqrt(np.diag(raised.covariance))[1:3])


def test_a_fit_is_drawn_with_its_measurements_or_their_residuals():
    fit = fit_flat(noisy(0))
    axes = js.plots.calibration(fit)
    np.testing.assert_allclose(axes.lines[1].get_ydata(), fit.force)
    np.testing.assert_allclose(axes.lines[0].get_ydata() - fit.force, fit.residuals, atol=1e-12)
    axes = js.plots.calibration(fit, "residuals", axes=plt.subplots()[1])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), fit.residuals)
    plt.close("all")


def test_a_tilt_is_that_of_another_fit_of_the_closed_form():
    def tilted(positions, energy, length, offset, baseline, tilt):
        return forces_of(positions, energy, length, offset, baseline) + tilt * positions

    forces = noisy(0) - 0.1 * POSITIONS
    fit = fit_flat(forces, baseline="linear", tolerance=1e-8)
    start = [*TRUTH, 0.0]
    values, covariance = curve_fit(tilted, POSITIONS, forces, p0=start, xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose([*found(fit), fit.tilt], values, rtol=1e-3)
    error = np.sqrt(covariance[-1, -1])
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance))[-1], error, rtol=0.1)
    assert fit.names[-1] == "tilt"
    # A force on a line over a length: 1 MPa.
    assert str(fit).splitlines()[-1].split()[-1] == "MPa"
    with pytest.raises(ValueError, match="baseline is 'quadratic'"):
        fit_flat(forces, baseline="quadratic")


def test_the_profile_is_that_of_fits_with_the_work_held():
    forces = noisy(1)
    fit = fit_flat(forces)
    assert fit.names[int(fit.profile.number)] == "potential.surface_energy"
    deviation = np.sum((forces - forces.mean()) ** 2)
    for at in (6, 9, 12):
        energy = float(fit.profile.values[at])

        def misfit(others, energy=energy):
            length, offset, baseline = others
            return forces_of(POSITIONS, energy, length, offset, baseline) - forces

        held = least_squares(misfit, [RANGE, OFFSET, BASELINE], xtol=1e-12)
        np.testing.assert_allclose(fit.profile.losses[at], held.cost / deviation, rtol=2e-3)


@pytest.mark.nightly
def test_errors_are_the_scatter_of_repeated_measurements():
    fits = [fit_flat(noisy(number)) for number in range(40)]
    values = np.array([found(fit) for fit in fits])
    errors = np.array([np.sqrt(np.diag(fit.covariance)) for fit in fits])
    # From 40 draws a standard deviation is known to 11 %.
    scatter = values.std(axis=0, ddof=1) / np.median(errors, axis=0)
    assert (scatter > 0.7).all() and (scatter < 1.3).all()
    covered = abs(values - TRUTH) < student.ppf(0.975, POSITIONS.size - 4) * errors
    assert covered.mean() > 0.9


def test_a_zero_that_is_off_is_warned_of_and_no_longer_biases_the_work_of_adhesion():
    forces = forces_of(POSITIONS, ENERGY, RANGE, 0.01, 0.0)
    forces += 2e-3 * np.random.default_rng(2).normal(size=forces.size)
    message = r"offset of about 0\.0.* baseline of .*offset=True"
    with pytest.warns(js.exceptions.FitWarning, match=message) as said:
        biased = fit_flat(forces, offset=False, baseline=False)
    assert {warning.filename for warning in said} == {__file__}
    assert biased.offset == biased.baseline == biased.offset_error == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error", js.exceptions.FitWarning)
        fit = fit_flat(forces)
    errors = np.sqrt(np.diag(fit.covariance))
    assert (abs(found(fit) - [ENERGY, RANGE, 0.01, 0.0]) < 3 * errors).all()
    assert abs(found(biased)[0] - ENERGY) > 5 * errors[0]


def test_masked_forces_are_not_fitted():
    forces = np.ma.masked_array(noisy(3), mask=np.arange(24) == 7)
    forces.data[7] = np.nan
    fit = fit_flat(forces, tolerance=1e-8)
    kept = np.delete(np.arange(24), 7)
    values, _ = curve_fit(
        forces_of, POSITIONS[kept], forces.data[kept], p0=TRUTH, xtol=1e-12, ftol=1e-12
    )
    np.testing.assert_allclose(found(fit), values, rtol=1e-4)
    as_pressures = fit_flat(None, mean_pressure=forces / SIDE, tolerance=1e-8)
    np.testing.assert_allclose(found(as_pressures)[:3], values[:3], rtol=1e-4)
    np.testing.assert_allclose(as_pressures.baseline * SIDE, values[3], rtol=1e-3)


def test_forces_of_the_wrong_sign_are_refused():
    with pytest.raises(
        js.exceptions.SolverError, match=r"opposite sign.*negative where the surfaces attract"
    ):
        fit_flat(-noisy(0), offset=False, baseline=False)
    cure = r"change the sign of the loads or of the forces"
    with pytest.raises(js.exceptions.SolverError, match=cure) as told:
        fit_flat(-noisy(0))
    assert told.value.found.result != js.RESULTS.successful
    # No other start, nor a profile, is tried from a guess of another sign.
    assert told.value.found.losses.size == told.value.found.profile.values.size == 1


@pytest.mark.parametrize("drift", [0.1, -0.2])
def test_a_drift_is_named_and_without_it_there_is_no_warning(drift):
    forces = noisy(0) + drift * np.linspace(0, 1, POSITIONS.size)
    with pytest.warns(
        js.exceptions.FitWarning, match=r"drifted steadily.*subtract the line"
    ) as told:
        fit = fit_flat(forces)
    # The part is that which a fit of the closed form with a slope removes.
    line = np.linspace(-1, 1, POSITIONS.size)

    def misfit(values):
        return forces_of(POSITIONS, *values[:4]) + values[4] * line - forces

    start = [*found(fit)]
    least = [2 * least_squares(misfit, [*TRUTH, drift / 2], xtol=1e-12).cost]
    least.append(np.sum((forces_of(POSITIONS, *start) - forces) ** 2))
    said = float(str(told[0].message).split("fall by ")[1].split("%")[0]) / 100
    np.testing.assert_allclose(said, 1 - least[0] / least[1], atol=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error", js.exceptions.FitWarning)
        fit_flat(forces - drift * np.linspace(0, 1, POSITIONS.size))


def test_an_outlier_is_named():
    forces = noisy(0)
    forces[5] += 50.0
    with pytest.raises(
        js.exceptions.SolverError, match=r"measurement number 5, at a load of 0\.386957.*outlier"
    ):
        fit_flat(forces)
    # A small one leaves a fit, with a warning.
    forces = noisy(0)
    forces[5] += 0.03
    with pytest.warns(js.exceptions.FitWarning, match=r"measurement number 5.*masked_array"):
        fit_flat(forces)


@pytest.mark.parametrize("number", [0, 8, 16, 23])
def test_an_outlier_is_named_wherever_it_lies(number):
    """Also at the ends, where it draws the curve to itself, and no other cause is named."""
    forces = noisy(0)
    forces[number] += 60 * 2e-3
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        fit = fit_flat(forces, throw=False)
    said = [str(warning.message) for warning in told]
    if fit.result == "successful":
        (message,) = said
    else:
        with pytest.raises(js.exceptions.SolverError) as failed:
            fit_flat(forces)
        message = str(failed.value)
    assert f"measurement number {number}," in message and "outlier" in message
    assert not any(word in message for word in ("sign", "offset=True", "Jumps of the contact"))


def test_loads_in_other_units_are_told_from_a_wrong_sign():
    forces = noisy(0)
    with pytest.raises(js.exceptions.SolverError, match="other units") as told:
        js.calibrate(flat(0.03, 0.07), js.MeanGap(1000 * np.linspace(0.05, 0.4, 24)), forces=forces)
    assert "opposite sign" not in str(told.value) and "change the sign" not in str(told.value)


def test_parameters_that_the_curve_does_not_tell_apart_are_refused():
    # Under a held gap, a shift of flat surfaces is the same as another work of adhesion.
    gaps = np.linspace(0.05, 0.4, 12)
    forces = -SIDE * ENERGY / RANGE * np.exp(-gaps / RANGE)
    with pytest.raises(js.exceptions.SolverError, match="not determined"):
        js.calibrate(
            flat(0.03, 0.07),
            js.MeanGap(gaps),
            forces=forces + 1e-4 * np.random.default_rng(0).normal(size=12),
            where=lambda contact: contact.potential,
            offset=True,
        )


def test_a_load_without_a_derivative_counts_but_does_not_direct():
    x, y = np.arange(1.0, 5.0), np.array([1.1, 1.9, 3.2, 9.0])

    def line(values):
        return values[0] * x, np.stack([np.where(x == 4, np.nan, x), 0 * x], axis=1)

    measured = Measured(js.MeanGap(x), y, np.ones(4), has_baseline=False)
    held = np.array([False, True])
    problem = FitProblem(line, np.array([2.0, 0.0]), measured, held, 1e-8)
    end = minimise(problem, np.zeros(2), 50)
    expected = np.sum((problem.values(end.point.free)[0] * x - y) ** 2) / np.sum(y**2) / 2
    np.testing.assert_allclose(end.point.loss, expected, rtol=1e-12)


def test_errors_allow_for_a_misfit_that_is_alike_at_neighbours():
    x = np.linspace(-1, 1, 58)
    rows = np.stack([x, np.zeros(58)], axis=1)
    random = np.random.default_rng(0)
    slopes = {0.0: [], 0.8: []}
    errors = {0.0: [], 0.8: []}
    for correlation in slopes:
        for _ in range(100):
            noise = lfilter([1], [1, -correlation], random.normal(size=158))[100:]
            y = 10 * x + noise
            measured = Measured(js.MeanGap(jnp.asarray(x)), y, np.ones(58), has_baseline=False)
            slope = x @ y / (x @ x)
            held = np.array([False, True])
            problem = FitProblem(None, np.array([slope, 0.0]), measured, held, None)
            misfit = np.asarray(measured.roots) * (slope * x - y)
            jacobian = np.asarray(measured.roots)[:, None] * rows
            point = Evaluation(np.zeros(2), slope * x, misfit, jacobian)
            variance = problem.variance(point)
            slopes[correlation].append(slope)
            errors[correlation].append(float(np.sqrt(variance / np.sum(jacobian[:, 0] ** 2))))
    # White noise is taken as it is, with few exceptions.
    assert np.std(slopes[0.0]) == pytest.approx(np.median(errors[0.0]), rel=0.2)
    assert np.std(slopes[0.8]) < 2 * np.median(errors[0.8])
    plain = np.sqrt(1 / (1 - 0.8**2) / (x @ x))
    assert np.std(slopes[0.8]) > 2.2 * plain


def tip(n, side, energy, length):
    grid = js.Grid(n, (side, side))
    law = js.potentials.Exponential(energy, length)
    return js.Contact(js.FreeHalfSpace(grid, 0.1), js.surfaces.paraboloid(grid, 20.0), law)


def curve_of_tip(contact, indentation, seed):
    """Forces of a retraction, with a noise of 1 % of the pull-off."""
    loads = js.FarDisplacement(-indentation)
    states = js.sweep(contact, loads, order="continuation", stability=False)
    forces = np.asarray(states.equilibrium.force)
    return forces + 0.01 * abs(forces.min()) * np.random.default_rng(seed).normal(size=forces.size)


def work_and_range(contact):
    return contact.potential.surface_energy, contact.potential.length


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("n", "side", "points", "seed", "start"),
    [(16, 40.0, 12, 0, (0.06, 4.0)), (32, 60.0, 16, 7, (0.06, 1.2))],
)
def test_of_several_minima_the_least_one_is_found(n, side, points, seed, start):
    indentation = np.linspace(2.5, -1.0, points)
    forces = curve_of_tip(tip(n, side, 0.05, 1.5), indentation, seed)
    fit = js.calibrate(
        tip(n, side, *start),
        js.FarDisplacement(-indentation),
        forces=forces,
        where=work_and_range,
    )
    assert fit.num_minima > 1
    errors = np.array(fit.standard_errors)
    assert (abs(np.array(fit.parameters) - [0.05, 1.5]) < 3 * errors).all()
    assert errors[1] < 0.1
    # It is the least of the profile too.
    assert (fit.loss <= fit.profile.losses).all()


@pytest.mark.nightly
def test_a_curve_of_jkr_gives_what_a_fit_of_their_closed_form_gives():
    radius, modulus, energy = 20.0, 0.1, 0.05

    def closed_form(x, energy, offset):
        # Beyond the turning point of the displacement, where the contact is stable.
        states = js.references.jkr.curve(np.linspace(4.5, 16.0, 400), radius, modulus, energy)
        return np.interp(x - offset, states.displacement, states.force)

    indentation = np.linspace(2.5, -1.5, 12)
    noise = 0.05 * np.random.default_rng(0).normal(size=12)
    forces = closed_form(indentation, energy, 0.0) + noise
    shifted = indentation - 0.3
    values, _ = curve_fit(closed_form, shifted, forces, p0=[0.06, 0.0])
    rings = js.Rings(100, 20.0)
    tip = js.surfaces.paraboloid(rings, radius)
    solid = js.solids.AxisymmetricHalfSpace(rings, modulus)
    fit = js.calibrate(
        js.Contact(solid, tip, js.potentials.Exponential(0.06, 0.6)),
        js.FarDisplacement(-shifted),
        forces=forces,
        where=lambda contact: contact.potential.surface_energy,
        offset=True,
    )
    # A law with a range of 0.6 nm is not quite JKR's.
    np.testing.assert_allclose(fit.parameters, values[0], rtol=0.05)
    np.testing.assert_allclose(fit.offset, -values[1], atol=0.1)


def test_a_missing_baseline_is_named_alone_beside_a_fitted_offset():
    forces = forces_of(POSITIONS, ENERGY, RANGE, 0.01, 0.05)
    with pytest.warns(
        js.exceptions.FitWarning, match=r"if the measurements had a baseline of about 0\.04"
    ) as said:
        fit_flat(forces, offset=True, baseline=False)
    assert "offset" not in str(said[0].message)
