"""Contact points by several methods, on synthetic curves whose contact is known."""

import numpy as np
import pytest
from matplotlib import pyplot as plt
from synthetic_curves import MODULUS, RADIUS, hertz, recorded

import jaxstab as js

CONTACT, NOISE, STIFFNESS = 3.0, 0.05, 20.0
TIP = js.lab.Paraboloid(RADIUS * 1e-9)


def measured(law):
    """Return a curve of 2000 points over 45 nm, without drift."""
    return recorded(
        law, 1, contact=CONTACT, noise=NOISE, constant=STIFFNESS, drift=0.0, reach=30.0
    ).corrected()


def away(found):
    """Return the distances of contact points from the truth [nm]."""
    truth = CONTACT - found.curve.correction.contact_point
    return {name: point * 1e9 - truth for name, point in found.points.items()}


def test_on_hertz_each_method_is_as_far_off_as_it_must_be():
    indentation, force = hertz()
    curve = measured((indentation, force))
    fit = js.lab.fit_curve(curve, TIP, 0.0)
    found = js.lab.contact_points(curve, fit)
    distances = away(found)
    assert found.points["fit"] == fit.contact_point
    assert abs(distances["fit"]) < 3 * fit.errors.contact_point * 1e9
    # Where Hertz' force is five times the noise.
    stiffness = 4 / 3 * MODULUS * np.sqrt(RADIUS)
    assert abs(distances["deviation_from_baseline"] + (5 * NOISE / stiffness) ** (2 / 3)) < 0.1
    assert -0.5 < distances["ratio_of_variances"] < 0.5
    # The kink of two lines, by linear least squares at each height, without noise.
    heights = np.append(np.linspace(30, 0, 3000), -indentation - force / STIFFNESS)
    path = np.linspace(30, heights[-1], 3000)
    forces = np.interp(-path, -heights, np.append(np.zeros(3000), force))

    def squares(kink):
        columns = np.stack([np.ones(3000), path, np.maximum(kink - path, 0)], 1)
        return np.linalg.lstsq(columns, forces, rcond=None)[1][0]

    kinks = np.linspace(-3, 1, 401)
    kink = kinks[np.argmin([squares(x) for x in kinks])]
    assert abs(distances["line_and_line"] - kink) < 0.03
    assert found.scatter * 1e9 == pytest.approx(np.std([*distances.values()], ddof=1))


def test_each_fit_finds_the_contact_of_its_own_law():
    height = np.linspace(0, -12, 4000)
    line = -3.0 * height
    found = away(js.lab.contact_points(measured((-height - line / STIFFNESS, line))))
    assert abs(found["line_and_line"]) < 0.01
    assert abs(found["deviation_from_baseline"]) < 0.15
    assert abs(found["ratio_of_variances"]) < 0.1
    polynomial = -(height**3) / (0.3 * height**2 - 0.5 * height + 2)
    found = away(js.lab.contact_points(measured((-height - polynomial / STIFFNESS, polynomial))))
    assert abs(found["line_and_polynomial"]) < 0.05


def test_a_figure_and_a_table_show_each_point_in_the_units_of_the_curve():
    found = js.lab.contact_points(measured(hertz()))
    axes = found.plot()
    drawn = {line.get_label(): line.get_xdata()[0] for line in axes.lines[1:]}
    assert drawn == {name.replace("_", " "): x * 1e9 for name, x in found.points.items()}
    assert all(axes.get_xlim()[0] < x < axes.get_xlim()[1] for x in drawn.values())
    plt.close(axes.figure)
    assert f"{found.scatter * 1e9:.4g} nm" in repr(found).splitlines()[-1]


def test_other_curves_and_fits_are_refused():
    curve = measured(hertz())
    with pytest.raises(TypeError, match="The curve is a tuple: give one ForceCurve"):
        js.lab.contact_points((curve,))
    fit = js.lab.fit_curve(curve, TIP, 0.0, "retraction")
    with pytest.raises(ValueError, match="not one of the approach of this curve"):
        js.lab.contact_points(curve, fit)
    retraction = recorded(hertz(), 1, parts=("retraction",))
    with pytest.raises(ValueError, match="The curve has no approach"):
        js.lab.contact_points(retraction)


def test_one_point_or_none_has_no_scatter_and_a_figure(tmp_path):
    curve = measured(hertz()).in_units("m", "N")
    deepest = float(np.min(curve.approach.tip_position))
    for points in ({"one": np.nan}, {"one": 3e-9, "two": np.nan}, {"one": deepest}):
        found = js.lab.ContactPoints(points, curve)
        assert np.isnan(found.scatter)
        axes = found.plot()
        low, high = axes.get_xlim()
        assert high - low > 0.1
        assert axes.get_xlabel() == "tip position [nm]"
        drawn = sum(np.isfinite(point) for point in points.values())
        assert len(axes.lines) == 1 + drawn
        assert (axes.get_title() == "no contact point found") == (drawn == 0)
        assert repr(found).count("none") == 1 + len(points) - drawn
        plt.close(axes.figure)
    text = found.to_csv(tmp_path / "points.csv").read_text(encoding="utf-8").splitlines()
    assert text[-2:] == ["method,contact point [m]", f"one,{deepest:.9g}"]
