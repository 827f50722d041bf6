"""Fits to force curves as an instrument records them."""

import warnings
from dataclasses import replace

import equinox as eqx
import jax
import matplotlib.pyplot as plt
import numpy as np
import pytest
import synthetic_curves as synthetic
from scipy.interpolate import CubicSpline

import jaxstab as js
from jaxstab.calibration.measured_curve import means_of

WORK, RANGE, MODULUS, RADIUS = 0.05, 6.0, 0.1, 20.0
GRID = js.Grid(8, (48.0, 48.0))
RECORD = {"noise": 0.2, "constant": 1.0, "reach": 60.0, "speed": 50.0, "contact": 1.0, "drift": 0.0}


def contact(work=WORK, length=RANGE, modulus=MODULUS, **units):
    units = units or {"unit": "nm", "pressure_unit": "GPa"}
    solid = js.FreeHalfSpace(GRID, modulus)
    law = js.potentials.Exponential(work, length)
    return js.Contact(solid, js.surfaces.paraboloid(GRID, RADIUS), law, **units)


@pytest.fixture(scope="module")
def law():
    """Indentations and forces of the contact, computed at one after another."""
    indentation = np.linspace(8.0, -46.0, 91)
    states = js.sweep(
        contact(), js.FarDisplacement(-indentation), order="continuation", stability=False
    )
    return indentation[::-1], np.asarray(states.equilibrium.force)[::-1]


def deviations(fit):
    """Return the errors of work of adhesion, range and modulus over their standard errors."""
    found, errors = jax.tree.leaves(fit.parameters), jax.tree.leaves(fit.standard_errors)
    truth = [WORK, RANGE, MODULUS]
    return np.array([(x - y) / e for x, y, e in zip(found, truth, errors, strict=True)])


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.WindowWarning")
def test_a_retraction_gives_modulus_work_range_and_zeros_within_their_errors(law):
    curve = synthetic.recorded(law, 0, **RECORD)
    assert abs(np.diff(curve.corrected().retraction.tip_position)).max() > 1  # a jump
    fit = js.calibrate(contact(0.06, 5.0, 0.12), js.FarDisplacement, curve)
    assert (abs(deviations(fit)) < 3).all()
    assert np.sqrt(np.mean(deviations(fit) ** 2)) > 0.1
    assert fit.names[3:] == ("offset", "baseline", "tilt")
    # Offset, baseline and tilt remain, since the curve was corrected roughly.
    corrected = curve.corrected().correction
    contact_point = corrected.contact_point + float(fit.offset)
    assert abs(contact_point - 1) < 3 * fit.offset_error + 0.02
    line = corrected.retraction
    assert abs(line.slope + fit.tilt - 2e-3) < 3 * fit.tilt_error
    height = corrected.contact_point - RECORD["contact"]
    assert abs(line.force + fit.baseline - 0.4 - 2e-3 * height) < 3 * fit.baseline_error
    rows = {line.split()[0]: line.split() for line in str(fit).splitlines()[3:]}
    assert [rows[name][-1] for name in fit.names] == ["J/m²", "nm", "GPa", "nm", "nN", "N/m"]
    axes = js.plots.calibration(fit)
    np.testing.assert_allclose(axes.lines[1].get_ydata(), fit.force)
    np.testing.assert_allclose(axes.lines[0].get_ydata() - fit.force, fit.residuals, atol=1e-12)
    assert axes.get_ylabel() == "force [nN]"
    axes = js.plots.calibration(fit, "residuals", axes=plt.subplots()[1])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), fit.residuals)
    assert axes.get_xlabel() == "tip position [nm]"
    plt.close("all")


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.WindowWarning")
@pytest.mark.parametrize(
    ("kind", "segment"),
    [
        (js.FarDisplacement, "approach"),
        (js.FarDisplacement, "both"),
        (js.Spring, "retraction"),
        (js.Spring, "both"),
    ],
)
def test_other_segments_and_a_spring_give_the_same(law, kind, segment):
    curve = synthetic.recorded(law, 1, **RECORD)
    fit = js.calibrate(contact(0.06, 5.0, 0.12), kind, curve, segment=segment)
    assert (abs(deviations(fit)) < 3).all()


