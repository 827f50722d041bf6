"""Observables beside the states of paths and sweeps, one by one, in files and in print."""

import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact

import jaxstab as js
from jaxstab.__main__ import main


@pytest.fixture(scope="module")
def contact():
    return rough_contact(16, js.potentials.Exponential(1e-3, 0.05), rms_height=0.05)


@pytest.fixture(scope="module")
def path(contact):
    return js.follow(contact, js.MeanGap(jnp.array([0.1, 0.01, 0.1])), fields=True)


@pytest.fixture(scope="module")
def sweep(contact):
    return js.sweep(contact, js.MeanGap(jnp.array([0.2, 0.05, 0.01])), stability=False)


def test_a_sweeps_columns_are_those_of_each_state(contact, sweep):
    found = js.observe(
        sweep, "patches", "conductance", "leakage", contact=contact, resistivities=(1.0, 2.0)
    )
    assert len(found) == 3
    for i, state in enumerate(sweep):
        patches = js.patches(contact, state)
        for name in ("number", "area", "true_area", "largest", "perimeter", "percolates"):
            np.testing.assert_array_equal(
                getattr(found.patches, name)[i], getattr(patches, name), name
            )
        one = js.conductance(contact, state, (1.0, 2.0))
        np.testing.assert_allclose(found.conductance.conductance[i], one.conductance, rtol=1e-9)
        tensor = js.leakage(contact, state).permeability
        np.testing.assert_allclose(found.leakage.permeability[i], tensor, rtol=1e-9)
    np.testing.assert_allclose(
        found.patches.area, sweep.equilibrium.contact_area * contact.area, rtol=1e-12
    )


def test_a_path_is_observed_along_its_states(contact, path):
    found = js.observe(path, "patches", "conductance", contact=contact)
    assert found.leakage is None
    assert len(found) == len(path.equilibrium)
    np.testing.assert_allclose(
        found.patches.area, path.equilibrium.contact_area * contact.area, rtol=1e-12
    )
    # More contact conducts more: the sets of contact points are nested while pressing.
    pressing = int(np.argmin(path.load.value))
    assert (np.diff(found.conductance.conductance[: pressing + 1]) >= -1e-9).all()
    lines = repr(found).splitlines()
    assert lines[0].split() == [
        "MeanGap",
        "contact",
        "area",
        "patches",
        "true",
        "area",
        "conductance",
    ]
    assert len(lines) == min(len(found), 61) + 2
    one = found[pressing]
    assert one.patches.area == found.patches.area[pressing]


def test_a_state_of_a_path_is_had_again_from_its_gap(contact, path):
    i = 1
    with pytest.raises(TypeError, match=r"States is not a state.*initial=path"):
        js.leakage(contact, path.equilibrium[i])
    again = js.equilibrate(contact, path.load[i], initial=path.equilibrium.gap[i])
    np.testing.assert_allclose(again.gap, path.equilibrium.gap[i], atol=1e-9)
    np.testing.assert_allclose(again.mean_gap, path.equilibrium.mean_gap[i], rtol=1e-12)
    assert (js.leakage(contact, again).permeability > 0).any()


@pytest.mark.nightly
def test_a_branch_is_observed_too(contact):
    load = js.MeanGap(jnp.array([0.1, 0.08]))
    branch = js.continuation(contact, load, fields=True)
    found = js.observe(branch, "patches", contact=contact)
    np.testing.assert_allclose(
        found.patches.area, branch.equilibrium.contact_area * contact.area, rtol=1e-12
    )


@pytest.mark.nightly
def test_on_a_window_points_of_the_window_count(contact):
    window = js.Contact(js.FreeHalfSpace(js.Grid(16), 1.0), contact.heights, contact.potential)
    load = js.FarDisplacement(jnp.array([0.1, -0.05]))
    path = js.follow(window, load, fields=True)
    found = js.observe(path, "patches", "conductance", contact=window)
    np.testing.assert_allclose(
        found.patches.area, path.equilibrium.contact_area * window.area, rtol=1e-12
    )


def test_states_not_found_are_nan_and_leave_the_others(contact, sweep):
    gap = sweep.equilibrium.gap.at[1].set(jnp.nan)
    states = sweep.equilibrium
    object.__setattr__(lost := states[:], "gap", gap)
    found = js.observe(lost, "patches", "leakage", contact=contact)
    assert np.isnan(found.patches.area[1])
    assert found.patches.number[1] == 0
    assert np.isnan(found.leakage.permeability[1]).all()
    assert np.isfinite(found.patches.area[jnp.array([0, 2])]).all()


@pytest.mark.nightly
def test_columns_come_back_from_files(contact, path, sweep, tmp_path):
    for name, states in [("path", path), ("sweep", sweep)]:
        found = js.observe(states, "patches", "leakage", contact=contact)
        _, again = js.load(js.save(tmp_path / f"{name}.nc", contact, found))
        np.testing.assert_array_equal(again.patches.true_area, found.patches.true_area)
        np.testing.assert_array_equal(again.leakage.permeability, found.leakage.permeability)
        np.testing.assert_array_equal(again.load.value, found.load.value)
        dataset = js.to_dataset(contact, found, fields=False)
        assert dataset["leakage_permeability"].dims[0] == "state"
        assert dataset["leakage_permeability"].attrs["units"] == "length^3"
        assert dataset["patches_true_area"].attrs["units"] == "length^2"


def test_the_command_line_shows_columns_and_says_that_it_draws_none(
    contact, sweep, tmp_path, capsys
):
    path = js.save(tmp_path / "it.nc", contact, js.observe(sweep, "patches", contact=contact))
    main(["info", str(path)])
    assert "true area" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["plot", str(path)])
    assert "Observables have no figure of their own" in capsys.readouterr().err


def test_what_cannot_be_observed_is_said(contact, path, sweep):
    bare = js.follow(contact, js.MeanGap(jnp.array([0.1, 0.05])))
    with pytest.raises(ValueError, match=r"kept no gaps.*fields=True"):
        js.observe(bare, "patches", contact=contact)
    with pytest.raises(TypeError, match=r"A Path does not hold its contact: give it too"):
        js.observe(path, "patches")
    with pytest.raises(TypeError, match=r"Contact has no states to observe"):
        js.observe(contact, "patches")
    with pytest.raises(ValueError, match=r"is 'patch': choose of patches, conductance, leakage"):
        js.observe(path, "patch", contact=contact)
    with pytest.raises(ValueError, match=r"is missing: choose of"):
        js.observe(path, contact=contact)
    with pytest.raises(ValueError, match=r"several states in one row"):
        js.observe(sweep[0], "patches", contact=contact)
