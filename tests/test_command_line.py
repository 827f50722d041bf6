import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.__main__ import main

SMALL = ["--size", "32", "--k-high", "8", "--number", "5"]


def run(folder, *arguments):
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    command = [sys.executable, "-m", "jaxstab", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_the_main_job_prints_a_table_and_writes_figure_and_data(tmp_path):
    result = run(tmp_path, *SMALL)
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    header = next(i for i, line in enumerate(lines) if "lower bound" in line)
    rows = lines[header + 2 : header + 7]
    assert " stable" in rows[0] and "held_by_contact" in rows[2] and " stable" in rows[4]
    assert "5/5" in result.stderr
    folder = tmp_path / "results" / "1"
    assert lines[-1].endswith(str(folder))
    assert (folder / "unloading.png").stat().st_size > 10_000
    data = np.load(folder / "unloading.npz")
    assert data["gap"].shape == (5, 32, 32)
    np.testing.assert_allclose(data["gap"].mean((1, 2)), data["load"])
    assert data["load_kind"] == "MeanGap"
    assert data["verdict"][0] == "stable"
    assert set(data["equilibrium_result"]) == {"successful"}
    assert (data["lower_bound_eigenvalue"] <= data["cone_eigenvalue"]).all()
    assert (data["cone_eigenvalue"] <= data["critical_eigenvalue"]).all()
    assert np.isfinite(data["barrier_height"][2])
    shown = float(rows[2].split()[1])
    assert shown == pytest.approx(data["mean_pressure"][2], rel=1e-3)


def test_options_reach_the_problem_and_no_result_is_overwritten(tmp_path):
    options = [*SMALL, "--potential", "none", "--precision", "float32", "--order", "independent"]
    options += ["--load", "displacement", "--first", "0.1", "--last", "1", "--seed", "3"]
    for expected in ("1", "2"):
        result = run(tmp_path, *options, "--output", "mine", "--youngs-modulus", "2")
        assert result.returncode == 0, result.stderr
        data = np.load(tmp_path / "mine" / expected / "unloading.npz")
        assert data["gap"].dtype == np.float32
        assert data["load_kind"] == "MeanDisplacement"
        assert data["mean_pressure"][0] > 0
    assert "E = 2" in result.stdout and "adhesion: none" in result.stdout


def test_every_option_reaches_the_problem_that_is_solved(tmp_path):
    options = {
        "size": 24,
        "seed": 3,
        "hurst": 0.6,
        "k-low": 1,
        "k-rolloff": 3,
        "k-high": 7,
        "rms-height": 0.2,
        "youngs-modulus": 0.5,
        "poisson-ratio": 0.4,
        "potential": "gaussian",
        "surface-energy": 0.03,
        "range": 0.3,
        "load": "displacement",
        "first": 0.1,
        "last": 0.9,
        "number": 3,
        "order": "independent",
        "output": tmp_path,
    }
    main([text for name, value in options.items() for text in (f"--{name}", str(value))])
    data = np.load(tmp_path / "1" / "unloading.npz")

    grid = js.Grid(24)
    heights = js.surfaces.self_affine(
        grid, jax.random.key(3), hurst=0.6, k_low=1, k_rolloff=3, k_high=7, rms_height=0.2
    )
    law = js.potentials.Gaussian(0.03, 0.3)
    contact = js.Contact(js.HalfSpace(grid, 0.5, 0.4), heights, law)
    loads = js.MeanDisplacement(jnp.linspace(0.1, 0.9, 3))
    expected = js.sweep(contact, loads)
    np.testing.assert_allclose(data["heights"], heights)
    np.testing.assert_allclose(data["gap"], expected.equilibrium.gap, atol=1e-9)
    np.testing.assert_allclose(data["pressure"], expected.equilibrium.pressure, atol=1e-7)
    cone = expected.stability.cone
    np.testing.assert_allclose(data["cone_eigenvalue"], cone.eigenvalue, rtol=1e-6)
    np.testing.assert_allclose(data["cone_error"], cone.error, rtol=1e-2)
    assert not np.allclose(data["cone_error"], data["cone_residual"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rms-height", "-1"], "-1.0: it must be positive"),
        (["--k-high", "100"], "resolves 16"),
        (["--number", "0"], "--number is 0"),
        (["--potential", "glue"], "invalid choice: 'glue'"),
    ],
)
def test_options_that_make_no_sense_end_in_one_line(tmp_path, arguments, message):
    result = run(tmp_path, *SMALL, *arguments)
    assert result.returncode != 0
    assert message in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "results").exists()
