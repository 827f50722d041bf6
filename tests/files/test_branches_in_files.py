"""Branches of unstable states and passes, in files: to the last bit, labelled, drawn."""

import os
from dataclasses import replace

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray
from saved import assert_same_bits

import jaxstab as js
from jaxstab.__main__ import main


@pytest.fixture
def contact(hertz):
    return hertz


def test_a_branch_comes_back_to_the_last_bit(contact, branch, tmp_path):
    kinds = branch.turns.kind.name.tolist()
    assert kinds[0] == "fold"
    path = js.save(tmp_path / "branch.nc", contact, branch)
    assert_same_bits((contact, branch), js.load(path))
    with xarray.open_dataset(path) as plain:
        np.testing.assert_array_equal(plain["index"], branch.index)
        assert plain.turn_kind.values.tolist() == kinds
        assert str(plain.end.values) == "states"
        assert plain.gap.dims == ("state", "x", "y") and plain.turn_gap.dims[0] == "turn"


@pytest.mark.nightly
def test_a_transition_comes_back_to_the_last_bit(contact, transition, tmp_path):
    path = js.save(tmp_path / "pass.nc", contact, transition)
    assert_same_bits((contact, transition), js.load(path))
    with xarray.open_dataset(path) as plain:
        assert plain.images.dims == ("image", "x", "y") and plain.energies.dims == ("image",)
        assert plain.minimum_gap.dims == ("minimum", "x", "y")
        assert float(plain.there) == float(transition.barrier.there)
        assert plain.attrs["load_kind"] == "MeanDisplacement"


@pytest.mark.nightly
def test_a_pass_to_detached_surfaces_comes_back_and_is_drawn(detaching, tmp_path, capsys):
    path = js.save(tmp_path / "pass.nc", *detaching)
    assert_same_bits(detaching, js.load(path))
    with xarray.open_dataset(path) as plain:
        assert float(plain.back) == np.inf and np.isnan(plain.end_gap).all()
        assert plain.images.shape == detaching[1].images.shape
    main(["info", str(path)])
    assert str(detaching[1]) in capsys.readouterr().out
    main(["plot", str(path)])
    assert os.path.getsize(capsys.readouterr().out.strip()) > 10_000
    plt.close("all")


@pytest.mark.nightly
def test_a_pull_off_and_critical_loads_come_back_and_are_drawn(detaching, tmp_path, capsys):
    contact, _ = detaching
    end = js.pull_off(contact)
    path = js.save(tmp_path / "end.nc", contact, end)
    assert_same_bits((contact, end), js.load(path))
    with xarray.open_dataset(path) as plain:
        assert plain.attrs["load_kind"] == "MeanPressure" and str(plain.kind.values) == "release"
        np.testing.assert_array_equal(plain["load"], end.load.value)
        assert plain.critical_mode.dims == plain.gap.dims == ("x",)
        # Under a dead load nothing remains.
        assert str(plain.after_result.values) == "pulled_off"
    for command in ("info", "plot"):
        main([command, str(path)])
    said, figure = capsys.readouterr().out.strip().rsplit("\n", 1)
    assert str(end) in said and os.path.getsize(figure) > 5_000
    plt.close("all")
    several = jax.tree.map(lambda *x: jnp.stack(x), end, replace(end, result=js.RESULTS.no_jump))
    dataset = js.to_dataset(contact, several)
    assert dataset["load"].dims == dataset.critical_eigenvalue.dims == ("state",)
    assert dataset.result.values.tolist() == ["successful", "no_jump"]
    assert dataset.equilibrium_result.values.tolist() == ["successful"] * 2
    stiff = js.Contact(js.HalfSpace(contact.grid, 2.0), contact.heights, contact.potential)
    with pytest.raises(ValueError, match="no equilibrium of this contact"):
        js.save(tmp_path / "other.nc", stiff, end)


