"""Fits in time to curves of a viscoelastic sample, whose truth is a closed form or a finer disc."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from matplotlib import pyplot as plt
from viscoelastic_curves import RADIUS, RATIO, RELAXED, TIME, program, recorded, sticky, ting

import jaxstab as js

TIP = js.lab.Paraboloid(RADIUS)
TRUTH = {
    "relaxed_modulus": RELAXED,
    "instantaneous_modulus": RELAXED * (1 + RATIO),
    "ratios": (RATIO,),
    "relaxation_times": (TIME,),
}
# Two modes that an approach, a dwell and a retraction of a second each tell apart.
TWO = {
    "relaxed_modulus": RELAXED,
    "instantaneous_modulus": RELAXED * 3.5,
    "ratios": (1.0, 1.5),
    "relaxation_times": (0.06, 0.8),
}


def require_within_errors(fit, truth, number):
    for name, value in truth.items():
        away = (getattr(fit, name) - np.asarray(value)) / getattr(fit.errors, name)
        assert np.all(np.abs(away) < number), (name, away)


def test_a_standard_linear_solid_without_adhesion_is_that_of_ting(tmp_path):
    height, time = program()
    fit = js.lab.fit_viscoelastic(recorded(height, time, ting(height, time), 0), TIP)
    assert fit.result == js.RESULTS.successful
    truth = {**TRUTH, "contact_point": 4e-8 - fit.curve.correction.contact_point}
    require_within_errors(fit, truth, 2)
    assert fit.errors.relaxed_modulus < 0.01 * RELAXED
    assert fit.errors.relaxation_times < 0.02 * TIME
    assert fit.work_of_adhesion == 0
    assert "relaxed_modulus" in repr(fit) and "kPa" in repr(fit)
    text = fit.to_csv(tmp_path / "fit.csv").read_text(encoding="utf-8").splitlines()
    assert sum(line.startswith("#") for line in text) == 11
    assert len(text) == 12 + len(fit.times)
    axes = fit.plot()
    np.testing.assert_allclose(axes.lines[1].get_ydata(), 1e9 * fit.forces)
    plt.close(axes.figure)
    again = js.load(js.save(tmp_path / "fit.nc", fit))
    assert type(again) is js.lab.ViscoelasticFit
    assert again.to_dataset().identical(fit.to_dataset())
    assert repr(again) == repr(fit)
    assert (again.tip, again.result) == (fit.tip, fit.result)
    with pytest.raises(ValueError, match="none of a fit in time"):
        js.lab.ViscoelasticFit.from_dataset(fit.curve.to_dataset())


@pytest.mark.nightly
def test_two_relaxation_times_are_told_apart_and_kept_in_a_file(tmp_path):
    height, time = program()
    curve = recorded(height, time, ting(height, time, TWO["ratios"], TWO["relaxation_times"]), 0)
    fit = js.lab.fit_viscoelastic(curve, TIP, relaxation_times=2)
    assert fit.result == js.RESULTS.successful
    require_within_errors(fit, TWO, 2)
    assert np.all(fit.errors.relaxation_times < 0.1 * fit.relaxation_times)
    assert "relaxation_time 2" in repr(fit)
    again = js.load(js.save(tmp_path / "fit.nc", fit))
    np.testing.assert_array_equal(again.errors.ratios, fit.errors.ratios)
    text = fit.to_csv(tmp_path / "fit.csv").read_text(encoding="utf-8")
    assert "# relaxation_time 2: 0." in text


@pytest.mark.nightly
def test_an_approach_without_noise_is_fitted_as_well_as_the_rings_allow():
    time = np.linspace(0, 1, 1000)
    tip = 1e-6 - 2e-6 * time
    # The sum over steps is right to second order with the moduli half a step later.
    moduli = 1e3 * (1 + 1.5 * np.exp(-(time + 0.5 * time[1]) / 0.1))
    growth = np.diff(np.maximum(-tip, 0) ** 1.5, prepend=0)
    force = 4 / 3 * np.sqrt(RADIUS) / 0.75 * np.convolve(moduli, growth)[: len(time)]
    approach = js.lab.force_curves.Segment(force, tip - force / 0.05, tip, time)
    curve = js.lab.force_curves.ForceCurve(approach, None, spring_constant=0.05)
    fit = js.lab.fit_viscoelastic(curve, TIP, relaxation_times=[0.1])
    assert fit.result == js.RESULTS.successful
    np.testing.assert_allclose(fit.relaxed_modulus, 1e3, rtol=2e-3)
    np.testing.assert_allclose(fit.instantaneous_modulus, 2.5e3, rtol=2e-3)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(1, 5))
def test_two_relaxation_times_are_within_their_errors(seed):
    height, time = program()
    curve = recorded(height, time, ting(height, time, TWO["ratios"], TWO["relaxation_times"]), seed)
    fit = js.lab.fit_viscoelastic(curve, TIP, relaxation_times=2)
    assert fit.result == js.RESULTS.successful
    require_within_errors(fit, TWO, 3)


@pytest.mark.nightly
def test_times_that_are_given_have_ratios_alone():
    height, time = program()
    curve = recorded(height, time, ting(height, time, TWO["ratios"], TWO["relaxation_times"]), 0)
    fit = js.lab.fit_viscoelastic(curve, TIP, relaxation_times=TWO["relaxation_times"])
    assert fit.result == js.RESULTS.successful
    np.testing.assert_array_equal(fit.relaxation_times, TWO["relaxation_times"])
    np.testing.assert_array_equal(fit.errors.relaxation_times, 0)
    require_within_errors(fit, {k: TWO[k] for k in TWO if k != "relaxation_times"}, 2)


@pytest.mark.nightly
def test_a_time_that_the_curve_does_not_tell_has_a_result_of_its_own():
    height, time = program()
    curve = recorded(height, time, ting(height, time), 0)
    with pytest.warns(js.exceptions.FitWarning, match="does not tell all of the 2 relaxation"):
        fit = js.lab.fit_viscoelastic(curve, TIP, relaxation_times=2)
    assert fit.result == js.RESULTS.undetermined
    assert "Fit fewer parameters" in fit.status
    # The mode that is there is found all the same.
    number = np.argmin(fit.errors.relaxation_times / fit.relaxation_times)
    away = (fit.relaxation_times[number] - TIME) / fit.errors.relaxation_times[number]
    assert abs(away) < 2
    other = 1 - number
    assert fit.errors.relaxation_times[other] > fit.relaxation_times[other]


@pytest.mark.nightly
def test_a_sticky_standard_linear_solid():
    height, time = program()
    work, length = 5e-5, 1e-7
    coarse = time[::6]
    force = np.interp(time, coarse, sticky(height[::6], coarse, work, length))
    fit = js.lab.fit_viscoelastic(recorded(height, time, force, 1), TIP)
    assert fit.result != js.RESULTS.misfit
    require_within_errors(fit, {**TRUTH, "work_of_adhesion": work, "range": length}, 3)
    assert fit.errors.work_of_adhesion < 0.2 * work


def test_curves_without_times_and_other_tips_are_refused():
    height, time = program(200)
    curve = recorded(height, time, ting(height, time, steps=300), 0)
    pause = replace(curve.pauses[0], time=None)
    with pytest.raises(ValueError, match="pause 1 has no times"):
        js.lab.fit_viscoelastic(replace(curve, pauses=(pause,)), TIP)
    with pytest.raises(TypeError, match="give a rigid Sphere"):
        js.lab.fit_viscoelastic(curve, js.lab.FlatPunch(RADIUS))
    for times, error, match in (
        (0, ValueError, "is 0: it is between 1 and 5"),
        (2.5, TypeError, "is 2.5: give an integer"),
        ([0.3, 0.1], ValueError, "rising order"),
        ([0.0, 0.1], ValueError, "positive times in s"),
        ([], ValueError, "positive times in s"),
    ):
        with pytest.raises(error, match=match):
            js.lab.fit_viscoelastic(curve, TIP, relaxation_times=times)
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64"):
        js.lab.fit_viscoelastic(curve, TIP)
