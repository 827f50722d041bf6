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
from jax.sharding import AbstractMesh, AxisType, NamedSharding, PartitionSpec

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
    assert_close(eight["explicit"], single["fields"][1])
    assert eight["verdict"] == single["verdict"] == "stable"
    # The residual is rounding.
    ours, theirs = (str(each["shown"]).split("residual")[0] for each in (eight, single))
    assert ours == theirs


@pytest.mark.nightly
def test_a_surface_that_yields_on_eight_devices_is_that_on_one(found):
    single, eight, *_ = found
    assert 0 < single["yielded_area"] < 1
    assert eight["yielded_area"] == single["yielded_area"]
    for ours, theirs in zip(eight["yielding_fields"], single["yielding_fields"], strict=True):
        assert_close(ours, theirs)
    np.testing.assert_allclose(eight["yielding_numbers"], single["yielding_numbers"], rtol=1e-6)
    assert eight["yielding_verdict"] == single["yielding_verdict"]
    assert_close(eight["heights_left"], single["heights_left"])


@pytest.mark.nightly
def test_no_device_holds_a_whole_field(found):
    single, eight, *_ = found
    for name in ("whole", "whole_in_sweep", "whole_on_window", "whole_where_yielding"):
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


def on(grid, heights):
    return js.Contact(js.HalfSpace(grid, 1.0), heights, js.potentials.Exponential(0.02, 0.1))


def explicit():
    """Return a plain grid, heights on it, and the same on a mesh as `jax.make_mesh` makes it."""
    grid = js.Grid(8)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=2, rms_height=0.1)
    placed = jax.device_put(heights, on_one_device("x"))
    assert AxisType.Explicit in jax.typeof(placed).sharding.mesh.axis_types
    return grid, heights, placed


def test_heights_on_a_mesh_with_explicit_axes_are_heights_as_others():
    grid, heights, placed = explicit()
    load = js.MeanGap(0.12)
    found, expected = (js.equilibrate(on(grid, field), load) for field in (placed, heights))
    np.testing.assert_allclose(found.gap, expected.gap, atol=1e-12)
    again = js.equilibrate(on(grid, heights), load, initial=placed - placed + 0.1)
    np.testing.assert_allclose(again.gap, expected.gap, atol=1e-8)
    spread = js.Grid(8, sharding=on_one_device("x"))
    contact = on(spread, placed)
    assert contact.heights.sharding == spread.sharding
    np.testing.assert_array_equal(contact.heights, heights)
    with pytest.raises(ValueError, match=r"array of heights is traced, .* explicit axes.*AxisType"):
        jax.jit(lambda field: on(grid, field).heights)(placed)


def test_calls_in_a_mesh_with_explicit_axes_are_refused_with_the_cure():
    grid, heights, placed = explicit()
    contact = on(grid, heights)
    load = js.MeanGap(0.12)
    state = js.equilibrate(contact, load)
    mesh = jax.make_mesh((1,), ("x",))
    calls = [
        lambda: js.Grid(8, sharding=NamedSharding(mesh, PartitionSpec("x"))),
        lambda: js.surfaces.self_affine(grid, jax.random.key(0), k_high=2, rms_height=0.1),
        lambda: on(grid, heights),
        lambda: on(grid, placed),
        lambda: js.equilibrate(contact, load),
        lambda: js.assess_stability(contact, state),
        lambda: js.pull_off(contact),
        lambda: jax.jit(lambda gap: js.equilibrate(contact, js.MeanGap(gap)).gap)(0.12),
    ]
    message = r"explicit axes \('x',\).*outside of.*AxisType.Auto"
    with jax.set_mesh(mesh):
        assert "MeanGap" in repr(state)
        for call in calls:
            with pytest.raises(ValueError, match=message):
                call()
    mesh = jax.make_mesh((1,), ("x",), axis_types=(AxisType.Auto,))
    with jax.set_mesh(mesh):
        again = js.equilibrate(contact, load)
    np.testing.assert_allclose(again.gap, state.gap, atol=1e-12)


@pytest.mark.nightly
def test_a_side_that_the_devices_do_not_divide_is_refused(found):
    _, eight, *_ = found
    assert "9 points along the first side cannot be divided among 8 dev" in str(eight["refused"])
