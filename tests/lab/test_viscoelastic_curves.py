"""Fits in time to curves of a viscoelastic sample, whose truth is a closed form or a finer disc."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import pyplot as plt
from viscoelastic_curves import RADIUS, RATIO, RELAXED, TIME, program, recorded, sticky, ting

import jaxstab as js

TIP = js.lab.Paraboloid(RADIUS)
TRUTH = {
    "relaxed_modulus": RELAXED,
    "instantaneous_modulus": RELAXED * (1 + RATIO),
    "ratio": RATIO,
    "time": TIME,
}


def require_within_errors(fit, truth, number):
    for name, value in truth.items():
        away = (getattr(fit, name) - value) / getattr(fit.errors, name)
        assert abs(away) < number, (name, away)


def test_a_standard_linear_solid_without_adhesion_is_that_of_ting(tmp_path):
    height, time = program()
    fit = js.lab.fit_viscoelastic(recorded(height, time, ting(height, time), 0), TIP)
    assert fit.result == js.RESULTS.successful
    truth = {**TRUTH, "contact_point": 4e-8 - fit.curve.correction.contact_point}
    require_within_errors(fit, truth, 2)
    assert fit.errors.relaxed_modulus < 0.01 * RELAXED
    assert fit.errors.time < 0.02 * TIME
    assert fit.work_of_adhesion == 0
    assert "relaxed_modulus" in repr(fit) and "kPa" in repr(fit)
    text = fit.to_csv(tmp_path / "fit.csv").read_text(encoding="utf-8").splitlines()
    assert sum(line.startswith("#") for line in text) == 11
    assert len(text) == 12 + len(fit.times)
    axes = fit.plot()
    np.testing.assert_allclose(axes.lines[1].get_ydata(), 1e9 * fit.forces)
    plt.close(axes.figure)


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