@pytest.mark.nightly
def test_a_detachment_comes_back_and_says_what_it_is(detaching, tmp_path, capsys):
    contact, _ = detaching
    options = {"thermal_energy": 2e-4, "attempt_rate": 1e9}
    held = js.detachment(contact, js.MeanPressure(-0.08), **options)
    found = replace(held, rate=jnp.array([1.0, 1e3]))
    for name, result in (("held", held), ("growing", found)):
        path = js.save(tmp_path / f"{name}.nc", contact, result)
        assert_same_bits((contact, result), js.load(path))
        main(["info", str(path)])
        said = capsys.readouterr().out
        assert said.startswith("Detachment of an adhesive contact") and str(result) in said
    np.testing.assert_array_equal(js.load(path)[1].median, found.median)
    dataset = js.to_dataset(contact, found)
    assert dataset.loads.dims == dataset.barriers.dims == dataset.errors.dims == ("load",)
    assert dataset.rate.shape == (2,) and dataset.pull_off_gap.dims == ("x",)
    np.testing.assert_array_equal(dataset.barriers, found.barriers)
    assert dataset.barriers.attrs == {
        "long_name": "barrier to detached surfaces",
        "units": "energy/length",
    }
    assert dataset.rate.attrs["units"] == "pressure/time"
    assert "barriers" in js.to_dataset(contact, found, fields=False)
    stiff = js.Contact(js.HalfSpace(contact.grid, 2.0), contact.heights, contact.potential)
    with pytest.raises(ValueError, match="no equilibrium of this contact"):
        js.save(tmp_path / "other.nc", stiff, found)
    main(["plot", str(path)])
    assert os.path.getsize(capsys.readouterr().out.strip()) > 10_000
    plt.close("all")


def test_data_sets_of_both_say_what_everything_is(contact, branch, transition):
    sets = js.to_dataset(contact, branch), js.to_dataset(contact, transition)
    for dataset in sets:
        for array in dataset.data_vars.values():
            assert array.attrs["long_name"]
            assert array.dtype.kind != "f" or array.attrs["units"]
    one, other = sets
    assert one.turn_kind.attrs["long_name"] == "turns, kind"
    assert one.turn_mode.attrs["units"] == "1"
    assert other.saddle_gap.attrs == {"long_name": "saddle, gap", "units": "length"}
    assert other.energies.attrs["units"] == "energy"
    assert other.start_load.attrs["long_name"] == "start, load: MeanDisplacement"
    scalars = js.to_dataset(contact, branch, fields=False)
    assert "turn_load" in scalars and not {"x", "y"} & set(scalars.dims)


def test_what_is_of_another_contact_is_refused(contact, branch, transition):
    soft = js.Contact(js.HalfSpace(contact.grid, 0.5, 0.0), contact.heights, contact.potential)
    with pytest.raises(ValueError, match="no equilibrium of this contact"):
        js.to_dataset(soft, transition)
    other = js.Contact(js.HalfSpace(js.Grid(8), 1.0), jnp.zeros((8, 8)), contact.potential)
    for result in branch, transition:
        with pytest.raises(ValueError, match=r"shape \(32, 32\), the grid \(8, 8\)"):
            js.to_dataset(other, result)
    twice = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), branch)
    with pytest.raises(ValueError, match="several branches"):
        js.to_dataset(contact, twice)


def test_the_command_line_says_what_a_file_holds_and_draws_it(
    contact, branch, transition, tmp_path, capsys
):
    for name, result in (("branch", branch), ("transition", transition)):
        path = js.save(tmp_path / f"{name}.nc", contact, result)
        main(["info", str(path)])
        said = capsys.readouterr().out
        assert said.startswith(f"{name.capitalize()} of an adhesive contact")
        assert "MeanDisplacement" in said and str(result) in said
        main(["plot", str(path)])
        assert os.path.getsize(capsys.readouterr().out.strip()) > 10_000
    plt.close("all")
