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
import xarray

import jaxstab as js
from jaxstab.__main__ import main
from jaxstab.cli import problem
from jaxstab.cli import run as run_command
from jaxstab.cli.parsing import Parser

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
    data = xarray.load_dataset(folder / "loop.nc")
    ends = data["load"].values[[0, -1]]
    np.testing.assert_allclose([*ends, data["load"].min()], [2 + 1e-5, 2 + 1e-5, 1e-5])
    np.testing.assert_allclose(data["jump_load"], [float(row[0]) for row in rows], rtol=1e-6)
    assert list(data["jump_kind"]) == [row[1] for row in rows]
    assert data["jump_before_gap"].shape == (len(rows), 32, 32)
    np.testing.assert_allclose(data["total_work"], data["total_dissipation"])


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
    data = xarray.load_dataset(folder / "unloading.nc")
    assert data["gap"].shape == (5, 32, 32)
    np.testing.assert_allclose(data["gap"].mean(("x", "y")), data["load"])
    assert data.attrs["load_kind"] == "MeanGap"
    assert data["verdict"][0] == "stable"
    assert set(data["result"].values) == {"successful"}
    assert (data["lower_bound_eigenvalue"] <= data["cone_eigenvalue"]).all()
    assert (data["cone_eigenvalue"] <= data["critical_eigenvalue"]).all()
    assert np.isfinite(data["barrier_height"][2])
    shown = float(rows[2].split()[1])
    assert shown == pytest.approx(float(data["mean_pressure"][2]), rel=1e-3)


def test_options_reach_the_problem_and_no_result_is_overwritten(twice):
    folder, results, _ = twice
    for result, name in zip(results, ("1", "2"), strict=True):
        assert result.returncode == 0, result.stderr
        assert "E = 2" in result.stdout and "adhesion: none" in result.stdout
        data = xarray.load_dataset(folder / name / "unloading.nc")
        assert data["gap"].dtype == np.float32
        assert data.attrs["load_kind"] == "MeanDisplacement"
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
    data = xarray.load_dataset(tmp_path / "1" / "unloading.nc")

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
    table, rest = interrupted(command, r"\b[3-9]\d*/2000", tmp_path, environment)
    done = int(re.search(r"interrupted, (\d+) of 2000 loads", rest)[1])
    assert 3 <= done < 2000
    assert len(re.findall(r"successful$", table, re.MULTILINE)) == done
    data = xarray.load_dataset(tmp_path / "results" / "1" / "unloading.nc")
    assert data["gap"].shape == (done, 32, 32)
    assert np.isfinite(data["gap"]).all()
    assert (tmp_path / "results" / "1" / "unloading.png").exists()


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
    """Return what a command prints that gets Ctrl-C once its standard error has a pattern."""
    with subprocess.Popen(
        command, cwd=folder, env=environment, stdout=PIPE, stderr=PIPE, text=True
    ) as process:
        said = ""
        while not re.search(pattern, said):
            said += (character := process.stderr.read(1))
            assert character, said
        process.send_signal(signal.SIGINT)
        table, rest = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in rest
    return table, rest


def test_where_every_load_fails_the_command_fails_and_still_writes(tmp_path, run):
    result = run(tmp_path, *SMALL, "--first", "-2", "--last", "-1")
    assert result.returncode == 1
    assert "every load failed" in result.stderr
    assert result.stdout.count("infeasible_load") == 5
    data = xarray.load_dataset(tmp_path / "results" / "1" / "unloading.nc")
    assert data["contact_area"].isnull().all()


@pytest.fixture
def scan(tmp_path):
    """A tilted scan with a hole, of 16 x 12 points."""
    heights = np.array(js.surfaces.sinusoid(js.Grid((16, 12)), 0.1, waves=(2, 1)))
    heights += 3 * np.linspace(0, 1, 16)[:, None]
    heights[4, 5] = np.nan
    np.savetxt(tmp_path / "scan.txt", heights)
    return tmp_path / "scan.txt"


MATERIAL = ["--youngs-modulus", "2", "--surface-energy", "0.02", "--range", "0.2"]


