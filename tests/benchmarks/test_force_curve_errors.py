"""Errors of fits to the synthetic force curves of the benchmark."""

import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["DMT", "Maugis", "JKR"])
def test_truths_lie_within_their_errors(kind, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    from force_curve_errors import trials

    found = [trial for seed in range(5) for trial in trials(kind, seed)]
    assert {trial.result for trial in found} == {"successful"}
    away = np.abs([trial.away for trial in found])
    assert np.nanmax(away) < 3
    assert np.mean(away[np.isfinite(away)] < 2) > 0.9
    # An error of everything would hold as well.
    assert np.median([trial.errors[0] for trial in found]) < 0.05


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [44, 94])
def test_an_attraction_between_points_is_found(seed, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    from force_curve_errors import trials

    # No point of these approaches shows the attraction.
    approach = next(trials("Maugis", seed))
    assert np.nanmax(np.abs(approach.away)) < 2
    assert approach.errors[0] < 0.1


@pytest.mark.parametrize("seed", [42, 72, 80, 84])
def test_an_attraction_that_no_point_shows_is_in_the_errors(seed, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    from force_curve_errors import trials

    # A soft cantilever jumps over it, or it lies between few points: modulus or contact point were
    # three to five of the errors of a fit without adhesion off.
    approach = next(trials("Maugis", seed))
    assert np.nanmax(np.abs(approach.away)) < 2.5
    assert approach.errors[0] < 0.5


@pytest.mark.parametrize("seed", [9, 19])
def test_errors_at_the_farthest_range_add_to_its_distance(seed, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    from force_curve_errors import trials

    # Ranges fit as well from that of JKR to one of fifteen times and more, with a work that is a
    # fifth smaller. The fit is at the long end and the truth at the short one, where the noise
    # makes an error of the work as at any range.
    _, retraction = trials("JKR", seed)
    assert retraction.result == "successful"
    assert np.nanmax(np.abs(retraction.away)) < 2
    assert retraction.errors[1] < 0.15
