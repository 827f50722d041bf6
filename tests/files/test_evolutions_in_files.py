"""Evolutions of viscoelastic contacts in files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from saved import assert_same_bits
from viscoelastic_lines import viscoelastic

import jaxstab as js


@pytest.fixture(scope="module")
def evolution():
    load = js.MeanDisplacement(jnp.array([0.04, 0.01, 0.02, 0.05]))
    return js.evolve(viscoelastic(), load, jnp.arange(4.0), fields=True)


def test_an_evolution_comes_back_to_the_last_bit_and_goes_on(evolution, tmp_path):
    contact = evolution.contact
    parts = {"one": evolution[2], "some": evolution[:2], "none": evolution[:0]}
    for name, result in {"all": evolution, **parts}.items():
        saved = js.save(tmp_path / f"{name}.nc", contact, result)
        assert_same_bits((contact, result), js.load(saved))
    _, state = js.load(tmp_path / "one.nc")
    load = js.MeanDisplacement(jnp.array([0.02, 0.05]))
    gaps = [js.evolve(contact, load, jnp.array([2.0, 3.0]), initial=state, fields=True).gap]
    gaps.append(evolution.gap)
    # Steps of the whole evolution are not begun anew.
    np.testing.assert_allclose(*gaps, atol=1e-3 * 0.02)


def test_old_names_of_its_energies_forward(evolution):
    names = {
        "dissipated": "viscous_dissipation",
        "lost": "jump_dissipation",
        "dissipation": "jump_losses",
    }
    for old, new in names.items():
        with pytest.warns(DeprecationWarning, match=f"Evolution.{old} is now Evolution.{new}"):
            assert getattr(evolution, old) is getattr(evolution, new)


def test_its_data_set_says_what_everything_is(evolution):
    dataset = js.to_dataset(evolution.contact, evolution)
    assert dataset.fields_gap.dims == ("state", "x")
    assert dataset.fields_strains.dims == ("state", "fields_strains_0", "x")
    assert dataset.work.dims == dataset.times.dims == ("state",)
    assert dataset.jump_losses.dims == ("jump",)
    np.testing.assert_array_equal(dataset.work, evolution.work)
    np.testing.assert_array_equal(dataset.solid_times, evolution.contact.solid.times)
    units = {name: dataset[name].attrs["units"] for name in ("times", "work", "solid_times")}
    assert units == {"times": "time", "work": "µJ/m", "solid_times": "time"}
    assert dataset.solid_times.attrs["long_name"] == "times"
    for name, array in dataset.data_vars.items():
        assert "long_name" in array.attrs, name
        assert array.dtype.kind != "f" or "units" in array.attrs, name
    scalars = js.to_dataset(evolution.contact, evolution, fields=False)
    assert "x" not in scalars.dims


def test_an_evolution_of_another_contact_or_several_are_refused(evolution):
    with pytest.raises(ValueError, match="another potential than the contact"):
        js.to_dataset(viscoelastic(energy=0.001), evolution)
    for one in (evolution, evolution[-1]):
        several = jax.tree.map(lambda leaf: jnp.stack([leaf] * 2), one)
        with pytest.raises(ValueError, match="several evolutions"):
            js.to_dataset(evolution.contact, several)


def test_observables_stand_beside_its_states_and_go_into_files(evolution, tmp_path):
    contact = evolution.contact
    observed = js.observe(contact, evolution, js.patches)
    assert np.array(observed.patches.area) == pytest.approx(
        np.array(evolution.contact_area * contact.area)
    )
    # Patches press against the load and the attraction outside of them, at that time.
    forces = js.patches(contact, evolution[1].instant[1]).forces
    gap = evolution[1].gap
    pull = 0.002 / 0.02 * jnp.mean(jnp.where(gap > 0, jnp.exp(-gap / 0.02), 0))
    assert np.sum(forces) == pytest.approx(float(evolution.force[1] + pull), rel=1e-6)
    saved = js.save(tmp_path / "observed.nc", contact, observed)
    assert_same_bits((contact, observed), js.load(saved))
    with pytest.raises(ValueError, match="another potential"):
        js.observe(viscoelastic(energy=0.001), evolution, js.patches)
