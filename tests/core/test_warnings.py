"""Warnings point at the caller's line."""

import inspect
import warnings

import matplotlib.pyplot as plt
import numpy as np
import pytest
from problems import rough_contact

import jaxstab as js

LOAD = js.MeanGap(0.2)


def coarse(length):
    return rough_contact(16, js.potentials.Exponential(1e-2, length), youngs_modulus=1e-3)


def here():
    """The line that this is called from."""
    return inspect.currentframe().f_back.f_lineno


def test_a_warning_points_at_the_line_of_the_caller():
    contact = coarse(0.101)
    with pytest.warns(js.exceptions.ResolutionWarning) as said:
        line = [js.equilibrate(contact, LOAD, throw=False), here()][1]
    assert [(warning.filename, warning.lineno) for warning in said] == [(__file__, line)]


def test_surfaces_point_at_the_caller_too():
    x = np.linspace(0, 1, 64)
    heights = 0.01 * (np.random.default_rng(0).normal(size=(64, 64)) + 20 * x)
    with pytest.warns(js.exceptions.SurfaceWarning, match="tilted") as said:
        js.surfaces.Topography(js.Grid(64), heights)
        js.Contact(js.HalfSpace(js.Grid(64), 1.0), heights, js.potentials.NoAdhesion())
    assert {warning.filename for warning in said} == {__file__}


def test_a_loop_warns_once_of_the_same():
    contact = rough_contact(16, js.potentials.Exponential(0.02, 0.08))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        for _ in range(2):
            js.Spring(0.0, 1e-9).warn_if_soft(contact.solid)
    assert [(x.category, x.filename) for x in said] == [(js.exceptions.MachineWarning, __file__)]


def test_a_figure_that_is_too_small_is_told_of_at_the_line_that_saves_it(tmp_path):
    figure, _ = plt.subplots(figsize=(20, 5))
    with pytest.warns(UserWarning, match="hard to read") as said:
        line = [js.plots.save(figure, tmp_path / "wide.png", width="single"), here()][1]
    assert [(warning.filename, warning.lineno) for warning in said] == [(__file__, line)]
    plt.close(figure)