def test_a_measured_surface_every_law_and_load_reach_the_problem(scan, tmp_path, capsys):
    options = ["--surface", str(scan), "--lengths", "2", "1.5", "--unit", "um", *MATERIAL]
    options += ["--load", "spring", "--stiffness", "3", "--first", "0.1", "--last", "0.4"]
    options += ["--potential", "dugdale", "--smoothing", "0.3", "--periodic", "as_is"]
    options += ["--study", "unloading", "--number", "2", "--output", str(tmp_path / "out")]
    main(options)
    said = capsys.readouterr()
    assert "0.521 % of the points were missing and have been filled." in said.err
    assert "scan.txt, 2 x 1.5 µm, 16 x 12 points" in said.out
    contact, sweep = js.load(tmp_path / "out" / "1" / "unloading.nc")
    lines = [f'surface = "{scan}"', "lengths = [2, 1.5]", 'unit = "um"', 'study = "unloading"']
    rest = options[7:-6]
    lines += [f'{rest[i][2:]} = "{rest[i + 1]}"' for i in range(0, len(rest), 2)]
    (tmp_path / "study.toml").write_text("\n".join(lines))
    numbers = ["--number", "2", "--output", str(tmp_path / "out")]
    main(["--config", str(tmp_path / "study.toml"), *numbers])
    files = [tmp_path / "out" / name / "unloading.nc" for name in "12"]
    xarray.testing.assert_identical(*map(xarray.load_dataset, files))
    topography = js.surfaces.read(scan, (2.0, 1.5), "um").filled().detrended()
    np.testing.assert_array_equal(contact.heights, topography.heights)
    np.testing.assert_allclose(contact.grid.lengths, [2, 1.5])
    assert contact.unit == "µm"
    law = contact.potential
    assert isinstance(law, js.potentials.Dugdale) and float(law.smoothing) == 0.3
    assert isinstance(sweep.load, js.Spring) and (sweep.load.stiffness == 3).all()
    np.testing.assert_allclose(sweep.load.value, [0.1, 0.4])


def test_a_configuration_does_what_options_do_and_they_go_before_it(tmp_path, capsys):
    config = tmp_path / "study.toml"
    config.write_text(
        'study = "unloading"\nnumber = 3\nfirst = -1e-3\n[surface]\nsize = 16\nk_high = 4\n'
    )
    output = ["--output", str(tmp_path / "out")]
    main(["--config", str(config), *output])
    options = ["--study", "unloading", "--number", "3", "--first=-1e-3", "--size", "16"]
    main([*options, "--k-high", "4", *output])
    main(["run", "--config", str(config), *output, "--number", "2"])
    first, second, third = (
        xarray.load_dataset(tmp_path / "out" / str(i) / "unloading.nc") for i in (1, 2, 3)
    )
    xarray.testing.assert_identical(first, second)
    assert third["load"].size == 2 and third["load"][0] == first["load"][0] == -1e-3


def test_a_surface_and_a_result_say_what_they_are_and_a_result_is_drawn(scan, tmp_path, capsys):
    main(["info", str(scan), "--lengths", "2", "1.5", "--unit", "um"])
    said = capsys.readouterr().out
    assert "16 x 12" in said and "µm" in said and "missing" in said
    grid = js.Grid(16)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.1)
    contact = js.Contact(js.HalfSpace(grid, 0.05), heights, js.potentials.Exponential(0.01, 0.2))
    sweep = js.sweep(contact, js.MeanGap(jnp.array([0.1, 0.2])))
    path = js.save(tmp_path / "run.nc", contact, sweep)
    with pytest.raises(SystemExit):
        main(["info", str(path), "--unit", "um"])
    assert "which has its own lengths and unit: leave out" in capsys.readouterr().err
    main(["info", str(path)])
    said = capsys.readouterr().out
    assert said.startswith("Sweep of an adhesive contact") and str(sweep) in said
    for options in ([], [], ["--state", "1"], ["--output", str(tmp_path / "a.pdf")]):
        main(["plot", str(path), *options])
        file = capsys.readouterr().out.strip()
        assert os.path.getsize(file) > 10_000
    figures = sorted(file.name for file in tmp_path.iterdir() if file.suffix in (".png", ".pdf"))
    assert figures == ["a.pdf", "run-2.png", "run-3.png", "run.png"]
    scalars = js.save(tmp_path / "scalars.nc", contact, sweep, fields=False)
    main(["info", str(scalars)])
    assert "HalfSpace" in capsys.readouterr().out


