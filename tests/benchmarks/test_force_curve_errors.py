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
