"""The pressure that seals a contact: Westergaard's full contact, leakage on both sides."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import label

import jaxstab as js

GRID = js.Grid((16, 12), (2.0, 1.5))
NONE = js.potentials.NoAdhesion()
RIDGES = 0.01 * jnp.cos(2 * jnp.pi * GRID.coordinates[0] / 2.0)


def rough(law=NONE):
    heights = js.surfaces.self_affine(js.Grid(16), jax.random.key(1), k_high=3, rms_height=0.02)
    return js.Contact(js.HalfSpace(js.Grid(16), 3.0), heights, law)


def test_grooves_close_in_westergaards_full_contact_and_across_at_the_first_touch():
    contact = js.Contact(js.HalfSpace(GRID, 3.0), RIDGES, NONE)
    full = np.pi * 3.0 * 0.01 / 2.0
    along = js.sealing_pressure(contact, "y", rtol=1e-4)
    assert abs(along.pressure - full) <= along.error <= 1e-4 * along.pressure
    assert along.after.contact_area == 1
    across = js.sealing_pressure(contact, "x", rtol=0.1)
    assert across.pressure + across.error <= full / 16


def has_way_through(state, side):
    """Return whether points out of contact lead on for many cells along a side."""
    tiles = np.tile(~np.asarray(state.in_contact), (9, 9))
    parts, _ = label(tiles)
    first, last = np.take(parts, 0, side), np.take(parts, -1, side)
    return bool(np.intersect1d(first[first > 0], last[last > 0]).size)


@pytest.mark.parametrize("side", ["x", "y"])
def test_nothing_leaks_from_the_pressure_on(side):
    contact = rough()
    axis = "xy".index(side)
    found = js.sealing_pressure(contact, side)
    assert found.error <= 1e-3 * found.pressure
    assert has_way_through(found.before, axis)
    assert not has_way_through(found.after, axis)
    assert js.leakage(contact, found.before).permeability[axis, axis] > 0
    assert js.leakage(contact, found.after).permeability[axis, axis] == 0
    # From other starts, at pressures around it, the path is open below alone.
    for factor in (0.9, 0.99, 1.01, 1.1):
        state = js.equilibrate(contact, js.MeanPressure(factor * found.pressure))
        assert has_way_through(state, axis) == (factor < 1)


def test_adhesion_lowers_the_pressure_to_zero():
    weak, strong = (rough(js.potentials.Exponential(work, 0.02)) for work in (2e-4, 0.1))
    assert 0 < js.sealing_pressure(weak).pressure < js.sealing_pressure(rough()).pressure
    found = js.sealing_pressure(strong)
    assert found.pressure == found.error == 0
    assert not has_way_through(found.after, 0)


def test_what_has_no_flow_is_refused():
    with pytest.raises(ValueError, match="side is 'z': choose one of x, y"):
        js.sealing_pressure(rough(), "z")
    line = js.Contact(js.FreeHalfSpace(js.Grid((8,)), 1.0), jnp.zeros(8), NONE)
    with pytest.raises(ValueError, match="side is 'y': choose one of x"):
        js.sealing_pressure(line, "y")
    with pytest.raises(ValueError, match="a window that does not repeat"):
        js.sealing_pressure(line)
