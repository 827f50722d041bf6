"""The work of separation of a path: against the law, quadrature, and paths that do not detach."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact

import jaxstab as js

GRID = js.Grid((16,), (1.0,))
LAW = js.potentials.LennardJones(0.01, 0.1)
FLAT = js.Contact(js.HalfSpace(GRID, 10.0), jnp.zeros(16), LAW)


@pytest.fixture(scope="module")
def flat_path():
    return js.follow(FLAT, js.MeanGap(jnp.array([0.4, 0.095, 1.0])))


def up_to(path, number):
    """Return a path of the first states."""
    load, states = jax.tree.map(lambda x: x[:number], (path.load, path.equilibrium))
    return replace(path, load=load, equilibrium=states)


@pytest.mark.nightly
def test_flat_surfaces_take_the_work_of_their_law(flat_path):
    # From the minimum of the law to the largest gap, whatever the pressure before.
    expected = LAW(1.0) - LAW(0.1)
    assert flat_path.work_of_separation == pytest.approx(float(expected), rel=1e-5)


@pytest.mark.nightly
def test_a_machine_adds_what_its_jump_loses():
    stiffness = 0.5
    machine = js.Spring(jnp.array([0.0, 1.2]), stiffness)
    path = js.follow(FLAT, machine, initial=jnp.full(16, 0.095))
    assert len(path.jumps) == 1
    # The pressure of the machine is k (g - position) on a flat surface: the area under its curve.
    position, pressure = np.asarray(path.load.value), np.asarray(path.equilibrium.mean_pressure)
    tensile = np.trapezoid(np.maximum(-pressure, 0), position)
    assert path.work_of_separation == pytest.approx(tensile, rel=0.01)
    assert path.work_of_separation > 1.1 * (LAW(1.0) - LAW(0.1))
    end = LAW(float(path.equilibrium.mean_gap[-1])) + 0.5 * pressure[-1] ** 2 / stiffness
    lost = path.dissipation / FLAT.area
    assert path.work_of_separation == pytest.approx(float(end - LAW(0.1) + lost), rel=1e-4)


@pytest.mark.nightly
def test_a_rough_surface_takes_the_area_under_its_tensile_curve():
    contact = rough_contact(32, js.potentials.Exponential(0.06, 0.06), rms_height=0.05)
    path = js.follow(contact, js.MeanGap(jnp.array([0.13, 0.1, 0.35])))
    gap, pressure = np.asarray(path.load.value), np.asarray(path.equilibrium.mean_pressure)
    back = np.flatnonzero(gap == gap.min())[-1]
    assert len(path.jumps) > 3 and pressure[back] < 0
    # All of the retraction is under tension.
    tensile = -np.trapezoid(pressure[back:], gap[back:])
    assert path.work_of_separation == pytest.approx(tensile, rel=0.01)


def test_a_path_that_does_not_come_apart_has_none(flat_path):
    gap = np.asarray(flat_path.load.value)
    back = int(np.argmin(gap))
    # Only approach, under compression, and still at a large tension.
    for last in (back // 2, back, back + 1, int(np.flatnonzero(gap < 0.15)[-1])):
        assert np.isnan(up_to(flat_path, last + 1).work_of_separation)
    pressed = js.MeanPressure(flat_path.equilibrium.mean_pressure)
    assert np.isnan(replace(flat_path, load=pressed).work_of_separation)


def test_an_approach_of_its_own_counts_no_more_than_a_start_in_contact(flat_path):
    back = int(np.argmin(np.asarray(flat_path.load.value)))
    load, states = jax.tree.map(lambda x: x[back:], (flat_path.load, flat_path.equilibrium))
    away = replace(flat_path, load=load, equilibrium=states)
    assert away.work_of_separation == flat_path.work_of_separation


def test_paths_of_a_batch_have_each_their_own(flat_path):
    number = len(flat_path)

    def padded(path):
        room = number + 3 - len(path.load.value)
        load, states = jax.tree.map(
            lambda x: jnp.pad(x, (0, room), constant_values=jnp.nan),
            (path.load, path.equilibrium),
        )
        return replace(path, load=load, equilibrium=states)

    short = up_to(flat_path, number - 1)
    batch = jax.tree.map(lambda *x: jnp.stack(x), padded(flat_path), padded(short))
    expected = [float(path.work_of_separation) for path in (flat_path, short)]
    for found in (
        batch.work_of_separation,
        jax.jit(jax.vmap(lambda path: path.work_of_separation))(batch),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert expected[0] > expected[1]


def test_without_adhesion_nothing_is_needed(flat_path):
    states = replace(flat_path.equilibrium, mean_pressure=abs(flat_path.equilibrium.mean_pressure))
    assert replace(flat_path, equilibrium=states).work_of_separation == 0