def test_what_to_cite_is_said(capsys):
    main(["cite", "PolonskyKeerRey", "--bibtex"])
    assert "@article" in capsys.readouterr().out
    main(["cite"])
    assert "Bleyer" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rms-height", "-1"], "-1.0: it must be positive"),
        (["--k-high", "100"], "resolves 16"),
        (["--hurst", "2"], "The Hurst exponent is 2"),
        (["--youngs-modulus", "0"], "Young's modulus is 0"),
        (["--poisson-ratio", "0.7"], "Poisson's ratio is 0.7"),
        (["--range", "-1"], "The length of the potential is -1"),
        (["--number", "0"], "--number: '0' is not a whole number of at least 1."),
        (["--number", "2.5"], "--number: '2.5' is not a whole number of at least 1."),
        (["--seed", "-1"], "--seed: '-1' is not a whole number from 0 to 4294967295."),
        (["--seed", "4294967296"], "--seed: '4294967296' is not a whole number from 0"),
        (["--size", "1"], "--size: '1' is not a whole number of at least 2."),
        (["--range", "wide"], "--range: 'wide' is not a finite number."),
        (["--first", "-1e-3", "--last", "wide"], "--last: 'wide' is not a finite number."),
        (["--range", "inf"], "--range: 'inf' is not a finite number."),
        (["--potential", "glue"], "invalid choice: 'glue'"),
        (["--load", "force"], "invalid choice: 'force'"),
        (["--load", "spring"], "--stiffness belongs to --load spring, which needs it."),
        (["--stiffness", "2"], "--stiffness belongs to --load spring"),
        (["--load", "pressure", "--first", "0"], "--last is needed with --load pressure."),
        (["--smoothing", "0.2"], "--smoothing belongs to --potential dugdale."),
        (["--potential", "none", "--range", "1"], "--range belongs to a law, not to --potential"),
        (["--smallest-jump", "1e-3"], "--smallest-jump belongs to --study loop."),
        (["--study", "loop"], "--number belongs to --study unloading."),
        (["--lengths", "2"], "--lengths belongs to --surface."),
        (["--surface", "scan.txt"], "--size describes a generated surface"),
        (["--colour", "red"], "unrecognized arguments: --colour red"),
        (["--siz", "8"], "unrecognized arguments: --siz 8"),
        (["--size"], "--size: expected one argument"),
        (["--config", "none.toml"], "none.toml: No such file"),
    ],
)
def test_options_that_make_no_sense_end_in_one_line(tmp_path, capsys, arguments, message):
    assert_refused([*SMALL, "--output", str(tmp_path / "results"), *arguments], message, capsys)
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["walk"], "unrecognized arguments: walk"),
        (["info"], "the following arguments are required: FILE"),
        (["info", "none.x3p"], "none.x3p"),
        (["info", "empty.txt"], "empty.txt"),
        (["plot", "none.nc"], "There is no file none.nc."),
        (["plot", "empty.txt"], "empty.txt is no readable NetCDF file"),
        (["cite", "gravity"], "There is no gravity in jaxstab: give a public name."),
        (["run", "--surface", "empty.txt"], "--youngs-modulus is needed with --surface"),
        (["run", "--surface", "empty.txt", *MATERIAL], "empty.txt"),
        (["run", "--config", "empty.txt", "--output", "empty.txt"], "empty.txt"),
        (["run", "--config", "broken.toml"], "broken.toml is not TOML"),
        (["run", "--config", "other.toml"], "other.toml names another file: give options only."),
        (
            ["--first", "1", "--last", "1", "--size", "16", "--k-high", "4"],
            "that of the one before",
        ),
        (["run", "--config", "wrong.toml"], "wrong.toml: size is True: give a number or text."),
        (
            ["run", "--config", "typo.toml"],
            "typo.toml: there is no option rms_hight; the nearest is rms_height.",
        ),
    ],
)
def test_files_that_make_no_sense_end_in_one_line(
    tmp_path, monkeypatch, capsys, arguments, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.txt").touch()
    (tmp_path / "broken.toml").write_text("size = = 3")
    (tmp_path / "wrong.toml").write_text("size = true")
    (tmp_path / "typo.toml").write_text("[surface]\nrms_hight = 0.1")
    (tmp_path / "other.toml").write_text('config = "wrong.toml"')
    assert_refused(arguments, message, capsys)


@pytest.mark.parametrize("law", [*problem.LAWS, "none"])
def test_the_first_load_by_default_takes_pressures_of_the_problems_own(law):
    youngs_modulus, energy, length, rms, k_high = 0.2, 0.03, 0.4, 0.1, 4
    given = ["--youngs-modulus", str(youngs_modulus), "--rms-height", str(rms)]
    given += ["--size", "16", "--k-high", str(k_high), "--potential", law]
    if law != "none":
        given += ["--surface-energy", str(energy), "--range", str(length)]
    parser = Parser(prog="jaxstab run")
    run_command.add_options(parser)
    options = run_command.read(parser, given, parser.parse_args(given))
    contact = problem.contact_of(options)
    assert (f"w = {energy:g}" in problem.described(options, contact)) == (law != "none")
    loads = problem.loads_of(options, contact, [0, 1])
    assert loads.value[1] - loads.value[0] == pytest.approx(20 * rms)
    # That of the shortest wave as high as summits are, and that which does w over the range.
    own = youngs_modulus * np.pi * k_high * 3 * rms + energy / length
    assert abs(js.equilibrate(contact, loads[0]).mean_pressure) < own


def assert_refused(arguments, message, capsys):
    with pytest.raises(SystemExit) as refused:
        main(arguments)
    said = capsys.readouterr().err
    assert refused.value.code == 2
    assert message in said and said.count("\n") == 1, said
