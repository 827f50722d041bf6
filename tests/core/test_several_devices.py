"""Fields spread over several devices: virtual ones of the CPU, in processes of their own."""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import several_devices as script
from jax.sharding import AbstractMesh, NamedSharding, PartitionSpec

import jaxstab as js

SCRIPT = Path(script.__file__)
ROOT = SCRIPT.parent.parent


def started(num_devices, *arguments):
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count={num_devices}"
    environment = os.environ | {"XLA_FLAGS": flags, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, SCRIPT, *map(str, arguments)]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )


def free_address():
    with socket.socket() as listener:
        listener.bind(("localhost", 0))
        return f"localhost:{listener.getsockname()[1]}"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What one process found with one device and one with eight, and two with two devices each."""
    folder, address = tmp_path_factory.mktemp("devices"), free_address()
    paths = [folder / f"{name}.npz" for name in ("single", "eight", "first", "second")]
    processes = [started(1, paths[0]), started(8, paths[1])]
    processes += [started(2, path, i, address) for i, path in enumerate(paths[2:])]
    try:
        texts = [process.communicate(timeout=500)[0] for process in processes]
    finally:
        for process in processes:
            process.kill()
    for process, text in zip(processes, texts, strict=True):
        assert process.returncode == 0, text.decode()
    return [np.load(path) for path in paths]


def assert_close(spread, single):
    np.testing.assert_allclose(spread, single, rtol=0, atol=1e-10 * np.max(np.abs(single)))


@pytest.mark.nightly
def test_a_contact_on_eight_devices_is_that_on_one(found):
    single, eight, *_ = found
    for ours, theirs in zip(eight["fields"], single["fields"], strict=True):
        assert_close(ours, theirs)
    np.testing.assert_allclose(eight["numbers"], single["numbers"], rtol=1e-10)
    assert_close(eight["derivatives"], single["derivatives"])
    assert_close(eight["swept"], single["swept"])
    assert_close(eight["window"], single["window"])
    assert eight["verdict"] == single["verdict"] == "stable"
    # The residual is rounding.
    ours, theirs = (str(each["shown"]).split("residual")[0] for each in (eight, single))
    assert ours == theirs


@pytest.mark.nightly
def test_no_device_holds_a_whole_field(found):
    single, eight, *_ = found
    for name in ("whole", "whole_in_sweep", "whole_on_window"):
        assert eight[name].size == 0, eight[name]
    n = script.N
    # Waves along the last side, those that do not count among them.
    rows = 24
    whole = rf"\b({n},{n}|{n * n}|{rows},{n}|{n * rows}|{n},{n // 2 + 1})\]"
    for ours, theirs in zip(eight["programs"], single["programs"], strict=True):
        assert re.search(whole, theirs)
        assert not re.search(whole, ours)
        assert f"[{n // 8},{n}]" in ours
        assert "all-to-all" in ours
        assert "all-gather" not in ours


@pytest.mark.nightly
def test_two_processes_know_the_same_numbers(found):
    single, _, *both = found
    for each in both:
        np.testing.assert_allclose(each["numbers"], single["numbers"][:2], rtol=1e-10)
        assert f"{single['numbers'][0]:.6g}" in str(each["shown"])
        assert "A height is nan at (31, 2)" in str(each["refused"])


def on_one_device(*spec, names=("x",)):
    mesh = jax.make_mesh((1,) * len(names), names)
    return NamedSharding(mesh, PartitionSpec(*spec))


@pytest.mark.parametrize("shape", [(8, 8), (6, 9), (9, 4)])
def test_the_spectrum_of_a_spread_field_is_that_of_numpy(shape):
    grid = js.Grid(shape, (1.0, 3.0), sharding=on_one_device("x"))
    field = np.random.default_rng(0).normal(size=shape)
    modes = grid.transform(grid.device_put(field))
    np.testing.assert_allclose(modes.T, np.fft.rfft2(field), atol=1e-12)
    np.testing.assert_allclose(grid.inverse_transform(modes), field, atol=1e-12)
    single = js.Grid(shape, (1.0, 3.0))
    np.testing.assert_array_equal(grid.wavenumbers.T, single.wavenumbers)
    np.testing.assert_array_equal(grid.mode_multiplicity.T, single.mode_multiplicity)


@pytest.mark.parametrize(
    ("shape", "sharding", "message"),
    [
        ((8,), on_one_device("x"), "line of 8 points stays on one device"),
        ((8, 8), on_one_device(None, "x"), "one axis of the mesh, over the first side"),
        ((8, 8), on_one_device(), "one axis of the mesh, over the first side"),
        ((8, 8), on_one_device("x", "y", names=("x", "y")), "one axis of the mesh"),
        ((8, 8), jax.devices()[0], "give a jax.sharding.NamedSharding"),
        ((8, 8), NamedSharding(AbstractMesh((1,), ("x",)), PartitionSpec("x")), "mesh of devices"),
    ],
)
def test_a_sharding_that_no_grid_can_have_is_refused(shape, sharding, message):
    with pytest.raises((ValueError, TypeError), match=message):
        js.Grid(shape, sharding=sharding)


@pytest.mark.nightly
def test_a_side_that_the_devices_do_not_divide_is_refused(found):
    _, eight, *_ = found
    assert "9 points along the first side cannot be divided among 8 dev" in str(eight["refused"])
