import os
import re
import signal
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest
import xarray

import jaxstab as js
from jaxstab.__main__ import main

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
    """Two equal runs: their folder, their output, and the programs in the cache after each."""
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


def test_the_main_job_shows_a_loop_with_its_jumps_and_writes_figure_and_data(
    tmp_path, monkeypatch, capsys
):
    # Here, and not in a process of its own, where other tests have its programs.
    monkeypatch.chdir(tmp_path)
    main(SURFACE)
    said = capsys.readouterr()
    # A bar would fill a log.
    assert said.err == ""
    header, *rows = (
        line.split()
        for line in said.out.splitlines()
        if re.search(r"\b(kind|fold|release)\b", line)
    )
    assert header[:3] == ["MeanGap", "kind", "dissipation"] and len(rows) >= 2
    folder = tmp_path / "results" / "1"
    assert (folder / "loop.png").stat().st_size > 10_000
    data = xarray.load_dataset(folder / "loop.nc")
    ends = data["load"].values[[0, -1]]
    np.testing.assert_allclose([*ends, data["load"].min()], [2 + 1e-5, 2 + 1e-5, 1e-5])
    np.testing.assert_allclose(data["jump_load"], [float(row[0]) for row in rows], rtol=1e-6)
    assert list(data["jump_kind"]) == [row[1] for row in rows]
    assert data["jump_before_gap"].shape == (len(rows), 32, 32)


@pytest.mark.nightly
def test_options_reach_the_problem_and_no_result_is_overwritten(twice):
    folder, results, _ = twice
    for result, name in zip(results, ("1", "2"), strict=True):
        assert result.returncode == 0, result.stderr
        assert "youngs_modulus=2" in result.stdout and "NoAdhesion()" in result.stdout
        data = xarray.load_dataset(folder / name / "unloading.nc")
        assert data["gap"].dtype == np.float32
        assert data.attrs["load_kind"] == "MeanDisplacement"
        assert data["mean_pressure"][0] > 0


@pytest.mark.nightly
def test_a_second_run_compiles_nothing_and_is_as_quiet(twice):
    _, results, programs = twice
    assert any(name.startswith("jit__find") for name in programs[0])
    assert programs[1] == programs[0]
    for result in results:
        assert "XLA" not in result.stderr


@pytest.mark.nightly
@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_run_writes_what_it_has(tmp_path, environment):
    command = [*COMMAND, *SMALL, "--number", "2000"]
    table, rest = interrupted(command, r"\b[3-9]\d*/2000", tmp_path, environment)
    done = int(re.search(r"interrupted, (\d+) of 2000 loads", rest)[1])
    assert 3 <= done < 2000
    assert len(re.findall(r"successful$", table, re.MULTILINE)) == done
    data = xarray.load_dataset(tmp_path / "results" / "1" / "unloading.nc")
    assert data["gap"].shape == (done, 32, 32)
    assert np.isfinite(data["gap"]).all()
    assert (tmp_path / "results" / "1" / "unloading.png").exists()


@pytest.mark.nightly
@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_loop_writes_what_it_has(tmp_path, environment):
    # Small steps, so that it takes a while.
    command = [*COMMAND, *SURFACE, "--smallest-jump", "1e-12"]
    _, rest = interrupted(command, r"\b[1-9]\d*%", tmp_path, environment)
    done = int(re.search(r"interrupted, (\d+) states are done", rest)[1])
    data = xarray.load_dataset(tmp_path / "results" / "1" / "loop.nc")
    assert data["load"].size == done > 3 and data["result"] == "interrupted"
    assert (tmp_path / "results" / "1" / "loop.png").exists()


def interrupted(command, pattern, folder, environment):
    """Return what a command prints that gets Ctrl-C once its bar in a terminal has a pattern."""
    termios = pytest.importorskip("termios", reason="Windows has no pseudo-terminals")
    reader, terminal = os.openpty()
    # In a terminal without columns a bar is cut to nothing.
    termios.tcsetwinsize(terminal, (24, 120))
    table = folder / "table.txt"
    before, rest = "", ""
    with (
        table.open("w") as output,
        subprocess.Popen(
            command, cwd=folder, env=environment, stdout=output, stderr=terminal
        ) as process,
    ):
        os.close(terminal)
        # Linux ends a terminal that nobody writes to by an error.
        with suppress(OSError):
            while part := os.read(reader, 1000).decode():
                if re.search(pattern, before):
                    rest += part
                    continue
                before += part
                if re.search(pattern, before):
                    process.send_signal(signal.SIGINT)
    os.close(reader)
    assert process.returncode == 130, before
    assert "Traceback" not in rest
    return table.read_text(), rest


@pytest.mark.nightly
def test_where_every_load_fails_the_command_fails_and_still_writes(tmp_path, run):
    result = run(tmp_path, *SMALL, "--first", "-2", "--last", "-1")
    assert result.returncode == 1
    assert "every load failed" in result.stderr
    assert result.stdout.count("infeasible_load") == 5
    data = xarray.load_dataset(tmp_path / "results" / "1" / "unloading.nc")
    assert data["contact_area"].isnull().all()


@pytest.mark.parametrize(
    ("study", "number"),
    [
        pytest.param(["loop"], 3, marks=pytest.mark.nightly),
        (["unloading", "--number", "2"], 2),
    ],
)
def test_a_run_whose_figure_fails_has_saved_its_result(study, number, tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError

    monkeypatch.setattr("jaxstab.cli.run.plot_path", fail)
    monkeypatch.setattr("jaxstab.cli.run.stability_curve", fail)
    with pytest.raises(SystemExit):
        main(["run", *SURFACE, "--output", str(tmp_path), "--study", *study])
    _, found = js.load(tmp_path / "1" / f"{study[0]}.nc")
    assert len(found.load.value) >= number
