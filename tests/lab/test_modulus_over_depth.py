"""Apparent moduli over the depth, of a homogeneous sample and of a layer bonded to a rigid base."""

import csv

import numpy as np
import pytest
from matplotlib import pyplot as plt
from scipy.optimize import minimize_scalar
from synthetic_curves import MODULUS, RADIUS, WORK, hertz, maugis_with_approach, recorded

import jaxstab as js

TIP = js.lab.Paraboloid(RADIUS * 1e-9)


def apparent(indentation, force):
    """Return the modulus of Hertz' law with a free contact point, by least squares."""

    def fitted(contact):
        shape = 4 / 3 * np.sqrt(RADIUS) * np.maximum(indentation - contact, 0) ** 1.5
        modulus = shape @ force / (shape @ shape)
        return modulus, np.sum((force - modulus * shape) ** 2)

    found = minimize_scalar(lambda x: fitted(x)[1], bounds=(-2, 2), method="bounded")
    return fitted(found.x)[0]


def test_a_homogeneous_sample_has_one_modulus(tmp_path):
    found = js.lab.modulus_over_depth(recorded(hertz(), 3), TIP, 0.0, count=5)
    assert np.all(np.diff(found.depths) > 0)
    np.testing.assert_allclose(found.depths[[0, -1]], [0.8e-9, 8e-9], rtol=0.15)
    away = np.abs(found.youngs_moduli - MODULUS * 1e9) / found.errors
    assert np.all(away < 3), away
    assert found.errors[-1] < 0.01 * MODULUS * 1e9
    assert repr(found).count("successful") == 5
    lines = found.to_csv(tmp_path / "moduli.csv").read_text(encoding="utf-8").splitlines()
    titles, *rows = csv.reader(line for line in lines if not line.startswith("#"))
    assert titles[:3] == ["depth [m]", "youngs modulus [Pa]", "standard error [Pa]"]
    columns = zip(found.depths, found.youngs_moduli, found.errors, strict=True)
    numbers = [[float(cell) for cell in row[:3]] for row in rows]
    np.testing.assert_allclose(numbers, [*columns], rtol=1e-8)
    assert [row[3] for row in rows] == found.statuses


def test_a_bonded_layer_stiffens_with_depth():
    # An incompressible layer (E. K. Dimitriadis et al., Biophys. J. 82, 2798 (2002)).
    thickness = 30.0
    indentation, force = hertz()
    chi = np.sqrt(RADIUS * indentation) / thickness
    force = force * (1 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4)
    found = js.lab.modulus_over_depth(
        recorded((indentation, force), 3, noise=0.02), TIP, 0.0, count=5
    )
    before = np.linspace(-8, 0, 4000, endpoint=False)
    for depth, modulus, error in zip(found.depths, found.youngs_moduli, found.errors, strict=True):
        inside = indentation <= depth * 1e9
        truth = apparent(
            np.append(before, indentation[inside]), np.append(np.zeros(4000), force[inside])
        )
        assert abs(modulus - truth * 1e9) < 3 * error < 0.4 * modulus
    assert np.all(np.diff(found.youngs_moduli) > 0)
    assert found.youngs_moduli[-1] - found.youngs_moduli[0] > 4 * found.errors[0]
    axes = found.plot()
    points = axes.lines[0].get_xydata()
    np.testing.assert_allclose(points, np.stack([found.depths * 1e9, found.youngs_moduli / 1e6], 1))
    plt.close(axes.figure)


@pytest.mark.nightly
def test_a_sticky_homogeneous_sample_is_fitted_where_it_pushes():
    curve = recorded(maugis_with_approach(5.0), 2, points=1000)
    found = js.lab.modulus_over_depth(curve, TIP, 0.0, count=2)
    force = found.parts.curves[0].approach.force
    # Twice JKR's pull-off, 3 pi w R / 2.
    assert np.max(force) == pytest.approx(3 * np.pi * WORK * RADIUS, rel=0.2)
    away = np.abs(found.youngs_moduli - MODULUS * 1e9) / found.errors
    assert np.all(away < 3), away


def test_too_few_depths_and_points_are_refused():
    curve = recorded(hertz(), 3)
    with pytest.raises(ValueError, match="There are 1 depths: give two or more"):
        js.lab.modulus_over_depth(curve, TIP, count=1)
    few = recorded(hertz(), 3, points=500, constant=50.0)
    with pytest.raises(ValueError, match=r"\d+ points in contact: .* need 40. Measure more"):
        js.lab.modulus_over_depth(few, TIP)