def means_of_jkr(kind, segment, seed):
    """Return means over a curve of JKR's law, their errors by it, and the roots of their weights.

    The zeros are known here, and nothing is left of the contact point.
    """
    law = synthetic.jkr(3.0)
    curve = synthetic.recorded(law, seed, noise=0.05, drift=0.0, contact=0.0, tilt=0.0)
    offsets = {"approach": 0.3, "retraction": 0.4}
    flat = {
        name: replace(x, force=x.force - offsets[name], tip=x.tip - offsets[name] / 0.5)
        for name, x in curve.segments.items()
    }
    found = means_of(contact(), kind, replace(curve.corrected(), **flat), segment, 40)
    tip = np.asarray(found.load.value) + (found.forces / 0.5 if kind is js.Spring else 0)
    expected = np.where(np.abs(found.forces) < 0.2, 0, np.interp(-tip, *law))
    if kind is js.Spring:
        height = -law[0] - law[1] / 0.5
        down = np.argmax(height)
        on_law = np.interp(-found.load.value, -height[down:], law[1][down:])
        expected = np.where(np.abs(found.forces) < 0.2, 0, on_law)
    return found, found.forces - expected, np.sqrt(found.weights)


@pytest.mark.parametrize("kind", [js.FarDisplacement, js.Spring])
def test_means_lie_on_the_law_with_errors_as_their_weights_say(kind):
    contacts, free = [], []
    for seed in range(10):
        found, errors, roots = means_of_jkr(kind, "retraction", seed)
        # None lies over the jump.
        assert np.sum(np.abs(found.forces) > 0.2) > 25
        is_free = np.abs(found.forces) < 0.2
        contacts.append((errors * roots)[~is_free & (roots > 0)])
        free.append((errors * roots)[is_free & (roots > 0)])
        assert (found.weights >= 0).all() and found.weights.max() == 1
        assert len(found.weights) == 59
    spread = np.std(np.concatenate(contacts)) / np.std(np.concatenate(free))
    assert 0.7 < spread < 1.4
    mean = np.mean(np.concatenate(contacts)) / np.std(np.concatenate(free))
    assert abs(mean) < 0.3


@pytest.mark.parametrize("kind", [js.FarDisplacement, js.Spring])
@pytest.mark.parametrize(("constant", "height_noise"), [(0.5, 0.5), (5.0, 0.3), (20.0, 0.1)])
def test_weights_allow_for_the_noise_of_the_height(kind, constant, height_noise):
    """The force of a stiff sample changes with the height as that of the cantilever."""
    indentation, force = synthetic.hertz()
    height = -indentation - force / constant
    contacts, free = [], []
    for seed in range(5):
        curve = synthetic.recorded(
            (indentation, force),
            seed,
            constant=constant,
            height_noise=height_noise,
            contact=0.0,
            drift=0.0,
            tilt=0.0,
            offsets=(0.0, 0.0),
        )
        found = means_of(contact(), kind, curve, "approach", 20)
        point = curve.corrected().correction.contact_point
        if kind is js.Spring:
            position = np.asarray(found.zeros.heights) + point
            exact = np.interp(position, height[::-1], force[::-1])
        else:
            exact = np.interp(-(np.asarray(found.load.value) + point), indentation, force)
        scaled = (found.forces - exact) * np.sqrt(found.weights) / found.noise
        is_free = exact < 0.1
        contacts.append(scaled[~is_free & (found.weights > 0)])
        free.append(scaled[is_free & (found.weights > 0)])
    # Beside what is left of the baseline, which all means of a curve have in common.
    spread = np.sqrt(np.mean([np.var(one) for one in contacts]))
    assert 0.6 < spread < 1.4, spread
    assert np.sqrt(np.mean(np.concatenate(free) ** 2)) < 1.5


def test_means_beside_a_sharp_minimum_lie_on_the_law_within_their_errors(law):
    """The force bends there within the points of one of 40 means, which are then divided."""
    fine = np.linspace(law[0][0], law[0][-1], 20000)
    forces = CubicSpline(*law)(fine)
    errors = []
    for seed in range(20):
        known = {"contact": 0.0, "drift": 0.0, "tilt": 0.0, "offsets": (0.0, 0.0)}
        curve = synthetic.recorded(law, seed, **RECORD | known)
        flat = replace(curve.corrected(), **curve.segments)
        found = means_of(contact(), js.FarDisplacement, flat, "retraction", 40)
        away = found.forces - np.interp(-np.asarray(found.load.value), fine, forces)
        is_sharp = found.forces < 0.6 * forces.min()
        errors.append((away * np.sqrt(found.weights) / found.noise)[is_sharp])
    errors = np.concatenate(errors)
    assert 0.8 < np.sqrt(np.mean(errors**2)) < 1.2
    assert abs(errors.mean()) < 0.25


