"""Observables of a contact that yields, beside those of the elastic one over the surface left."""

import jax
import numpy as np
import pytest

import jaxstab as js

GRID = js.Grid(16)
HEIGHTS = js.surfaces.self_affine(GRID, jax.random.key(3), k_high=4, rms_height=0.05)


@pytest.fixture(scope="module")
def contact():
    solid = js.HalfSpace(GRID, 1.0)
    return js.Contact(solid, HEIGHTS, js.potentials.Exponential(0.002, 0.1), hardness=0.2)


@pytest.fixture(scope="module")
def state(contact):
    return js.equilibrate(contact, js.MeanPressure(0.06))


@pytest.mark.nightly
def test_current_flow_and_patches_are_those_of_the_surface_left(contact, state):
    left = contact.after(state).elastic
    same = js.equilibrate(left, state.load, initial=state.gap)
    assert 0 < state.yielded_area < state.contact_area
    np.testing.assert_array_equal(same.in_contact, state.in_contact)
    conductances = [js.conductance(*pair) for pair in ((contact, state), (left, same))]
    np.testing.assert_allclose(conductances[0].conductance, conductances[1].conductance)
    flows = [js.leakage(*pair).permeability for pair in ((contact, state), (left, same))]
    np.testing.assert_allclose(flows[0], flows[1], rtol=1e-5, atol=1e-12)
    areas = [js.patches(*pair).areas for pair in ((contact, state), (left, same))]
    np.testing.assert_allclose(areas[0], areas[1])


def test_observables_stand_beside_a_sweep(contact):
    sweep = js.sweep(contact, js.MeanPressure(np.array([0.02, 0.06])), stability=False)
    observed = js.observe(contact, sweep, js.conductance)
    alone = [
        js.conductance(contact, js.equilibrate(contact, js.MeanPressure(p))).conductance
        for p in (0.02, 0.06)
    ]
    np.testing.assert_allclose(observed.conductance.conductance, alone, rtol=1e-6)


def test_yielding_points_have_a_colour_of_their_own(contact, state):
    axes = js.plots.contact_map(contact, state)
    drawn = np.asarray(axes.images[0].get_array()).T
    np.testing.assert_array_equal(drawn == 2, state.is_yielding)
    np.testing.assert_array_equal(drawn == 1, state.in_contact & ~state.is_yielding)
    assert f"yielding {100 * float(state.yielded_area):.1f} %" in axes.get_title()
    elastic = js.plots.contact_map(contact.elastic, js.equilibrate(contact.elastic, state.load))
    assert "yielding" not in elastic.get_title()


def test_a_data_set_and_a_file_keep_hardness_and_indentation(contact, state, tmp_path):
    dataset = js.to_dataset(contact, state)
    np.testing.assert_array_equal(dataset.indentation, state.indentation)
    js.save(tmp_path / "state.nc", contact, state)
    again, found = js.load(tmp_path / "state.nc")
    np.testing.assert_array_equal(again.hardness, contact.hardness)
    np.testing.assert_array_equal(found.indentation, state.indentation)
