"""Fits of synthetic force curves whose truth is a closed form, and of bad inputs."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from saved import rewrite
from synthetic_curves import (
    MODULUS,
    RADIUS,
    UNITS,
    WORK,
    hertz,
    maugis_with_approach,
    recorded,
)

import jaxstab as js

TIP = js.lab.Paraboloid(RADIUS * 1e-9)


@pytest.mark.parametrize("segment", ["approach", "retraction"])
def test_hertz_without_attraction(segment):
    fit = js.lab.fit_curve(recorded(hertz(), 3), TIP, 0.0, segment)
    assert fit.result == js.RESULTS.successful
    assert abs(fit.youngs_modulus - MODULUS * 1e9) < 3 * fit.errors.youngs_modulus
    assert fit.errors.youngs_modulus < 0.02 * MODULUS * 1e9
    assert fit.work_of_adhesion == 0
    assert np.isnan(fit.range)


@pytest.mark.parametrize(
    ("segment", "tabor"),
    [
        ("approach", 1.0),
        ("retraction", 0.1),
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in (
                ("approach", 0.1),
                ("approach", 5.0),
                ("retraction", 1.0),
                ("retraction", 5.0),
            )
        ),
    ],
)
def test_from_jkr_to_dmt(segment, tabor):
    fit = js.lab.fit_curve(recorded(maugis_with_approach(tabor), 2), TIP, 0.0, segment)
    assert fit.result == js.RESULTS.successful
    length = np.cbrt(RADIUS * (WORK / MODULUS) ** 2) / tabor * 1e-9
    truth = {"youngs_modulus": MODULUS * 1e9, "work_of_adhesion": WORK, "range": length}
    for name, value in truth.items():
        assert abs(getattr(fit, name) - value) < 3 * getattr(fit.errors, name), name
    assert fit.errors.youngs_modulus < 0.1 * MODULUS * 1e9
    assert fit.errors.work_of_adhesion < 0.4 * WORK


def test_a_long_range_with_a_weak_jump_is_found():
    # A short range with the same pull-off is a minimum as well, and the jump moves by points.
    law = {"modulus": 0.44, "work": 0.037, "depth": 9.0}
    curve = recorded(maugis_with_approach(0.04, **law), 7, constant=0.42, noise=0.03)
    fit = js.lab.fit_curve(curve, TIP, 0.0, "retraction")
    length = np.cbrt(RADIUS * (law["work"] / law["modulus"]) ** 2) / 0.04 * 1e-9
    assert fit.result == js.RESULTS.successful
    assert abs(fit.range - length) < 3 * fit.errors.range < 0.1 * length
    assert abs(fit.youngs_modulus - 0.44e9) < 3 * fit.errors.youngs_modulus


@pytest.mark.nightly
def test_an_attraction_of_four_points_does_not_bias_the_modulus():
    law = maugis_with_approach(0.4, modulus=0.56, work=0.03, depth=9.0)
    fit = js.lab.fit_curve(recorded(law, 4, constant=0.24), TIP, 0.0)
    assert abs(fit.youngs_modulus - 0.56e9) < 3 * fit.errors.youngs_modulus
    assert fit.errors.youngs_modulus < 0.15 * 0.56e9


@pytest.mark.nightly
def test_another_law_is_told_and_its_modulus_within_two_errors():
    modulus, work, length = 0.1, 0.05, 5.7
    rings = js.Rings(300, 26.0)
    contact = js.Contact(
        js.solids.AxisymmetricHalfSpace(rings, modulus),
        js.surfaces.paraboloid(rings, RADIUS),
        js.potentials.Exponential(work, length),
    )
    places = np.append(np.linspace(8 * length, 0.1, 60), np.linspace(0.0, -8.0, 60))
    states = js.sweep(contact, js.FarDisplacement(places), order="continuation", stability=False)
    curve = recorded((-places, np.asarray(states.equilibrium.force)), 1, constant=5.0, reach=60.0)
    with pytest.warns(js.exceptions.FitWarning, match="misfit"):
        fit = js.lab.fit_curve(curve, TIP, 0.0)
    assert fit.result == js.RESULTS.misfit
    assert abs(fit.youngs_modulus - modulus * 1e9) < 2 * fit.errors.youngs_modulus


def test_a_cone_of_sneddon_and_its_pyramid():
    tip = js.lab.Cone(30.0)
    depth = np.linspace(0, 60, 2000)
    force = 2 / np.pi * np.tan(np.radians(30)) * 0.01 * depth**2
    curve = recorded((depth, force), 1)
    fit = js.lab.fit_curve(curve, tip, 0.3)
    modulus = 0.01e9 * (1 - 0.3**2)
    assert abs(fit.youngs_modulus - modulus) < 3 * fit.errors.youngs_modulus
    pyramid = js.lab.Pyramid(30.0)
    ratio = js.lab.fit_curve(curve, pyramid, 0.3).youngs_modulus / fit.youngs_modulus
    assert ratio == pytest.approx(2 / np.pi / 0.7453, rel=1e-3)


def test_a_curve_that_is_no_hertz_has_a_result_of_its_own():
    depth = np.linspace(0, 40, 2000)
    # A thin sample on a stiff base.
    force = 0.002 * depth**1.5 * (1 + (depth / 15) ** 4)
    with pytest.warns(js.exceptions.FitWarning, match="misfit"):
        fit = js.lab.fit_curve(recorded((depth, force), 1), TIP)
    assert fit.result == js.RESULTS.misfit
    assert fit.youngs_modulus > 0
    assert "does not describe" in fit.status


@pytest.mark.nightly
def test_a_cone_does_not_describe_the_curve_of_a_sphere():
    with pytest.warns(js.exceptions.FitWarning, match="another shape of the tip"):
        fit = js.lab.fit_curve(recorded(hertz(), 3, noise=0.02), js.lab.Cone(35.0), 0.0)
    assert fit.result == js.RESULTS.misfit


@pytest.mark.nightly
def test_units_of_the_curve_change_nothing_and_print_shows_them():
    curve = recorded(hertz(), 3)
    fit = js.lab.fit_curve(curve, TIP, 0.0)
    other = js.lab.fit_curve(curve.in_units("µm", "pN"), TIP, 0.0)
    assert other.youngs_modulus == pytest.approx(fit.youngs_modulus, rel=1e-6)
    # The search ends where the sum of squares no longer changes, to a fraction of an error.
    close = 1e-3 * fit.errors.contact_point
    assert other.contact_point == pytest.approx(fit.contact_point, abs=close)
    np.testing.assert_allclose(other.forces, 1e3 * fit.forces, rtol=1e-4, atol=1)
    assert (fit.curve.unit, fit.curve.force_unit) == UNITS
    text = repr(fit)
    assert "MPa" in text
    assert "nN/nm²" in text
    own = fit.curve.approach
    assert fit.forces.shape == own.force.shape
    assert np.std(own.force - fit.forces) < 0.06


@pytest.mark.nightly
def test_correlated_noise_makes_errors_larger():
    def found(seed, length):
        random = np.random.default_rng(seed)
        curve = recorded(hertz(), seed, noise=0.0)
        noise = random.normal(size=(2, 2000 + length - 1))
        noise = [np.convolve(one, np.ones(length) / np.sqrt(length), "valid") for one in noise]
        segments = {
            name: js.lab.force_curves.Segment(
                part.force + 0.05 * extra, part.height, part.tip + 0.05 * extra / 0.5, part.time
            )
            for (name, part), extra in zip(curve.segments.items(), noise, strict=True)
        }
        curve = js.lab.force_curves.ForceCurve(
            **segments, spring_constant=0.5, unit=UNITS[0], force_unit=UNITS[1]
        )
        return js.lab.fit_curve(curve, TIP, 0.0)

    white, correlated = ([found(seed, length) for seed in range(8)] for length in (1, 25))
    errors = [np.mean([fit.errors.youngs_modulus for fit in fits]) for fits in (white, correlated)]
    # The mean of n points with such noise scatters by 25^(1/2).
    assert 2.5 < errors[1] / errors[0] < 10
    for fits in (white, correlated):
        away = [(fit.youngs_modulus - MODULUS * 1e9) / fit.errors.youngs_modulus for fit in fits]
        assert np.sqrt(np.mean(np.square(away))) < 1.8


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tip": 5e-6}, "give a Sphere"),
        ({"curve": np.ones(3)}, "give a ForceCurve"),
        ({"poisson_ratio": 0.6}, "Poisson's ratio is 0.6"),
        ({"segment": "both"}, "'both': choose"),
    ],
)
def test_bad_inputs_are_refused(change, message):
    given = {"curve": recorded(hertz(), 3), "tip": TIP} | change
    with pytest.raises((TypeError, ValueError), match=message):
        js.lab.fit_curve(**given)


def test_curves_that_lack_something_are_refused():
    curve = recorded(hertz(), 3, parts=("retraction",))
    with pytest.raises(ValueError, match="no approach"):
        js.lab.fit_curve(curve, TIP)
    loose = js.lab.force_curves.ForceCurve(curve.retraction, None)
    with pytest.raises(ValueError, match="no spring constant"):
        js.lab.fit_curve(loose, TIP)


def test_tips_in_other_units_are_refused():
    for make, message in (
        (lambda: js.lab.Sphere(5.0), "in metres"),
        (lambda: js.lab.FlatPunch(-1e-6), "in metres"),
        (lambda: js.lab.Cone(0.3), "in degrees"),
        (lambda: js.lab.Pyramid(35.0, faces=5), "three or four"),
    ):
        with pytest.raises(ValueError, match=message):
            make()


def test_a_real_curve_agrees_with_hertz():
    pytest.importorskip("afmformats")
    path = Path(__file__).parent / "force_curves" / "spot3-0192.jpk-force"
    curve = js.lab.force_curves.read(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", js.exceptions.FitWarning)
        fit = js.lab.fit_curve(curve, js.lab.Paraboloid(18.6e-6))
    # By least squares of F = 4/3 E* sqrt(R) d^(3/2) over the tip position of the corrected curve.
    assert abs(fit.youngs_modulus - 10.8e3) < 3 * fit.errors.youngs_modulus
    assert fit.errors.youngs_modulus < 1.5e3


def test_a_fit_is_written_as_text_drawn_and_labelled(tmp_path):
    curve = recorded(maugis_with_approach(1.0), 2).in_units("µm", "nN")
    fit = js.lab.fit_curve(curve, TIP, 0.0, "retraction")
    path = fit.to_csv(tmp_path / "fit.csv")
    text = path.read_text(encoding="utf-8").splitlines()
    assert "# segment: retraction" in text
    (stated,) = (line for line in text if line.startswith("# youngs_modulus"))
    value, error = (float(part.split()[0]) for part in stated.split(": ")[1].split("error "))
    assert value == pytest.approx(fit.youngs_modulus, rel=1e-8)
    assert error == pytest.approx(fit.errors.youngs_modulus, rel=1e-2)
    again = js.lab.force_curves.read(path)
    assert again.spring_constant == pytest.approx(0.5, rel=1e-8)
    np.testing.assert_allclose(1e9 * again.retraction.force, fit.points.force, rtol=1e-8)
    with pytest.raises(FileExistsError):
        fit.to_csv(path)

    dataset = fit.to_dataset()
    np.testing.assert_array_equal(dataset["fitted_force"], fit.forces)
    assert dataset["fitted_force"].attrs["units"] == "nN"
    assert float(dataset["youngs_modulus"]) == fit.youngs_modulus
    assert dataset["youngs_modulus"].attrs["standard_error"] == fit.errors.youngs_modulus
    dataset.to_netcdf(tmp_path / "fit.nc", engine="h5netcdf")

    axes = fit.plot()
    # The travel without contact, 150 nm, is out of sight; contact and pull-off are not.
    low, high = axes.get_xlim()
    depth = np.ptp(fit.points.tip_position[fit.points.force > 1])
    assert depth < high - low < 3 * depth
    assert low < 1e6 * fit.contact_point < high
    assert axes.get_ylim()[0] < fit.forces.min() < fit.forces.max() < axes.get_ylim()[1]
    assert {"retraction", "fit", "contact point"} <= {line.get_label() for line in axes.lines}
    axes.get_figure().clear()


def test_a_fit_and_a_curve_come_back_from_a_file_to_the_last_bit(tmp_path):
    curve = replace(
        recorded(hertz(), 2).in_units("µm", "nN"),
        pauses=(js.lab.force_curves.Segment(np.ones(3), np.zeros(3), stated_speed=0.1),),
        position=(1.5, -2.0),
        pixel=(3, 4),
        remarks=("made up",),
    )
    fit = js.lab.fit_curve(curve, TIP, 0.3, "retraction")
    fit = replace(fit, tip=js.lab.Pyramid(60.0, faces=3))
    again = js.load(js.save(tmp_path / "fit.nc", fit))
    assert type(again) is js.lab.ForceCurveFit
    assert again.to_dataset().identical(fit.to_dataset())
    assert (again.tip, again.poisson_ratio) == (fit.tip, 0.3)
    assert repr(again.errors) == repr(fit.errors)
    assert again.result == fit.result
    assert again.curve.correction == fit.curve.correction
    assert repr(again) == repr(fit)
    lone = js.load(js.save(tmp_path / "curve.nc", curve))
    assert repr(lone) == repr(curve)
    assert (lone.pixel, lone.position, lone.pauses[0].stated_speed) == ((3, 4), (1.5, -2.0), 0.1)
    np.testing.assert_array_equal(lone.retraction.tip, curve.retraction.tip)
    with pytest.raises(TypeError, match="written alone: give no result"):
        js.save(tmp_path / "other.nc", fit, fit)


def test_a_file_names_no_class_but_those_for_files(tmp_path):
    saved = js.save(tmp_path / "curve.nc", recorded(hertz(), 1))
    changed = tmp_path / "changed.nc"
    for name in ("pathlib:Path", "jaxstab:RESULTS", "jaxstab.lab:fit_curve", "jaxstab.none:Fit"):
        changed.write_bytes(saved.read_bytes())
        rewrite(changed, "jaxstab.lab.force_curves:ForceCurve", name, "class")
        with pytest.raises(ValueError, match="no class of jaxstab for files"):
            js.load(changed)
    content = saved.read_bytes()
    assert b"nN" in content
    changed.write_bytes(content.replace(b"nN", b"pN"))
    with pytest.raises(ValueError, match=r"changed.nc .* is damaged"):
        js.load(changed)


def test_a_figure_of_a_curve_in_metres_is_in_readable_units():
    curve = recorded(hertz(), 3).in_units("m", "N")
    fit = js.lab.fit_curve(curve, TIP, 0.0)
    axes = fit.plot()
    assert axes.get_xlabel() == "tip position [nm]"
    assert axes.get_ylabel() == "force [nN]"
    (drawn,) = (line for line in axes.lines if line.get_label() == "fit")
    np.testing.assert_allclose(drawn.get_ydata(), 1e9 * fit.forces)
    np.testing.assert_allclose(drawn.get_xdata(), 1e9 * fit.tip_positions)
    axes.get_figure().clear()
