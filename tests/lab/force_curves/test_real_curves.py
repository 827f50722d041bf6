"""Curves of instruments, with the numbers that the tests of their readers expect of them."""

import warnings
from pathlib import Path

import pytest

import jaxstab as js

pytest.importorskip("afmformats")
FOLDER = Path(__file__).parent / "real"
read = js.lab.force_curves.read


def test_a_map_of_jpk():
    curves = read(FOLDER / "2020.02.07-16.29.05.036.jpk-qi-data")
    assert [curve.pixel[0] for curve in curves] == [0, 1, 2, 3]
    assert curves[0].approach.force[0] == pytest.approx(-1.269014596090597e-10)
    assert curves[0].approach.height[0] == pytest.approx(4.716154783699957e-06)
    assert curves[3].instrument == "JPK01496-H-18-0132"


def test_a_curve_of_afm_workshop():
    curve = read(FOLDER / "single_2020-02-14_13.41.25.csv")
    assert curve.approach.force[0] == pytest.approx(1276.4373e-9)


def test_a_curve_of_nt_mdt():
    curve = read(FOLDER / "gel4_DFL_Height_51.txt", spring_constant=0.055, sensitivity=61)
    assert len(curve.approach) + len(curve.retraction) == 1644
    # The largest force is at the end of the approach.
    assert curve.approach.force[-1] == max(curve.approach.force.max(), curve.retraction.force.max())


def test_a_curve_of_jpk_and_its_modulus():
    curve = read(FOLDER.parent / "spot3-0192.jpk-force")
    approach = curve.approach
    assert approach.force[100] == pytest.approx(-4.853736717639109e-10)
    assert approach.height[100] == pytest.approx(2.256791903750211e-05, abs=1e-10)
    assert approach.tip_position[100] == pytest.approx(2.255675939721752e-05, abs=1e-10)
    assert approach.time[100] == pytest.approx(0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", js.exceptions.FitWarning)
        fit = js.lab.fit_curve(curve, js.lab.Paraboloid(10e-6))
        small = js.lab.fit_curve(curve, js.lab.Paraboloid(40e-9))
    # By nanite, and by the program of JPK with a tip of 40 nm.
    for found, modulus in ((fit, 14741.958), (small, 233.1e3)):
        assert abs(found.youngs_modulus - modulus) < 3 * found.errors.youngs_modulus
        assert abs(found.youngs_modulus - modulus) < 0.15 * modulus
    contact = fit.curve.correction.contact_point + fit.contact_point
    assert contact == pytest.approx(1.8029e-5, abs=5e-8)
