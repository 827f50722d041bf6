"""Baselines, contact points and drifts of curves whose truth is known."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import synthetic_curves as synthetic

import jaxstab as js

COLUMNS = "force", "height", "tip", "time"
LAWS = {"hertz": synthetic.hertz(), "dmt": synthetic.dmt(), "jkr": synthetic.jkr()}


def deviations(law, seed, noise=0.05):
    """Return the errors of a corrected curve over their standard errors, by name."""
    random = np.random.default_rng(1000 + seed)
    contact = 5 * random.normal()
    drift, tilt = 0.3 * random.normal(), 2e-3 * random.normal()
    offsets = 0.5 * random.normal(size=2)
    curve = synthetic.recorded(
        LAWS[law], seed, contact=contact, drift=drift, tilt=tilt, offsets=offsets, noise=noise
    )
    found = curve.corrected().correction
    lines = {"approach": found.approach, "retraction": found.retraction}
    # The force of a baseline is given at the contact point that was found.
    away = tilt * (found.contact_point - contact)
    result = {
        f"force of {name}": (line.force - offset - away) / line.force_error
        for (name, line), offset in zip(lines.items(), offsets, strict=True)
    }
    result |= {f"tilt of {n}": (x.slope - tilt) / x.slope_error for n, x in lines.items()}
    result["drift"] = (found.drift - drift) / found.drift_error
    # The contact point is exact for the theory of Derjaguin, Muller and Toporov, and for Hertz'.
    if law != "jkr":
        result["contact"] = (found.contact_point - contact) / found.contact_error
    return result


@pytest.mark.nightly
@pytest.mark.parametrize("law", LAWS)
def test_the_truth_lies_within_two_errors_in_95_of_100(law):
    found = [deviations(law, seed) for seed in range(100)]
    within = {name: sum(abs(one[name]) < 2 for one in found) for name in found[0]}
    assert np.mean(list(within.values())) >= 95
    assert min(within.values()) >= 91
    # Errors are no wider than it takes.
    scatter = {name: np.std([one[name] for one in found]) for name in found[0]}
    assert min(scatter.values()) > 0.5, scatter


def test_corrected_forces_and_heights_are_those_of_the_law():
    indentation, force = LAWS["hertz"]
    curve = synthetic.recorded(LAWS["hertz"], 0, noise=0.01).corrected()
    for segment in (curve.approach, curve.retraction):
        pressing = (segment.force > 5) & (segment.force < 60)
        expected = np.interp(segment.force[pressing], force, indentation)
        # The noise of the deflection, 0.01 nN / (0.5 N/m).
        assert np.std(segment.tip_position[pressing] + expected) < 0.025
        assert abs(np.mean(segment.tip_position[pressing] + expected)) < 0.02
        assert np.std(segment.force[segment.height > 1]) < 0.011
        deflection = segment.tip_position - segment.height
        np.testing.assert_allclose(deflection * curve.spring_constant, segment.force, atol=1e-9)
    assert "contact point" in repr(curve)
    assert "nm/s" in repr(curve)


def other_law(name):
    """Return a law of another tip, or with a long repulsion."""
    indentation, force = synthetic.hertz()
    before = np.linspace(-60, 0, 2000)[:-1]
    tail = np.append(np.exp(before / 8), np.ones_like(force))
    return {
        "cone": (indentation, indentation**2),
        "punch": (indentation, 8 * indentation),
        "tail": (np.append(before, indentation), np.append(0 * before, force) + 3 * tail),
    }[name]


@pytest.mark.parametrize("name", ["cone", "punch", "tail"])
@pytest.mark.parametrize("constant", [0.5, 5.0])
def test_the_error_of_the_contact_point_holds_for_other_tips_and_a_long_repulsion(name, constant):
    for seed in range(3):
        curve = synthetic.recorded(other_law(name), seed, constant=constant, drift=0.0).corrected()
        away = abs(curve.correction.contact_point - 3)
        assert 0.1 < away < 2 * curve.correction.contact_error < 6 * away


def test_hysteresis_of_the_sample_is_not_removed_as_a_drift():
    curve = synthetic.recorded(LAWS["hertz"], 0, drift=5.0).corrected()
    assert curve.correction.drift == pytest.approx(5, abs=2 * curve.correction.drift_error)
    assert "drift left" in curve.remarks[-1]
    tips = [
        np.interp(5, np.sort(segment.force), np.sort(segment.tip_position)[::-1])
        for segment in (curve.approach, curve.retraction)
    ]
    assert tips[1] - tips[0] > 0.5


def timed(curve, change):
    """Return a curve with other times: of each segment, from its name and its times."""
    changed = {
        name: replace(segment, time=change(name, segment.time))
        for name, segment in curve.segments.items()
    }
    return replace(curve, **changed)


def missing_beside(time):
    time = time.copy()
    time[[0, 7, -1]] = np.nan
    return time


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda name, time: time[::-1], "times of the approach fall, first from"),
        (lambda name, time: 0 * time, "times of the approach are all 0 s"),
        (lambda name, time: time - time[0], "retraction begins at 0 s, before the approach ends"),
        (lambda name, time: missing_beside(time), "approach has points without a finite time"),
        (lambda name, time: np.append(time[:-1], np.inf), "approach has points without a finite"),
        (lambda name, time: np.where(name == "retraction", 9.0, time), "retraction are all 9 s"),
    ],
)
def test_times_that_are_no_clock_are_refused(change, message):
    curve = synthetic.recorded(LAWS["hertz"], 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bad = timed(curve, change)
        repr(bad)
        with pytest.raises(ValueError, match=message):
            bad.corrected()
    # The cure that the message names.
    assert timed(bad, lambda *_: None).corrected().correction.drift is not None


def test_points_that_are_missing_may_lack_a_time():
    curve = synthetic.recorded(LAWS["hertz"], 2)
    expected = curve.corrected().correction
    approach = curve.approach
    force = np.where(np.isnan(missing_beside(approach.time)), np.nan, approach.force)
    holed = replace(approach, force=force, time=missing_beside(approach.time))
    found = replace(curve, approach=holed).corrected().correction
    assert found.drift == pytest.approx(expected.drift, abs=expected.drift_error)
    assert holed.speed == pytest.approx(approach.speed, rel=1e-3)


def with_forces(curve, change):
    """Return a curve with changed forces."""
    changed = {}
    for name, segment in curve.segments.items():
        force = change(segment.force)
        tip = segment.height + force / curve.spring_constant
        changed[name] = replace(segment, force=force, tip=tip)
    return replace(curve, **changed)


@pytest.mark.parametrize(("least", "most"), [(-1e9, 20.0), (-2.0, 1e9), (-2.0, 20.0)])
def test_forces_at_the_end_of_the_range_of_the_detector_are_left_out(least, most):
    curve = synthetic.recorded(synthetic.jkr(4.0), 0)
    clipped = with_forces(curve, lambda force: np.clip(force, least, most))
    assert "end of the range of the detector" in clipped.suspicions[-1]
    assert not curve.suspicions
    corrected = clipped.corrected()
    assert "points left out, whose forces are at the end of the range" in corrected.remarks[0]
    is_out = (curve.retraction.force > most) | (curve.retraction.force < least)
    np.testing.assert_array_equal(corrected.retraction.is_present, ~is_out)
    whole = curve.corrected().retraction.force
    np.testing.assert_allclose(corrected.retraction.force[~is_out], whole[~is_out], atol=0.05)


@pytest.mark.parametrize("step", [0.1, 1.0, 4.0])
def test_digitised_forces_are_not_clipped_and_have_a_noise(step):
    exact = synthetic.recorded(LAWS["hertz"], 0, noise=0.0, tilt=0.0, offsets=(0.0, 0.0), drift=0.0)
    for curve in (exact, with_forces(exact, lambda force: step * np.round(force / step))):
        assert not curve.suspicions
        assert curve.corrected().correction.approach.noise > 0
    assert curve.corrected().correction.approach.noise >= step / 12**0.5 * 0.99


def test_units_change_nothing_but_numbers():
    curve = synthetic.recorded(LAWS["dmt"], 3)
    one = curve.corrected().in_units("m", "N").correction
    two = curve.in_units("m", "N").corrected().correction
    for name in ("contact_point", "contact_error", "drift", "drift_error"):
        assert getattr(one, name) == pytest.approx(getattr(two, name), rel=1e-6)
    for line, other in ((one.approach, two.approach), (one.retraction, two.retraction)):
        for name in ("force", "force_error", "slope", "slope_error", "noise"):
            assert getattr(line, name) == pytest.approx(getattr(other, name), rel=1e-6)


def test_correlated_noise_makes_larger_errors():
    curve = synthetic.recorded(LAWS["hertz"], 0, noise=0.0)
    random = np.random.default_rng(0)
    white = 0.05 * random.normal(size=2000)
    slow = np.convolve(0.05 * random.normal(size=2029), np.ones(30) / 30**0.5, "valid")
    errors = []
    for noise in (white, slow):
        approach = replace(curve.approach, force=curve.approach.force + noise)
        noisy = replace(curve, approach=approach, retraction=None)
        errors.append(noisy.corrected().correction.approach.force_error)
    assert 3 < errors[1] / errors[0] < 8


def test_missing_points_are_left_out_and_stay_missing():
    curve = synthetic.recorded(LAWS["hertz"], 1)
    force = curve.approach.force.copy()
    force[100:130] = np.nan
    holed = replace(curve, approach=replace(curve.approach, force=force)).corrected()
    assert holed.approach.num_missing == 30
    expected = curve.corrected().correction
    error = 2 * expected.contact_error
    assert holed.correction.contact_point == pytest.approx(expected.contact_point, abs=error)


@pytest.mark.parametrize("part", ["approach", "retraction"])
def test_a_single_segment_is_corrected(part):
    curve = synthetic.recorded(LAWS["dmt"], 2, parts=(part,), drift=0.0).corrected()
    assert curve.correction.drift is None
    assert abs(curve.correction.contact_point - 3) < 3 * curve.correction.contact_error
    missing = {"approach": "retraction", "retraction": "approach"}[part]
    assert getattr(curve, missing) is None


def test_without_a_spring_constant_the_baseline_alone_is_removed():
    curve = synthetic.recorded(LAWS["hertz"], 2)
    segments = {name: replace(x, tip=None) for name, x in curve.segments.items()}
    curve = replace(curve, **segments, spring_constant=None)
    corrected = curve.corrected()
    assert corrected.correction.contact_point is None
    assert "contact point unknown" in corrected.remarks[-1]
    assert abs(corrected.approach.force[:500].mean()) < 0.01
    np.testing.assert_array_equal(corrected.approach.height, curve.approach.height)


def test_a_segment_made_by_hand_without_a_tip_says_what_it_lacks():
    height = np.linspace(2.0, -1.0, 8)
    approach = js.lab.force_curves.Segment(np.maximum(-height, 0), height)
    curve = js.lab.force_curves.ForceCurve(approach, None, spring_constant=0.5)
    with pytest.raises(ValueError, match=r"Segment\(force, height, tip="):
        _ = curve.approach.tip_position


def test_a_constant_baseline_has_no_tilt():
    curve = synthetic.recorded(LAWS["hertz"], 2, tilt=0.0).corrected("constant")
    assert curve.correction.approach.slope == 0 == curve.correction.approach.slope_error
    assert abs(curve.correction.approach.force - 0.3) < 3 * curve.correction.approach.force_error
    with pytest.raises(ValueError, match="baseline is 'quadratic'"):
        curve.corrected("quadratic")


def test_curves_that_cannot_be_corrected_say_why():
    curve = synthetic.recorded(LAWS["hertz"], 2)
    with pytest.raises(ValueError, match=r"reverse the forces by `-curve`"):
        (-curve).corrected()
    assert (-curve.corrected()).correction is None
    flat = replace(curve.approach, force=0 * curve.approach.force + 0.05)
    with pytest.raises(ValueError, match="no contact"):
        replace(curve, approach=flat).corrected()
    short = {name: curve.approach.__dict__[name][::50] for name in ("force", "height", "tip")}
    with pytest.raises(ValueError, match="40 points: a baseline needs 50"):
        replace(curve, approach=js.lab.force_curves.Segment(**short)).corrected()


def test_of_several_curves_the_good_ones_are_corrected_and_the_bad_ones_named():
    good = synthetic.recorded(LAWS["hertz"], 2, points=400)
    short = replace(good.approach, **{n: getattr(good.approach, n)[::10] for n in COLUMNS})
    bad = [replace(-good, source="second"), replace(good, approach=short, source="third")]
    curves = js.lab.force_curves.ForceCurves((good, *bad, good))
    message = r"2 of 4 curves are not corrected. second: The approach pulls.* third: .*40 points"
    with pytest.warns(js.lab.force_curves.ForceCurveWarning, match=message):
        corrected = curves.corrected()
    assert [curve.correction is None for curve in corrected] == [False, True, True, False]
    np.testing.assert_array_equal(corrected[1].approach.force, bad[0].approach.force)
    assert corrected[2].remarks[-1].startswith("not corrected: The approach has 40 points")
    assert "2 of 4 curves: not corrected" in repr(corrected)
    alone = good.corrected().correction
    assert corrected[3].correction.contact_point == alone.contact_point
    with pytest.raises(
        ValueError, match=r"None of 2 curves can be corrected. second: The approach"
    ):
        js.lab.force_curves.ForceCurves(tuple(bad)).corrected()
    with pytest.raises(ValueError, match="baseline is 'quadratic'"):
        curves.corrected("quadratic")


def cut(segment, is_kept):
    return js.lab.force_curves.Segment(
        **{name: getattr(segment, name)[is_kept] for name in COLUMNS}
    )


def test_a_retraction_that_does_not_detach_is_corrected_by_the_approach():
    curve = synthetic.recorded(LAWS["hertz"], 2, offsets=(0.3, 0.3))
    near = curve.retraction.height < 3
    curve = replace(curve, retraction=cut(curve.retraction, near)).corrected()
    assert "retraction not detached" in curve.remarks[0]
    assert curve.correction.retraction == curve.correction.approach


@pytest.mark.parametrize(
    ("law", "constant", "end"),
    [
        # With a stiff cantilever the force is flat where it is least.
        (synthetic.jkr(4.0), 50.0, -4.71),
        (synthetic.jkr(), 5.0, -4.6),
        (synthetic.maugis(1.0), 50.0, -4.9),
        (synthetic.maugis(0.2), 50.0, -5.8),
        (synthetic.dmt(), 0.5, -4.0),
    ],
)
@pytest.mark.parametrize("noise", [0.005, 0.05])
def test_a_retraction_that_ends_while_it_adheres_keeps_its_attraction(law, constant, end, noise):
    options = {"constant": constant, "reach": 60.0, "offsets": (0.3, 0.3), "drift": 0.0}
    exact = synthetic.recorded(law, 0, noise=0.0, tilt=0.0, **options).retraction.force - 0.3
    curve = synthetic.recorded(law, 0, noise=noise, **options)
    last = np.flatnonzero(exact < end)[0]
    kept = np.arange(len(exact)) < last
    corrected = replace(curve, retraction=cut(curve.retraction, kept)).corrected()
    assert "retraction not detached" in corrected.remarks[0]
    misfit = corrected.retraction.force - exact[kept]
    assert abs(misfit[-20:].mean()) < 0.02 + noise
    alone = replace(curve, approach=None, retraction=cut(curve.retraction, kept))
    try:
        assert "a tip that still adheres" in alone.corrected().remarks[0]
    except ValueError as error:
        assert "no baseline" in str(error)


@pytest.mark.parametrize("force_drift", [3.0, -3.0, 0.6])
@pytest.mark.parametrize("law", ["hertz", "jkr"])
def test_a_drift_of_the_force_is_removed_from_a_retraction_that_has_detached(law, force_drift):
    exact = synthetic.recorded(LAWS[law], 4, noise=0.0, tilt=0.0, offsets=(0.0, 0.0), drift=0.0)
    curve = synthetic.recorded(LAWS[law], 4, force_drift=force_drift, drift=0.0).corrected()
    slopes = curve.correction.approach.slope, curve.correction.retraction.slope
    # The cantilever moves at 100 nm/s.
    assert slopes[1] - slopes[0] == pytest.approx(force_drift / 50, abs=1e-3)
    assert not any("detached" in remark for remark in curve.remarks)
    for name, segment in exact.segments.items():
        misfit = curve.segments[name].force - segment.force
        error = 3 * getattr(curve.correction, name).force_error
        assert np.std(misfit) < 0.06 and abs(np.mean(misfit[segment.force > 1])) < error


def test_a_segment_that_begins_in_contact_has_no_baseline():
    curve = synthetic.recorded(LAWS["hertz"], 2)
    for name, segment in curve.segments.items():
        only = dict.fromkeys(curve.segments) | {name: cut(segment, segment.height < -2)}
        with pytest.raises(ValueError, match=f"The {name} has no baseline or no contact"):
            replace(curve, **only).corrected()


def test_a_curve_without_points_or_segments_says_so():
    curve = synthetic.recorded(LAWS["hertz"], 2, points=400)
    with pytest.raises(ValueError, match="segment has no point: leave it out"):
        replace(curve.approach, **{name: np.zeros(0) for name in COLUMNS})
    lost = replace(curve.approach, force=np.full(400, np.nan))
    assert "400 points, all of them missing" in repr(replace(curve, approach=lost))
    pause = replace(curve, approach=None, retraction=None, pauses=(curve.approach,))
    with pytest.raises(ValueError, match="neither an approach nor a retraction"):
        pause.corrected()


def test_no_curves_have_no_data_set_and_make_a_map_of_holes():
    none = js.lab.force_curves.ForceCurves((), (2, 1))
    assert len(none.corrected()) == 0 and "2 of 2 pixels missing" in repr(none)
    np.testing.assert_array_equal(none.on_map([]), np.full((2, 1), np.nan))
    with pytest.raises(ValueError, match="There is no force curve"):
        none.to_dataset()
