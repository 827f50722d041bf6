"""Patches: SciPy on tiled fields and graphs, Hertz, sums."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import rough_contact, state_of
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import jaxstab as js
from jaxstab.equilibrium.observables.clusters import clusters_of

SPACING = (0.25, 0.5)
STEPS = {4: [(1, 0), (0, 1)], 8: [(1, 0), (0, 1), (1, 1), (1, -1)]}


def touching(mask, dtype=jnp.float64):
    """Return a contact, and a state of it that touches where a mask is."""
    grid = js.Grid(mask.shape, np.multiply(mask.shape, SPACING[: mask.ndim]))
    zeros = jnp.zeros(mask.shape, dtype)
    contact = js.Contact(js.HalfSpace(grid, 2.0), zeros, js.potentials.Exponential(0.1, 1.0))
    random = np.random.default_rng(1).uniform(0.5, 1.5, mask.shape)
    random = jnp.asarray(random, dtype)
    return state_of(contact, jnp.where(mask, 0, random), random)


def graph_labels(mask, neighbours):
    """Return the number of clusters and their labels, point by point."""
    places = np.arange(mask.size).reshape(mask.shape)
    pairs = [
        (places[both], np.roll(places, step, (0, 1))[both])
        for step in STEPS[neighbours]
        for both in [mask & np.roll(mask, step, (0, 1))]
    ]
    rows, columns = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(rows.size), (rows, columns)), (mask.size, mask.size))
    found = connected_components(graph, directed=False)[1].reshape(mask.shape)
    return np.unique(found[mask]).size, found


def spanning_in_tiles(mask, neighbours, tiles=9):
    """Return for each side whether a patch has an image of itself along it, in many cells."""
    parts, _ = label(np.tile(mask, (tiles, tiles)), np.ones((3, 3)) if neighbours == 8 else None)
    n, m = mask.shape
    cells = parts.reshape(tiles, n, tiles, m).transpose(0, 2, 1, 3)
    middle = cells[tiles // 2, tiles // 2]
    is_image = ((cells == middle) & (middle > 0)).any(axis=(2, 3))
    steps = np.argwhere(is_image) - tiles // 2
    return steps.any(axis=0)


@pytest.mark.parametrize("neighbours", [4, 8])
@pytest.mark.parametrize("share", [0.1, 0.4, 0.6, 0.9])
def test_patches_are_those_of_a_graph_and_of_tiles(neighbours, share):
    random = np.random.default_rng(int(100 * share))
    for shape in [(9, 12), (2, 7)]:
        mask = random.uniform(size=shape) < share
        found = js.patches(*touching(mask), neighbours=neighbours)
        number, parts = graph_labels(mask, neighbours)
        assert found.number == number
        pairs = {*zip(found.labels[mask].tolist(), parts[mask].tolist(), strict=True)}
        assert len(pairs) == number
        assert not found.labels[~mask].any()
        np.testing.assert_array_equal(found.percolates, spanning_in_tiles(mask, neighbours))


@pytest.mark.parametrize("turn", [1, -1])
def test_a_diagonal_stripe_goes_around_both_sides(turn):
    mask = np.eye(6, dtype=bool)[::turn]
    contact, state = touching(mask)
    assert js.patches(contact, state).number == 6
    assert not js.patches(contact, state).percolates.any()
    assert js.patches(contact, state, neighbours=8).number == 1
    np.testing.assert_array_equal(js.patches(contact, state, neighbours=8).percolates, True)
    mask = np.zeros((6, 6), bool)
    mask[:, 2] = True
    np.testing.assert_array_equal(js.patches(*touching(mask)).percolates, [True, False])


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_a_rectangle_over_the_corner_has_its_area_perimeter_and_force(dtype):
    mask = np.zeros((8, 10), bool)
    mask[:3, :4] = True
    mask = np.roll(mask, (-1, -2), (0, 1))
    mask[4, 5] = True
    contact, state = touching(mask, dtype)
    found = js.patches(contact, state)
    assert found.areas.dtype == dtype
    dx, dy = SPACING
    np.testing.assert_allclose(found.areas, [12 * dx * dy, dx * dy], rtol=1e-6)
    np.testing.assert_allclose(found.perimeters, [2 * (3 * dx + 4 * dy), 2 * (dx + dy)], rtol=1e-6)
    one = state.pressure[4, 5] * dx * dy
    np.testing.assert_allclose(found.forces[1], one, rtol=1e-5)
    free = jnp.sum(jnp.where(mask, 0, state.pressure)) * dx * dy
    np.testing.assert_allclose(jnp.sum(found.forces) + free, state.force, rtol=1e-4)
    assert found.largest == found.areas[0]
    excess = (np.pi - 1 + np.log(2)) / 24 * (14 + 4) * dx * dy
    np.testing.assert_allclose(found.true_area, found.area - excess, rtol=1e-5)


def test_without_a_period_each_cluster_is_told_to_reach_both_edges_or_not():
    mask = np.array([[1, 0, 1], [1, 0, 0], [1, 0, 1]], bool)
    found = clusters_of(mask, is_periodic=False)
    assert found.number == 3
    np.testing.assert_array_equal(found.labels, [[1, 0, 2], [1, 0, 0], [1, 0, 3]])
    np.testing.assert_array_equal(found.spans, [[True, False], [False, False], [False, False]])


def test_no_contact_and_full_contact():
    nothing = js.patches(*touching(np.zeros((4, 5), bool)))
    assert (nothing.number, nothing.area, nothing.true_area, nothing.largest) == (0, 0, 0, 0)
    assert not nothing.percolates.any()
    everything = js.patches(*touching(np.ones((4, 5), bool)))
    assert everything.number == 1
    assert everything.percolates.all()
    assert everything.true_area == everything.area == 20 * SPACING[0] * SPACING[1]
    assert everything.perimeter == 0


def test_on_a_line_patches_are_intervals():
    mask = np.array([1, 0, 0, 1, 1, 0, 0, 1], bool)
    found = js.patches(*touching(mask))
    np.testing.assert_allclose(found.areas, 2 * SPACING[0])
    np.testing.assert_array_equal(found.perimeters, 2)
    assert found.true_area == found.area
    np.testing.assert_array_equal(found.percolates, [False])


def window(n, radius, centre):
    grid = js.Grid(n)
    x, y = grid.coordinates
    heights = -((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / 4
    contact = js.Contact(js.FreeHalfSpace(grid, 1.0), heights, js.potentials.NoAdhesion())
    return contact, js.equilibrate(contact, js.MeanPressure(4 / 3 * radius**3 / 2))


@pytest.mark.nightly
def test_the_corrected_area_is_nearer_to_hertz():
    radius = 0.3
    errors = []
    for shift in np.linspace(0, 0.02, 4):
        found = js.patches(*window(64, radius, (0.5 + shift, 0.5 + shift / 3)))
        assert found.number == 1
        errors.append([x / (np.pi * radius**2) - 1 for x in (found.area, found.true_area)])
    plain, corrected = np.abs(np.mean(errors, axis=0))
    assert corrected < 0.3 * plain
    assert corrected < 5e-3


def test_a_windows_edges_are_not_joined():
    contact, state = window(16, 0.2, (0.5, 0.5))
    mask = jnp.zeros((16, 16), bool).at[jnp.array([0, 15])].set(True)
    gap = jnp.where(mask, 0.0, 1.0)
    state = type(state)(**{**vars(state), "gap": gap, "in_contact": mask})
    found = js.patches(contact, state)
    assert found.number == 2
    np.testing.assert_array_equal(found.percolates, [False, True])
    np.testing.assert_allclose(found.perimeters, 34 / 16)


def test_what_cannot_be_done_is_said():
    contact, state = touching(np.eye(4, dtype=bool))
    with pytest.raises(ValueError, match=r"neighbours is 6: choose one of 4, 8"):
        js.patches(contact, state, neighbours=6)
    with pytest.raises(TypeError, match=r"outside of jax\.jit"):
        jax.jit(lambda state: js.patches(contact, state).area)(state)
    with pytest.raises(ValueError, match="grid"):
        js.patches(rough_contact(8, js.potentials.NoAdhesion()), state)
