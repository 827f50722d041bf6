import os
import re
import signal
import subprocess
import sys
from subprocess import PIPE

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.__main__ import _keep_programs, main

SURFACE = ["--size", "32", "--k-high", "8"]
SMALL = [*SURFACE, "--study", "unloading", "--number", "5"]


COMMAND = [sys.executable, "-m", "jaxstab"]


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """The user's cache folder."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def environment(cache):
    return {**os.environ, "XDG_CACHE_HOME": str(cache)}


@pytest.fixture(scope="module")
def run(environment):
    def run(folder, *arguments, environment=environment):
        return subprocess.run(
            [*COMMAND, *arguments], cwd=folder, env=environment, capture_output=True, text=True
        )

    return run


@pytest.fixture(scope="module")
def twice(run, cache, environment, tmp_path_factory):
    """Two runs alike: their folder, what they said, and the programs in the cache after each."""
    folder = tmp_path_factory.mktemp("twice")
    options = [*SMALL, "--potential", "none", "--precision", "float32", "--order", "independent"]
    options += ["--load", "displacement", "--first", "0.1", "--last", "1", "--seed", "3"]
    options += ["--output", "mine", "--youngs-modulus", "2"]
    environment = {k: v for k, v in environment.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    results, programs = [], []
    for _ in range(2):
        results.append(run(folder, *options, environment=environment))
        programs.append({file.name for file in cache.rglob("*-cache")})
    return folder / "mine", results, programs


def test_the_main_job_shows_a_loop_with_its_jumps_and_writes_figure_and_data(tmp_path, run):
    result = run(tmp_path, *SURFACE)
    assert result.returncode == 0, result.stderr
    assert "100%" in result.stderr
    header, *rows = (
        line.split()
        for line in result.stdout.splitlines()
        if re.search(r"\b(kind|fold|release)\b", line)
    )
    assert header[:3] == ["MeanGap", "kind", "dissipation"] and len(rows) >= 2
    folder = tmp_path / "results" / "1"
    assert (folder / "loop.png").stat().st_size > 10_000
    data = np.load(folder / "loop.npz")
    assert data["load"][0] == data["load"][-1] == 2 + 1e-5 and data["load"].min() == 1e-5
    np.testing.assert_allclose(data["jump_load"], [float(row[0]) for row in rows], rtol=1e-6)
    assert list(data["jump_kind"]) == [row[1] for row in rows]
    assert data["jump_gap_before"].shape == (len(rows), 32, 32)
    np.testing.assert_allclose(data["work"][-1], data["dissipation"][-1])


def test_the_unloading_study_prints_a_table_and_writes_figure_and_data(tmp_path, run):
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


def test_options_reach_the_problem_and_no_result_is_overwritten(twice):
    folder, results, _ = twice
    for result, name in zip(results, ("1", "2"), strict=True):
        assert result.returncode == 0, result.stderr
        assert "E = 2" in result.stdout and "adhesion: none" in result.stdout
        data = np.load(folder / name / "unloading.npz")
        assert data["gap"].dtype == np.float32
        assert data["load_kind"] == "MeanDisplacement"
        assert data["mean_pressure"][0] > 0


def test_a_second_run_compiles_nothing_and_is_as_quiet(twice):
    _, results, programs = twice
    assert any(name.startswith("jit__find_in_own_units") for name in programs[0])
    assert programs[1] == programs[0]
    for result in results:
        assert "XLA" not in result.stderr


def test_every_option_reaches_the_problem_that_is_solved(tmp_path):
    options = {
        "study": "unloading",
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


@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_run_writes_what_it_has(tmp_path, environment):
    command = [*COMMAND, *SMALL, "--number", "2000"]
    with subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=PIPE, stderr=PIPE, text=True
    ) as process:
        said = ""
        while not re.search(r"\b[3-9]\d*/2000", said):
            said += (character := process.stderr.read(1))
            assert character, said
        process.send_signal(signal.SIGINT)
        table, rest = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in rest
    done = int(re.search(r"interrupted, (\d+) of 2000 loads", rest)[1])
    assert 3 <= done < 2000
    assert len(re.findall(r"successful$", table, re.MULTILINE)) == done
    data = np.load(tmp_path / "results" / "1" / "unloading.npz")
    assert data["gap"].shape == (done, 32, 32)
    assert np.isfinite(data["gap"]).all()
    assert (tmp_path / "results" / "1" / "unloading.png").exists()


def test_where_every_load_fails_the_command_fails_and_still_writes(tmp_path, run):
    result = run(tmp_path, *SMALL, "--first", "-2", "--last", "-1")
    assert result.returncode == 1
    assert "every load failed" in result.stderr
    assert result.stdout.count("infeasible_load") == 5
    assert np.isnan(np.load(tmp_path / "results" / "1" / "unloading.npz")["contact_area"]).all()


def test_a_cache_folder_that_cannot_be_made_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    before = jax.config.values["jax_compilation_cache_dir"]
    _keep_programs()
    assert jax.config.values["jax_compilation_cache_dir"] == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rms-height", "-1"], "-1.0: it must be positive"),
        (["--k-high", "100"], "resolves 16"),
        (["--number", "0"], "--number: '0' is not a whole number of at least 1."),
        (["--number", "2.5"], "--number: '2.5' is not a whole number of at least 1."),
        (["--seed", "-1"], "--seed: '-1' is not a whole number from 0 to 4294967295."),
        (["--seed", "4294967296"], "--seed: '4294967296' is not a whole number from 0"),
        (["--potential", "glue"], "invalid choice: 'glue'"),
    ],
)
def test_options_that_make_no_sense_end_in_one_sentence(tmp_path, capsys, arguments, message):
    with pytest.raises(SystemExit) as refused:
        main([*SMALL, "--output", str(tmp_path / "results"), *arguments])
    assert message in f"{refused.value} {capsys.readouterr().err}"
    assert not (tmp_path / "results").exists()