def test_both_segments_are_fitted_in_the_order_of_the_measurement():
    found = {name: means_of_jkr(js.Spring, name, 0)[0] for name in ("approach", "retraction")}
    both = means_of_jkr(js.Spring, "both", 0)[0]
    forces = np.concatenate([part.forces for part in found.values()])
    np.testing.assert_allclose(both.forces, forces)
    positions = np.asarray(both.load.value)
    turn = np.argmin(positions)
    assert (np.diff(positions[: turn + 1]) <= 0).all()
    assert (np.diff(positions[turn + 1 :])[both.weights[turn + 2 :] > 0] > 0).all()
    np.testing.assert_allclose(both.load.stiffness, 0.5 / 48**2)
    # The clock starts at the turn, and changes its sign there.
    is_approach = np.arange(len(positions)) < len(positions) // 2
    clocks = np.asarray(both.zeros.clocks)
    assert (clocks[is_approach] < 0).all() and (clocks[~is_approach] > 0).all()
    np.testing.assert_allclose(np.ptp(clocks), 1)
    np.testing.assert_array_equal(both.zeros.is_in, [is_approach, ~is_approach])


def with_zeros(curve, forces, drift):
    """Return a corrected curve whose correction has left a force in each segment, and a drift."""
    left = {}
    for name, segment in curve.segments.items():
        height = segment.height + drift * (segment.time - curve.approach.time[-1])
        force = segment.force + forces[name][0] + forces[name][1] * height
        tip = height + force / curve.spring_constant
        left[name] = replace(segment, height=height, force=force, tip=tip)
    return replace(curve, **left)


@pytest.mark.parametrize("kind", [js.FarDisplacement, js.Spring])
def test_what_a_correction_leaves_is_what_the_zeros_of_a_fit_add(kind):
    """F(load - shift) + e is what is measured at the load, with the zeros that the curve has."""
    law = synthetic.hertz()
    options = {"noise": 1e-9, "drift": 0.0, "contact": 0.0, "tilt": 0.0, "offsets": (0, 0)}
    exact = synthetic.recorded(law, 0, constant=5.0, **options)
    correction = replace(exact.corrected().correction, removes_drift=True, drift_error=0.2)
    exact = replace(exact, correction=correction)
    forces = {"approach": (0.3, -2e-3), "retraction": (-0.2, 1e-3)}
    curve = with_zeros(exact, forces, 0.1)
    found = means_of(contact(), kind, curve, "both", 40)
    assert found.zeros.drift_error is None
    # Heights that move as fast as hysteresis have no drift to fit.
    left = replace(curve, correction=replace(correction, removes_drift=False))
    assert means_of(contact(), kind, left, "both", 40).zeros.drift_error == 0
    shifts, lines = map(np.asarray, found.zeros.responses())
    assert found.zeros.names == (
        "offset",
        "approach.baseline",
        "retraction.baseline",
        "approach.tilt",
        "retraction.tilt",
        "drift",
    )
    span = np.ptp(np.concatenate([curve.approach.time, curve.retraction.time]))
    zeros = np.array([0, 0.3, -0.2, -2e-3, 1e-3, 0.1 * span])
    load = np.asarray(found.load.value) - shifts @ zeros
    force = found.forces - lines @ zeros
    if kind is js.Spring:
        load = load + force / 5.0
    expected = np.interp(-load, *law, left=0.0)
    # A mean over points of which the first ones are in contact is off by 0.02.
    np.testing.assert_allclose(force, expected, atol=0.03)
    assert np.sum(np.abs(found.forces - np.interp(-found.load.value, *law, left=0)) > 0.1) > 80
    # One segment has a single baseline, and the error of the drift that was removed.
    one = means_of(contact(), kind, curve, "retraction", 40).zeros
    assert one.names == ("offset", "baseline", "tilt", "drift")
    np.testing.assert_allclose(one.drift_error, 0.2 * span / 2, rtol=0.02)
    assert found.zeros.drift_error is None
    # So do both, if they were corrected by one baseline.
    shared = replace(curve, correction=replace(correction, retraction=correction.approach))
    assert means_of(contact(), kind, shared, "both", 40).zeros.names == one.names


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.WindowWarning")
def test_baselines_that_differ_and_a_drift_do_not_bias_the_fit_to_both_segments(law):
    """They differ by seven of their errors, and a drift of several errors is left."""
    curve = synthetic.recorded(law, 1, **RECORD).corrected()
    forces = {"approach": (0.1, 0.0), "retraction": (-0.05, 0.0)}
    curve = with_zeros(curve, forces, 0.2)
    start = contact(0.06, 5.0, 0.12)
    fit = js.calibrate(start, js.FarDisplacement, curve, segment="both", points=20)
    assert (abs(deviations(fit)) < 3).all()
    assert fit.standard_errors[1] < 0.01 * MODULUS
    apart = fit.baseline[0] - fit.baseline[1] - 0.15
    assert abs(apart) < 4 * np.hypot(*fit.baseline_error)
    assert fit.baseline.shape == fit.tilt_error.shape == (2,)
    assert abs(fit.drift) > 2 * fit.drift_error
    rows = {line.split()[0]: line.split() for line in str(fit).splitlines()[3:]}
    assert [*rows] == [*fit.names]
    values = [float(rows[name][1]) for name in fit.names[4:]]
    np.testing.assert_allclose(values, [*fit.baseline, *fit.tilt, fit.drift], rtol=1e-4)
    assert [rows[name][-1] for name in fit.names[3:]] == ["nm", *["nN"] * 2, *["N/m"] * 2, "nm"]
    moved = eqx.tree_at(lambda fit: fit.baseline, fit, fit.baseline + np.array([0.3, 0.4]))
    raised = fit.with_error_of_grid(moved)
    np.testing.assert_allclose(raised.baseline_error, np.hypot(fit.baseline_error, [0.3, 0.4]))
    np.testing.assert_allclose(raised.covariance[4, 5], fit.covariance[4, 5] + 0.12)


