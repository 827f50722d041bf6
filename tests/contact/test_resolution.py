import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact

import jaxstab as js

COARSE = js.potentials.Exponential(surface_energy=1e-2, length=0.1)
LOAD = js.MeanGap(0.2)


def test_the_papers_last_figure_is_not_resolved_by_its_grid():
    contact = rough_contact(256, COARSE, youngs_modulus=1e-3)
    shortest_wave = 1e-3 / 2 * np.pi * 256 * np.sqrt(2)
    assert contact.resolution == pytest.approx(shortest_wave / 1.0)
    assert contact.resolution == pytest.approx(0.57, abs=0.005)


def test_the_grid_that_would_do_is_named_and_does():
    contact = rough_contact(32, COARSE, youngs_modulus=2e-3)
    with pytest.warns(js.ResolutionWarning, match=r"32 x 32 points.*0\.142 of.*256 x 256 would do"):
        js.equilibrate(contact, LOAD, throw=False)
    finer = rough_contact(256, COARSE, youngs_modulus=2e-3)
    assert contact.resolution < 1 < finer.resolution
    assert finer.resolution < 2


@pytest.mark.parametrize("law", [COARSE, js.potentials.NoAdhesion()])
def test_nothing_is_said_of_grids_that_do_and_inside_transformations(law):
    fine = rough_contact(16, law)
    coarse = rough_contact(16, COARSE, youngs_modulus=1e-3)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        js.equilibrate(fine, LOAD)
        jax.eval_shape(lambda contact: js.equilibrate(contact, LOAD, throw=False), coarse)
    assert not said


def test_a_solid_that_no_grid_would_resolve_is_told_apart():
    grid = js.Grid(16)
    foundation = js.Spectral(grid, lambda q: 1e-3 + 0 * q)
    contact = js.Contact(foundation, rough_contact(16, COARSE).heights, COARSE)
    with warnings.catch_warnings():
        # Before anything is solved.
        warnings.simplefilter("error", js.ResolutionWarning)
        with pytest.raises(js.ResolutionWarning, match="No grid of a size"):
            js.equilibrate(contact, LOAD, throw=False)


def test_a_solid_with_a_stored_stiffness_is_not_told_that_no_grid_would_do():
    contact = rough_contact(16, COARSE, youngs_modulus=1e-3)
    stored = js.Contact(contact.solid.scaled(jnp.array(1.0)), contact.heights, COARSE)
    assert stored.resolution == pytest.approx(contact.resolution)
    with pytest.warns(js.ResolutionWarning, match=r"artefacts\. Use a finer grid, or a weaker or"):
        js.equilibrate(stored, LOAD, throw=False)


def test_jumps_need_more_and_are_told_how_far_they_may_be_off():
    law = js.potentials.Exponential(0.02, 0.02)
    contact = rough_contact(32, law, rms_height=0.05)
    assert 1 < contact.resolution < 2
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        js.equilibrate(contact, LOAD)
    assert not said
    load = js.MeanGap(jnp.array([0.3, 0.2]))
    with pytest.warns(js.ResolutionWarning, match=r"be off by 10 %. A grid of 128 x 128 would"):
        js.follow(contact, load)


@pytest.mark.parametrize("stiffness", [None, 1.0])
def test_a_pull_off_warns_once_with_the_range_that_the_grid_resolves(stiffness):
    grid = js.Grid((32,), (1.0,))
    heights = 0.05 * jnp.cos(2 * jnp.pi * grid.coordinates[0])

    def contact(length):
        law = js.potentials.Exponential(0.02, length)
        return js.Contact(js.HalfSpace(grid, 1.0), heights, law)

    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        js.pull_off(contact(0.01), spring=stiffness, throw=False)
    (told,) = [warning for warning in told if warning.category is js.ResolutionWarning]
    factor = float(re.search(r"a range (\S+) times as long", str(told.message))[1])
    with warnings.catch_warnings(record=True) as longer:
        warnings.simplefilter("always")
        js.pull_off(contact(factor * 0.01), spring=stiffness, throw=False)
    assert not [warning for warning in longer if warning.category is js.ResolutionWarning]


def test_a_sweep_warns_once():
    coarse = rough_contact(16, COARSE, youngs_modulus=1e-3)
    with pytest.warns(js.ResolutionWarning) as told:
        js.sweep(coarse, js.MeanGap(jnp.array([0.3, 0.2])), throw=False)
    assert len([warning for warning in told if warning.category is js.ResolutionWarning]) == 1
