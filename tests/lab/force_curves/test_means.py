"""Means over the points of force curves, and a fit of a contact to them."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import synthetic_curves as synthetic

import jaxstab as js

means = js.lab.force_curves.means


def contact(work, length, modulus):
    grid = js.Grid(8, (48.0, 48.0))
    solid, law = js.FreeHalfSpace(grid, modulus), js.potentials.Exponential(work, length)
    tip = js.surfaces.paraboloid(grid, 20.0)
    return js.Contact(solid, tip, law, unit="nm", pressure_unit="GPa")


def flat_curve(seed, law, **options):
    """A curve whose zeros are known, with a correction that leaves it as it is."""
    known = {"contact": 0.0, "drift": 0.0, "tilt": 0.0, "offsets": (0.0, 0.0)}
    curve = synthetic.recorded(law, seed, **known, **options)
    return replace(curve.corrected(), **curve.segments)


@pytest.mark.parametrize("segment", ["approach", "retraction"])
@pytest.mark.parametrize("tabor", [0.3, 5.0])
def test_means_lie_on_the_law_within_their_errors_beside_jumps_too(segment, tabor):
    law = synthetic.maugis_with_approach(tabor)
    deviations = []
    for seed in range(10):
        curve = flat_curve(seed, law, constant=5.0)
        part = means(curve, segment, 60)
        assert part.weights.max() == 1 and part.drift_error.shape == part.force.shape
        # Heights go down to the sample, and up from it.
        assert (np.diff(part.height) < 0).all() == (segment == "approach")
        indentation, force = law
        inside = indentation >= 0
        exact = np.interp(-part.tip_position, indentation[inside], force[inside])
        is_deep = part.tip_position < -0.5
        sizes = part.weights * len(curve.segments[segment]) / part.weights.sum()
        deviations.append(((part.force - exact) * np.sqrt(sizes) / 0.05)[is_deep])
    # The slope of the force over the tip position makes its own errors.
    assert np.sqrt(np.mean(np.concatenate(deviations) ** 2)) < 4
    jumps = np.abs(np.diff(curve.segments[segment].tip_position)) > 1
    if jumps.any():
        low, high = (curve.segments[segment].tip_position[np.argmax(jumps) + i] for i in (0, 1))
        assert not (
            (part.tip_position > min(low, high) + 0.3) & (part.tip_position < max(low, high) - 0.3)
        ).any()


def test_means_have_the_units_of_the_curve_and_leave_out_missing_points():
    curve = synthetic.recorded(synthetic.dmt(), 0).corrected()
    force = curve.approach.force.copy()
    force[1500:1503] = np.nan
    curve = replace(curve, approach=replace(curve.approach, force=force))
    one, two = means(curve, "approach"), means(curve.in_units("µm", "pN"), "approach")
    assert np.isfinite(one.force).all()
    np.testing.assert_allclose(two.tip_position, 1e-3 * one.tip_position, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(two.force, 1e3 * one.force, rtol=1e-6, atol=1e-9)
    # The drift moves the far end, in the approach, by its error times the time to the turn.
    span = np.ptp(curve.approach.time) * curve.correction.drift_error
    assert -one.drift_error[0] == pytest.approx(span, rel=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"segment": "both"}, "'both': choose"),
        ({"points": 2}, "points is 2"),
        ({"curve": np.ones(3)}, "The curve is a ndarray"),
        ({"curve": synthetic.recorded(synthetic.dmt(), 0, parts=("approach",))}, "no retraction"),
    ],
)
def test_impossible_means_are_refused(change, message):
    with pytest.raises((TypeError, ValueError), match=message):
        means(**({"curve": synthetic.recorded(synthetic.dmt(), 0)} | change))


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::jaxstab.exceptions.WindowWarning")
def test_a_contact_on_a_grid_is_fitted_to_means_of_a_retraction():
    truth = np.array([0.05, 6.0, 0.1])
    indentation = np.linspace(8.0, -46.0, 91)
    states = js.sweep(
        contact(*truth), js.FarDisplacement(-indentation), order="continuation", stability=False
    )
    law = indentation[::-1], np.asarray(states.equilibrium.force)[::-1]
    curve = synthetic.recorded(
        law, 0, noise=0.2, constant=1.0, reach=60.0, speed=50.0, contact=1.0, drift=0.0
    )
    part = means(curve, points=20)
    fit = js.calibrate(
        contact(0.06, 5.0, 0.12),
        js.FarDisplacement(part.tip_position),
        forces=part.force,
        weights=part.weights,
        load_error=part.drift_error,
        offset=True,
        baseline="linear",
    )
    found, errors = (np.array(jax.tree.leaves(x)) for x in (fit.parameters, fit.standard_errors))
    assert (abs(found - truth) < 3 * errors).all() and (errors < 0.1 * truth).all()
    assert fit.names[3:] == ("offset", "baseline", "tilt")
    rows = {line.split()[0]: line.split() for line in str(fit).splitlines()[3:]}
    assert [rows[name][-1] for name in fit.names] == ["J/m²", "nm", "GPa", "nm", "nN", "N/m"]
