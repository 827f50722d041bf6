from argparse import Namespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import jaxstab as js
from jaxstab.__main__ import main
from jaxstab.cli import problem
from jaxstab.cli.options import LAWS, read

MATERIAL = ["--youngs-modulus", "2", "--surface-energy", "0.02", "--range", "0.2"]


@pytest.mark.nightly
def test_every_option_reaches_the_problem_that_is_solved(tmp_path):
    options = {
        "study": "unloading",
        "size": 32,
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

    grid = js.Grid(32)
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


@pytest.mark.nightly
def test_a_measured_surface_every_law_and_load_reach_the_problem(scan, tmp_path, capsys):
    options = ["--surface", str(scan), "--lengths", "2", "1.5", "--unit", "um", *MATERIAL]
    options += ["--load", "spring", "--stiffness", "3", "--first", "0.1", "--last", "0.4"]
    options += ["--potential", "dugdale", "--smoothing", "0.3", "--periodic", "as_is"]
    options += ["--study", "unloading", "--number", "2", "--output", str(tmp_path / "out")]
    main(options)
    said = capsys.readouterr()
    assert "0.521 % of the points were missing and have been filled." in said.err
    assert "shape=(16, 12), lengths=[2, 1.5] µm" in said.out
    contact, sweep = js.load(tmp_path / "out" / "1" / "unloading.nc")
    lines = [f'surface = "{scan}"', "lengths = [2, 1.5]", 'unit = "um"', 'study = "unloading"']
    rest = options[7:-6]
    lines += [f'{rest[i][2:]} = "{rest[i + 1]}"' for i in range(0, len(rest), 2)]
    (tmp_path / "study.toml").write_text("\n".join(lines))
    numbers = ["--number", "2", "--output", str(tmp_path / "out")]
    main(["--config", str(tmp_path / "study.toml"), *numbers])
    files = [tmp_path / "out" / name / "unloading.nc" for name in "12"]
    xarray.testing.assert_identical(*map(xarray.load_dataset, files))
    topography = js.surfaces.read(scan, (2.0, 1.5), "um").detrended().filled().detrended(0)
    np.testing.assert_allclose(contact.heights, topography.heights, atol=1e-15)
    np.testing.assert_allclose(contact.grid.lengths, [2, 1.5])
    assert contact.unit == "µm"
    law = contact.potential
    assert isinstance(law, js.potentials.Dugdale) and float(law.smoothing) == 0.3
    assert isinstance(sweep.load, js.Spring) and (sweep.load.stiffness == 3).all()
    np.testing.assert_allclose(sweep.load.value, [0.1, 0.4])


@pytest.mark.parametrize("periodic", [None, "window"])
def test_a_tilt_leaves_no_summit_where_points_are_missing(periodic, tmp_path):
    heights = np.array(js.surfaces.sinusoid(js.Grid((16, 12)), 0.1, waves=(2, 1)))
    heights[:4, :3] = np.nan
    options = Namespace(lengths=[2, 1.5], unit="um", channel=None, detrend=1, periodic=periodic)
    found = []
    for tilt in (0.0, 0.1):
        np.savetxt(tmp_path / "scan.txt", heights + tilt * np.arange(16)[:, None])
        found.append(problem.topography_of(tmp_path / "scan.txt", options))
        assert abs(found[-1].heights.mean()) < 1e-12
    level, tilted = found
    np.testing.assert_allclose(tilted.heights, level.heights, atol=1e-12)


def test_a_configuration_does_what_options_do_and_they_go_before_it(tmp_path, capsys):
    config = tmp_path / "study.toml"
    config.write_text(
        'study = "unloading"\nnumber = 3\nfirst = -1e-3\n[surface]\nsize = 32\nk_high = 8\n'
    )
    output = ["--output", str(tmp_path / "out")]
    main(["--config", str(config), *output])
    options = ["--study", "unloading", "--number", "3", "--first=-1e-3", "--size", "32"]
    main([*options, "--k-high", "8", *output])
    main(["run", "--config", str(config), *output, "--number", "2"])
    first, second, third = (
        xarray.load_dataset(tmp_path / "out" / str(i) / "unloading.nc") for i in (1, 2, 3)
    )
    xarray.testing.assert_identical(first, second)
    assert third["load"].size == 2 and third["load"][0] == first["load"][0] == -1e-3


@pytest.mark.parametrize(
    "law",
    [
        *(
            pytest.param(law, marks=[pytest.mark.nightly] * (law != "lennard-jones"))
            for law in LAWS
        ),
        "none",
    ],
)
def test_the_first_load_by_default_takes_pressures_of_the_problems_own(law):
    youngs_modulus, energy, length, rms, k_high = 0.2, 0.03, 0.4, 0.1, 4
    given = ["--youngs-modulus", str(youngs_modulus), "--rms-height", str(rms)]
    given += ["--size", "16", "--k-high", str(k_high), "--potential", law]
    if law != "none":
        given += ["--surface-energy", str(energy), "--range", str(length)]
    _, options = read(given)
    contact = problem.contact_of(options)
    assert (f"energy={energy:g}" in str(contact)) == (law != "none")
    loads = problem.loads_of(options, contact, [0, 1])
    assert loads.value[1] - loads.value[0] == pytest.approx(20 * rms)
    # That of the shortest wave as high as summits are, and that which does w over the range.
    own = youngs_modulus * np.pi * k_high * 3 * rms + energy / length
    assert abs(js.equilibrate(contact, loads[0]).mean_pressure) < own


def test_one_length_is_a_square_and_units_are_shown(tmp_path):
    heights = js.surfaces.sinusoid(js.Grid(16), 0.01)
    np.savetxt(tmp_path / "scan.txt", heights)
    given = ["--surface", str(tmp_path / "scan.txt"), "--lengths", "10", *MATERIAL]
    _, options = read([*given, "--unit", "um", "--pressure-unit", "MPa", "--periodic", "as_is"])
    contact = problem.contact_of(options)
    np.testing.assert_array_equal(contact.grid.lengths, [10, 10])
    assert (contact.unit, contact.pressure_unit) == ("µm", "MPa")
    assert "youngs_modulus=2 MPa" in str(contact)


def test_heights_of_a_windowed_surface_have_zero_mean(scan):
    surface = ["--surface", str(scan), "--lengths", "2", "1.5", "--periodic", "window", *MATERIAL]
    _, options = read(["run", *surface])
    assert problem.contact_of(options).heights.mean() == pytest.approx(0, abs=1e-15)
