"""Laws in files: a class comes back, a function leaves a table and a warning."""

import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from problems import state_of
from saved import BUMPY, SHAPE, assert_same_bits, contact_and_state

import jaxstab as js


@pytest.mark.nightly
def test_a_law_defined_in_a_script_comes_back_in_it_and_is_asked_for_elsewhere(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import sys, equinox as eqx, jax.numpy as jnp, jaxstab as js\n"
        "class Mine(eqx.Module):\n"
        "    depth: float\n"
        "    def __call__(self, gap):\n"
        "        return -self.depth * jnp.exp(-gap)\n"
        "grid = js.Grid(8)\n"
        "heights = js.surfaces.sinusoid(grid, 0.1)\n"
        "contact = js.Contact(js.HalfSpace(grid, 1.0), heights, Mine(0.01))\n"
        "state = js.equilibrate(contact, js.MeanGap(0.2))\n"
        "contact, again = js.load(js.save(sys.argv[1], contact, state))\n"
        "assert type(contact.potential) is Mine and contact.potential.depth == 0.01\n"
        "assert (js.equilibrate(contact, again.load).gap == state.gap).all()\n"
    )
    path = tmp_path / "mine.nc"
    subprocess.run([sys.executable, str(script), str(path)], check=True, cwd=tmp_path)
    contact, state = js.load(path)
    with pytest.raises(ValueError, match=r"`__main__:Mine` the file holds values only.*potential="):
        js.equilibrate(contact, state.load)
    contact, state = js.load(path, potential=lambda gap: -0.01 * jnp.exp(-gap))
    assert js.equilibrate(contact, state.load, initial=state).num_steps == 0
    with pytest.raises(ValueError, match=r"is not the one of .*mine.nc: at a gap of"):
        js.load(path, potential=lambda gap: -0.011 * jnp.exp(-gap))


@pytest.mark.parametrize(
    "dtype", [jnp.float64, pytest.param(jnp.float32, marks=pytest.mark.nightly)]
)
def test_of_a_bare_function_values_are_kept_and_a_warning_says_so(dtype, tmp_path):
    contact, state = contact_and_state(lambda gap: -0.01 * jnp.exp(-gap / 0.2), dtype)
    with pytest.warns(UserWarning, match=r"bare.nc holds values of `<lambda>`, no formula"):
        path = js.save(tmp_path / "bare.nc", contact, state)
    loaded, again = js.load(path)
    assert_same_bits(again, state)
    js.plots.gap(loaded, again)
    with pytest.raises(ValueError, match="`<lambda>` the file holds values only"):
        js.assess_stability(loaded, again)


class Odd(eqx.Module):
    """A law whose fields have the names of fields of results."""

    my_history: jax.Array
    grid_lengths: jax.Array
    gap: jax.Array
    load: jax.Array

    def __call__(self, gap):
        return -self.gap * self.load * jnp.exp(-gap / jnp.sum(self.my_history * self.grid_lengths))


ODD = Odd(jnp.array([0.1, 0.2]), jnp.array([0.5, 0.5]), jnp.array(0.1), jnp.array(0.1))


@pytest.mark.parametrize("law", [ODD, BUMPY], ids=["odd", "bumpy"])
def test_a_law_of_any_fields_comes_back_and_clashes_with_no_name_of_results(law, tmp_path):
    both = contact_and_state(law)
    assert_same_bits(both, js.load(js.save(tmp_path / "own.nc", *both)))


def test_a_lost_law_inside_another_and_a_lost_solid_are_told(tmp_path):
    class Local(eqx.Module):
        depth: jax.Array

        def __call__(self, gap):
            return -self.depth * jnp.exp(-gap)

    varying = js.potentials.Varying(Local(jnp.full(SHAPE, 0.01)))
    contact, state = contact_and_state(varying)
    with pytest.warns(UserWarning, match="Local"):
        path = js.save(tmp_path / "law.nc", contact, state)
    loaded, _ = js.load(path)
    with pytest.raises(ValueError, match="Local` the file holds values only"):
        js.equilibrate(loaded, state.load)
    solid = js.solids.Spectral(contact.grid, lambda q: q / 2)
    law = js.potentials.Exponential(0.01, 0.2)
    contact, state = state_of(js.Contact(solid, contact.heights, law), state.gap)
    with pytest.warns(UserWarning, match="<lambda>"):
        path = js.save(tmp_path / "solid.nc", contact, state)
    loaded, again = js.load(path)
    assert_same_bits(again, state)
    with pytest.raises(ValueError, match="for a solid, build the contact anew"):
        js.equilibrate(loaded, state.load)


class Own(eqx.Module):
    """A law whose numbers have the names of other quantities."""

    work: jax.Array
    amplitude: jax.Array

    def __call__(self, gap):
        return -self.work * jnp.exp(-gap / self.amplitude)


def test_labels_are_those_of_the_dimension_and_not_guessed_of_a_law_of_ones_own():
    law = Own(jnp.array(0.01), jnp.array(0.2))
    contact = js.Contact(js.HalfSpace(js.Grid((16,)), 1.0), jnp.zeros(16), law)
    dataset = js.to_dataset(*state_of(contact, jnp.linspace(0.1, 0.2, 16)))
    assert dataset.area.units == "length"
    assert dataset.energy.units == "energy/length"
    assert dataset.potential_work.attrs == {"long_name": "work"}
    assert dataset.potential_amplitude.attrs == {"long_name": "amplitude"}


def test_what_is_composed_of_laws_and_materials_has_labels_too():
    grid = js.Grid(8)
    solid = js.CoatedHalfSpace(grid, (1.0, 0.3), 0.2, (2.0, 0.4))
    law = js.potentials.Scaled(js.potentials.Dugdale(0.01, 0.2), jnp.array(0.5))
    contact = js.Contact(solid, jnp.zeros((8, 8)), law)
    dataset = js.to_dataset(*state_of(contact, jnp.linspace(0.1, 0.2, 64).reshape(8, 8)))
    for place in ("layer", "base"):
        first, second = (dataset[f"solid_{place}_{i}"].attrs for i in (0, 1))
        assert first == {"long_name": f"{place}, Young's modulus", "units": "pressure"}
        assert second == {"long_name": f"{place}, Poisson's ratio", "units": "1"}
    assert dataset.potential_law_length.attrs == {"long_name": "law, range", "units": "length"}
    assert dataset.potential_law_smoothing.units == dataset.potential_factor.units == "1"
