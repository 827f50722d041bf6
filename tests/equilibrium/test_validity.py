"""Warnings of contacts beyond the model or the grid: a ratio of pressures, a count of points."""

import warnings

import jax
import jax.numpy as jnp
import pytest

import jaxstab as js

GRID = js.Grid((32,), 10.0)
WAVE = 0.5 * jnp.cos(2 * jnp.pi * GRID.coordinates[0] / 10)
NONE = js.potentials.NoAdhesion()


def gold(solid=None, unit="GPa"):
    """Return a contact of two bodies of gold, E* = 48 GPa, with a slope of 0.3."""
    solid = solid or js.HalfSpace(GRID, 48.0)
    return js.Contact(solid, WAVE, NONE, unit="µm", pressure_unit=unit)


def warned(call, words):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = call()
    return found, [
        x for x in caught if x.category is js.exceptions.ContactWarning and words in str(x.message)
    ]


@pytest.mark.parametrize(("pressure", "is_beyond"), [(0.05, False), (3.0, True)])
def test_a_pressure_beyond_any_hardness_is_told(pressure, is_beyond):
    contact = gold()
    state, told = warned(
        lambda: js.equilibrate(contact, js.MeanPressure(pressure)), "yield below 0.05 E*"
    )
    share = pressure / state.contact_area / 48
    assert (share > 0.05) == is_beyond == bool(told)
    if told:
        assert f"is {share:.1g} E*, with an E* of 48 GPa" in str(told[0].message)
        assert told[0].filename == __file__


@pytest.mark.nightly
def test_the_worst_state_of_a_path_is_told_once():
    load = js.MeanPressure(jnp.array([0.05, 3.0, 0.05]))
    path, told = warned(lambda: js.follow(gold(), load), "yield below")
    worst = jnp.max(path.equilibrium.mean_pressure / path.equilibrium.contact_area) / 48
    assert len(told) == 1
    assert f"is {worst:.1g} E*, with" in str(told[0].message)


def test_a_viscoelastic_solid_counts_by_its_relaxed_modulus():
    soft = js.Viscoelastic(js.HalfSpace(GRID, 48.0), (10.0,), (1.0,))
    assert warned(lambda: js.equilibrate(gold(soft), js.MeanPressure(3.0)), "yield below")[1]


def test_pressures_without_a_unit_and_a_rubber_have_no_hardness():
    plain = js.Contact(js.HalfSpace(GRID, 48.0), WAVE, NONE)
    for contact in (plain, gold(unit="MPa")):
        assert not warned(lambda c=contact: js.equilibrate(c, js.MeanPressure(3.0)), "")[1]


def test_a_handful_of_points_is_told_by_what_depends_on_them():
    contact = js.Contact(js.HalfSpace(GRID, 48.0), WAVE, NONE)
    few = js.equilibrate(contact, js.MeanPressure(0.05))
    assert 0 < round(float(few.contact_area) * 32) < 5
    many = js.equilibrate(contact, js.MeanPressure(0.5))
    assert round(float(many.contact_area) * 32) >= 5
    for observable in (js.patches, js.conductance):
        found, told = warned(lambda f=observable: f(contact, few), "fewer than 5 points")
        assert len(told) == 1
        assert not warned(lambda f=observable: f(contact, many), "")[1]
    # In a trace numbers are not known.
    compiled = jax.jit(lambda state: js.conductance(contact, state).conductance)
    assert not warned(lambda: compiled(few), "")[1]
    assert compiled(few) == pytest.approx(float(found.conductance))
