"""The survival of contacts under growing tension: lines, medians and units."""

from dataclasses import replace

import numpy as np
import pytest
from problems import with_units

import jaxstab as js
from jaxstab import plots


@pytest.mark.nightly
def test_a_line_for_each_rate_falls_from_one_to_zero_through_its_median(detaching):
    contact, _ = detaching
    options = {"thermal_energy": 2e-4, "attempt_rate": 1e9}
    found = js.detachment(contact, js.MeanPressure(-0.06), rate=[1.0, 1e4], **options)
    found = with_units(found)
    axes = plots.detachment(found)
    assert axes.get_xlabel() == "tension [MPa]" and axes.get_ylim() == (0, 1)
    lines = [line for line in axes.lines if len(line.get_xdata()) > 2]
    dots = [line for line in axes.lines if line.get_marker() == "o"]
    assert [line.get_label() for line in lines] == ["rate 1", "rate 1e+04"]
    for line, dot, median in zip(lines, dots, found.median, strict=True):
        (x,) = dot.get_xdata()
        np.testing.assert_allclose(x, -median)
        np.testing.assert_allclose(np.interp(x, *line.get_data()), 0.5, atol=0.02)
        assert line.get_ydata()[0] > 0.99 and line.get_ydata()[-1] == 0
    with pytest.raises(ValueError, match="load is held"):
        plots.detachment(replace(found, rate=None))
    with pytest.raises(TypeError, match="float is not a detachment"):
        plots.detachment(0.5)