def test_units_of_curve_and_contact_are_converted():
    curve = synthetic.recorded(synthetic.dmt(), 0)
    one = means_of(contact(), js.FarDisplacement, curve, "approach", 20)
    metres = contact(unit="m", pressure_unit="Pa")
    two = means_of(metres, js.FarDisplacement, curve.in_units("µm", "pN"), "approach", 20)
    np.testing.assert_allclose(two.load.value, 1e-9 * one.load.value, rtol=1e-6)
    np.testing.assert_allclose(two.forces, 1e-9 * one.forces, rtol=1e-6, atol=1e-15)
    np.testing.assert_allclose(two.weights, one.weights, rtol=1e-6)


def test_missing_points_have_no_part_in_means():
    curve = synthetic.recorded(synthetic.dmt(), 0).corrected()
    force = curve.approach.force.copy()
    force[1500:1503] = np.nan
    holed = replace(curve, approach=replace(curve.approach, force=force))
    means = means_of(contact(), js.FarDisplacement, holed, "approach", 20)
    assert np.isfinite(means.forces).all()


@pytest.mark.parametrize("name", ["jkr", "dmt"])
def test_a_first_guess_is_near_the_sphere_of_a_closed_form(name):
    law = {"jkr": synthetic.jkr(3.0), "dmt": synthetic.dmt()}[name]
    curve = synthetic.recorded(law, 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", js.exceptions.FitWarning)
        guess = js.first_guess(curve, synthetic.RADIUS, 0.5, points=16)
        metres = js.first_guess(curve.in_units("m", "N"), 1e-9 * synthetic.RADIUS, 0.5, points=16)
    modulus = 1e-3 * guess.solid.youngs_modulus / (1 - 0.5**2)
    assert abs(modulus / synthetic.MODULUS - 1) < 0.03
    # nm MPa = 1e-3 J/m^2. Its work and range have the pull-off of the curve.
    work = 1e-3 * guess.potential.surface_energy
    stress = work / guess.potential.length
    pull_off = js.references.maugis.pull_off(synthetic.RADIUS, modulus, work, stress).force
    assert abs(pull_off / law[1].min() - 1) < 0.1
    # The instrument counts from 3 nm, and the corrected curve from the contact point.
    assert abs(guess.datum - 3 + curve.corrected().correction.contact_point) < 0.3
    # All that attracts is on the window.
    half = guess.grid.lengths[0] / 2
    deepest = -curve.corrected().retraction.tip_position.min()
    assert half > np.sqrt(2 * synthetic.RADIUS * (deepest + 3 * guess.potential.length))
    assert guess.resolution >= 1
    np.testing.assert_allclose(metres.solid.youngs_modulus, guess.solid.youngs_modulus, rtol=1e-3)
    np.testing.assert_allclose(1e9 * metres.grid.lengths, guess.grid.lengths, rtol=1e-3)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.FitWarning")
@pytest.mark.parametrize("tabor", [0.15, 1.0, 5.0])
def test_a_first_guess_finds_modulus_and_work_from_jkr_to_dmt(tabor):
    """Within the noise the work of adhesion and a range that is too long make up for each other."""
    for seed in range(2):
        law = synthetic.maugis(tabor)
        pull = -law[1].min()
        curve = synthetic.recorded(law, seed, constant=2.0, noise=0.02 * pull, reach=60.0)
        guess = js.first_guess(curve, synthetic.RADIUS, 0.0, points=16)
        assert abs(1e-3 * guess.solid.youngs_modulus / synthetic.MODULUS - 1) < 0.01
        assert abs(1e-3 * guess.potential.surface_energy / synthetic.WORK - 1) < 0.25


def test_a_first_guess_says_what_it_lacks():
    jkr = synthetic.recorded(synthetic.jkr(3.0), 0)
    with pytest.warns(
        js.exceptions.FitWarning, match=r"range of about .* nm, and a grid of 8 points"
    ) as said:
        js.first_guess(jkr, synthetic.RADIUS, 0.5, points=8)
    assert "where=lambda contact: (contact.potential.surface_energy" in str(said[0].message)
    hertz = synthetic.recorded(synthetic.hertz(), 0)
    for part in ("approach", "retraction"):
        with pytest.warns(js.exceptions.FitWarning, match=f"the {part} shows no attraction"):
            hard = js.first_guess(hertz, synthetic.RADIUS, 0.5, segment=part, points=8)
        assert isinstance(hard.potential, js.potentials.NoAdhesion)
        modulus = 1e-3 * hard.solid.contact_modulus
        assert abs(modulus / synthetic.MODULUS - 1) < 0.03
        assert abs(hard.datum - 3 + hertz.corrected().correction.contact_point) < 0.1
    without = {name: replace(x, tip=None) for name, x in jkr.segments.items()}
    cases = [
        (ValueError, "spring constant", replace(jkr, **without, spring_constant=None), 20.0),
        (ValueError, "has no retraction, but approach", replace(jkr, retraction=None), 20.0),
        (
            ValueError,
            "neither an approach nor a r",
            replace(jkr, approach=None, retraction=None),
            9,
        ),
        (ValueError, "The radius is 0", jkr, 0.0),
        (TypeError, "Segment is no force curve", jkr.approach, 20.0),
    ]
    for kind, message, curve, radius in cases:
        with pytest.raises(kind, match=message):
            js.first_guess(curve, radius, 0.5)


def with_forces(curve, change, constant=None):
    """Return a curve with changed forces, or of another cantilever, with its tip positions."""
    constant = constant or curve.spring_constant
    changed = {}
    for name, segment in curve.segments.items():
        force = change(segment.force)
        changed[name] = replace(segment, force=force, tip=segment.height + force / constant)
    return replace(curve, **changed, spring_constant=constant)


@pytest.mark.parametrize(("name", "factor"), [("hertz", 1e-6), ("hertz", 0.9), ("jkr", 0.5)])
def test_a_spring_constant_that_is_too_small_is_named(name, factor):
    curve = synthetic.recorded({"hertz": synthetic.hertz, "jkr": synthetic.jkr}[name](), 0)
    weak = with_forces(curve, lambda force: force, factor * curve.spring_constant)
    with pytest.raises(ValueError, match=r"The tip rises .*the spring constant is too small"):
        js.first_guess(weak, RADIUS, 0.0)
    with pytest.raises(ValueError, match=r"The tip rises .*the spring constant is too small"):
        js.calibrate(contact(), js.FarDisplacement, weak)


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.FitWarning")
def test_a_first_guess_is_near_for_clipped_digitised_and_exact_forces():
    exact = synthetic.recorded(
        synthetic.hertz(), 0, noise=0.0, tilt=0.0, offsets=(0.0, 0.0), drift=0.0
    )
    noisy = synthetic.recorded(synthetic.hertz(), 0)
    curves = [exact, with_forces(exact, lambda force: np.round(force, 1))]
    curves += [with_forces(noisy, lambda force, t=t: np.minimum(force, t)) for t in (5, 20, 40)]
    for curve in curves:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            guess = js.first_guess(curve, RADIUS, 0.0, pressure_unit="GPa", points=8)
        assert abs(guess.solid.youngs_modulus / synthetic.MODULUS - 1) < 0.15
    coarse = with_forces(exact, lambda force: 10 * np.round(force / 10))
    with pytest.raises(ValueError, match="The retraction shows no indentation"):
        js.first_guess(coarse, RADIUS, 0.0)


@pytest.mark.parametrize("tail", [0.05, -0.05])
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.FitWarning")
def test_a_first_guess_of_a_soft_sample_is_near_beside_a_weak_tail(tail):
    """A bead of 18.6 um on a gel of 12 kPa, in um and nN, whose force begins 1 um away."""
    indentation = np.linspace(-12, 1, 20000)
    stiffness = 4 / 3 * 16.0 * np.sqrt(18.6)
    force = stiffness * np.maximum(indentation, 0) ** 1.5
    force += tail * np.exp(np.minimum(indentation, 0))
    curve = synthetic.recorded(
        (indentation, force), 0, constant=11.6, noise=0.008, tilt=0.0, drift=0.0, reach=20.0
    )
    curve = replace(curve, unit="µm")
    guess = js.first_guess(curve, 18.6, 0.5, segment="approach", points=8, pressure_unit="kPa")
    assert abs(guess.solid.youngs_modulus / 12 - 1) < 0.25


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_a_radius_in_another_unit_than_the_curve_is_noticed(factor):
    """A bead of 5 um on a cantilever of 0.5 N/m, which presses it in by 8 nm."""
    modulus, radius = synthetic.MODULUS, 5e3
    indentation, force = synthetic.hertz()
    force = force * np.sqrt(radius / synthetic.RADIUS)
    curve = synthetic.recorded((indentation, force), 0, constant=0.5, reach=2e4, speed=5e3)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", js.exceptions.FitWarning)
        guess = js.first_guess(curve.in_units("µm", "nN"), factor * 5, 0.5, points=8)
    said = " ".join(str(one.message) for one in caught)
    if factor == 1:
        assert "radius" not in said
        assert abs(1e-3 * guess.solid.contact_modulus / modulus - 1) < 0.05
    if factor < 1:
        assert f"exceeds the radius, {factor * 5:.3g} µm" in said
    if factor > 1:
        assert "ball of the radius, 5e+03 µm" in said and "0.5 N/m by 1.03e+04 µm" in said


@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.WindowWarning")
def test_a_map_with_holes_and_bad_curves_gives_maps_with_errors(law):
    good = synthetic.recorded(law, 0, **RECORD)
    named = {(0, 0): good, (2, 1): -good}
    curves = [replace(x, pixel=pixel, source=f"pixel {pixel}") for pixel, x in named.items()]
    whole = js.force_curves.ForceCurves(tuple(curves), (3, 2))
    start = contact(0.06, 5.0, 0.12)
    message = r"1 of 2 curves have no fit. pixel \(2, 1\): .*-curve"
    with pytest.warns(js.exceptions.FitWarning, match=message):
        fits = js.calibrate_each(lambda _: start, js.FarDisplacement, whole)
    modulus, error = (f("solid.youngs_modulus") for f in (fits.values, fits.errors))
    assert np.argwhere(np.isfinite(modulus)).tolist() == [[0, 0]]
    np.testing.assert_array_equal(np.isnan(error), np.isnan(modulus))
    assert abs(modulus[0, 0] - MODULUS) < 3 * error[0, 0]
    assert fits.fits[1] is None and "reverse the forces" in fits.reasons[1]
    shown = {line.split()[0]: line.split() for line in repr(fits).splitlines()[1:]}
    value, error_shown = (float(shown["solid.youngs_modulus"][i]) for i in (1, 5))
    np.testing.assert_allclose([value, error_shown], [modulus[0, 0], error[0, 0]], rtol=0.05)
    assert shown["solid.youngs_modulus"][-1] == "GPa"
    assert "1 of 2 curves fitted" in repr(fits) and "pixel (2, 1): The approach" in repr(fits)
    with pytest.raises(ValueError, match="parameter is 'modulus'"):
        fits.values("modulus")
    # The fit of the same curve on another grid, of which the bad one has none either.
    moved = eqx.tree_at(lambda fit: fit.parameters[1], fits.fits[0], modulus[0, 0] + 0.01)
    raised = fits.with_error_of_grid(replace(fits, fits=(moved, None)))
    expected = np.hypot(error[0, 0], 0.01)
    np.testing.assert_allclose(raised.errors("solid.youngs_modulus")[0, 0], expected)
    # A fit of other parameters has no value of this one.
    other = replace(fits.fits[0], names=("other", *fits.fits[0].names[1:]))
    apart = replace(fits, fits=(fits.fits[0], other), reasons=("", ""))
    assert np.isfinite(apart.values("solid.youngs_modulus")).sum() == 2
    assert np.argwhere(np.isfinite(apart.errors(fits.names[0]))).tolist() == [[0, 0]]
    assert np.argwhere(np.isfinite(apart.values("other"))).tolist() == [[2, 1]]
    assert apart.names == (*fits.names, "other") and "other" in repr(apart)
    alone = replace(fits, fits=(None, moved), reasons=("far away", ""))
    with pytest.raises(
        js.exceptions.SolverError, match=r"^None of 2 curves has a fit. pixel \(0, 0\): On the o"
    ):
        fits.with_error_of_grid(alone)


def test_several_curves_without_any_fit_are_refused():
    curve = synthetic.recorded(synthetic.dmt(), 0)
    curves = js.force_curves.ForceCurves((-curve, -curve))
    with pytest.raises(
        js.exceptions.SolverError, match=r"None of 2 curves has a fit. curve 0: The approach"
    ):
        js.calibrate_each(contact(), js.FarDisplacement, curves)
    with pytest.raises(ValueError, match="There is no force curve: give at least one"):
        js.calibrate_each(contact(), js.FarDisplacement, curves[2:])
    with pytest.raises(TypeError, match="ForceCurve is no sequence"):
        js.calibrate_each(contact(), js.FarDisplacement, curve)
    with pytest.raises(TypeError, match="2 force curves: fit them by `calibrate_each`"):
        js.calibrate(contact(), js.FarDisplacement, curves)


def test_what_cannot_be_fitted_is_refused():
    curve = synthetic.recorded(synthetic.dmt(), 0)
    solid = js.FreeHalfSpace(GRID, 0.1)
    plain = js.Contact(solid, contact().heights, js.potentials.Exponential(0.05, 1.0))
    alone = replace(curve, retraction=None)
    without = {name: replace(x, tip=None) for name, x in curve.segments.items()}
    cases = [
        (TypeError, "give the class FarDisplacement or Spring", contact(), js.MeanGap, curve, {}),
        (TypeError, "The load is a FarDisplacement", contact(), js.FarDisplacement(0.1), curve, {}),
        (ValueError, "The contact has no units", plain, js.Spring, curve, {}),
        (ValueError, "has no retraction, but approach", contact(), js.Spring, alone, {}),
        (
            ValueError,
            "has no spring constant",
            contact(),
            js.Spring,
            replace(curve, **without, spring_constant=None),
            {},
        ),
        (ValueError, "reverse the forces", contact(), js.Spring, -curve, {}),
        (ValueError, "brings its own forces", contact(), js.Spring, curve, {"weights": [1.0]}),
        (ValueError, "segment is 'all'", contact(), js.Spring, curve, {"segment": "all"}),
        (ValueError, "points is 2", contact(), js.Spring, curve, {"points": 2}),
    ]
    for kind, message, one, load, measured, options in cases:
        with pytest.raises(kind, match=message):
            js.calibrate(one, load, measured, **options)
    with pytest.raises(TypeError, match="the class FarDisplacement, without its value"):
        js.calibrate(contact(), js.FarDisplacement, forces=[1.0, 2.0])
