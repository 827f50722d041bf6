"""The adhesion map: its zones and its markers."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.contour import QuadContourSet
from matplotlib.path import Path

import jaxstab as js
from jaxstab import plots, references


def test_a_map_has_a_marker_for_each_sphere_and_a_zone_for_each_closed_form():
    spheres = references.regime(1e-6, 1e9, 0.05, [1e-9, 4e-9])
    axes = plots.adhesion_map(spheres)
    (marks,) = [line for line in axes.lines if line.get_marker() == "o"]
    np.testing.assert_allclose(marks.get_xdata(), spheres.maugis)
    np.testing.assert_allclose(marks.get_ydata(), -spheres.pull_off)
    labels = axes.get_legend_handles_labels()[1]
    assert labels == ["JKR within 5 %", "DMT within 5 %", "Hertz within 5 %", "pull-off"]
    zones = [c.get_paths()[0] for c in axes.collections if isinstance(c, QuadContourSet)]
    # A soft sphere, a hard one, one between, and one whose load is large.
    points = [(30, 1), (0.03, 1), (0.4, 1), (0.1, 500)]
    inside = [[isinstance(z, Path) and z.contains_point(p) for z in zones] for p in points]
    assert inside[:3] == [[True, False, False], [False, True, False], [False, False, False]]
    assert inside[3][2]


def test_a_sphere_far_out_is_on_the_map():
    axes = plots.adhesion_map(references.regime(1.0, 1e6, 0.05, 1e-9), axes=plt.subplots()[1])
    assert axes.get_xlim()[1] > 1e4


def test_what_is_no_regime_is_refused():
    with pytest.raises(TypeError, match="float is not a regime: give a result of"):
        js.plots.adhesion_map(1.5)
